"""Residuals in the frame and trajectories from above: lines are as long, and lie where, the numbers say."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from tests.browser.conftest import Visit
from tests.builders import corner_rig
from tests.clips import clip_job
from tests.service import LiveApi

NONE = {"baseline": None, "finetuned": None}
SCRIPT = """async ([job, camera, residuals]) => {
  const { residualFigure, trajectoryFigure } = await import("/static/js/placefigures.js");
  const { Camera } = await import("/static/js/projection.js");
  const scene = await (await fetch(`/v1/jobs/${job}/scene`)).json();
  const shown = await residualFigure(job, new Camera(scene.cameras.find((one) => one.id === camera)), residuals, true);
  const gone = trajectoryFigure(scene, await (await fetch(`/v1/jobs/${job}/tracks/paths`)).json());
  document.querySelector("main").replaceChildren(shown, gone);
  return {
    lines: [...shown.querySelectorAll("line")].map((one) =>
      ["x1", "y1", "x2", "y2"].map((name) => Number(one.getAttribute(name)))),
    dashed: shown.querySelectorAll("circle[stroke-dasharray]").length,
    picture: shown.querySelector("image").getAttribute("href").slice(0, 23),
    none: await residualFigure(job, new Camera(scene.cameras[0]), { ...residuals, residuals: [] }, true),
    paths: [...gone.querySelectorAll("path.line")].map((one) => [one.getAttribute("d"), one.getAttribute("stroke")]),
    stands: [...gone.querySelectorAll("circle")].map((one) => one.getAttribute("fill")),
    ticks: [...gone.querySelectorAll("text:not(.name)")].filter((one) => one.getAttribute("text-anchor") === "middle")
      .map((one) => [Number(one.textContent), Number(one.getAttribute("x"))]),
  };
}"""


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return clip_job(api, b"of places")


@pytest.fixture
def drawn(signed_in: Visit, job: str) -> dict[str, Any]:
    camera = corner_rig(2)["cam2"]
    points = []
    for (x, y), (du, dv), used in (
        ((0, 0), (3.0, 0.0), True),
        ((5, 5), (0.0, -2.0), True),
        ((-4, 3), (40.0, 9.0), False),
    ):
        pixel, _ = camera.project(np.array([x, y, 0.0]))
        clicked = [float(pixel[0] - du), float(pixel[1] - dv)]
        points.append(
            {"world": [x, y], "pixel": clicked, "used": used, "error_px": float(np.hypot(du, dv)), "error_m": 0}
        )
    residuals = {"points": 3, "rejected": 1, "median_px": 2.5, "max_px": 3.0, "residuals": points}
    signed_in.page.get_by_role("heading", name="Jobs").wait_for()
    found: dict[str, Any] = signed_in.page.evaluate(SCRIPT, [job, "cam2", residuals])
    return found


def test_residuals_point_to_where_the_camera_sees_the_point(drawn: dict[str, Any], signed_in: Visit) -> None:
    lines = np.array(drawn["lines"])
    np.testing.assert_allclose(lines[:, 2:] - lines[:, :2], 20.0 * np.array([[3, 0], [0, -2], [40, 9]]), atol=1e-6)
    assert (drawn["dashed"], drawn["picture"], drawn["none"]) == (1, "data:image/jpeg;base64,", None)
    signed_in.picture("places")


def test_trajectories_are_to_scale(drawn: dict[str, Any]) -> None:
    """Track 1 drives along X at 10 m/s for 4.9 s; track 2 stands."""
    [(path, colour)] = drawn["paths"]
    driven = [float(value) for value in re.findall(r"[\d.]+", path)]
    (x, px), *_, (x_last, px_last) = drawn["ticks"]
    per_m = (px_last - px) / (x_last - x)
    assert driven[-2] - driven[0] == pytest.approx(49 * per_m, rel=1e-3)
    assert driven[1] == driven[-1], "Y does not change"
    assert len(driven) == 4, "a straight way is drawn by its ends"
    [stands] = drawn["stands"]
    assert stands != colour, "a bus is no car"


def test_jobs_with_another_test_part_are_not_compared(signed_in: Visit) -> None:
    """Of four jobs one has another test part, and one is not measured: two marks before, two after."""
    job = {
        "test_from_s": 40,
        "test_to_s": 50,
        "labels": "none",
        "labelled_instants": 0,
        "train_vehicles": 5,
        "name": "",
    }
    value = {"bev_iou_misses_zero": NONE, "recall": NONE, "other_views": {"baseline": 0.4, "finetuned": 0.7}}
    jobs = [
        {**job, **value, "job_id": name, "train_s": s} for name, s in (("a", 60), ("b", 180), ("c", 120), ("d", 90))
    ]
    jobs[2]["test_from_s"] = 30
    jobs[3]["other_views"] = NONE
    signed_in.page.get_by_role("heading", name="Jobs").wait_for()
    script = """async (jobs) => {
      const { amountFigures } = await import("/static/js/resultfigures.js");
      const [shown] = amountFigures(jobs, "a");
      return { before: shown.querySelectorAll("svg.chart rect").length, caption: shown.textContent,
        after: [...shown.querySelectorAll("svg.chart circle")].map((one) => Number(one.getAttribute("cx"))),
        alone: amountFigures(jobs, "c").length };
    }"""
    found = signed_in.page.evaluate(script, jobs)
    assert (found["before"], len(found["after"]), found["alone"]) == (2, 2, 0)
    assert found["after"][0] < found["after"][1]
    assert "3 jobs of this site with the same test part" in found["caption"]
