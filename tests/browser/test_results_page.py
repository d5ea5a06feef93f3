"""Results of a job as they are printed, and where a part of them cannot be loaded."""

from __future__ import annotations

import re

import pytest

from tests.browser.conftest import Visit
from tests.finished import finished_job
from tests.service import LiveApi

#: What figures show: title, lengths of bars by their titles (px), and places of round marks (px).
FIGURES = """async ([metrics, statistics]) => {
  const { dataFigures, qualityFigures } = await import("/static/js/resultfigures.js");
  return [...qualityFigures(metrics), ...dataFigures(statistics)].map((one) => ({
    title: one.querySelector("h3").textContent,
    bars: [...one.querySelectorAll("svg.chart rect")].map((bar) =>
      [bar.textContent, Number(bar.getAttribute("height"))]),
    marks: [...one.querySelectorAll("svg.chart circle")].map((mark) =>
      [Number(mark.getAttribute("cx")), Number(mark.getAttribute("cy"))]),
  }));
}"""
#: How far the trajectories lie beneath what is seen, px.
BENEATH = "document.getElementById('tracks').getBoundingClientRect().top - window.innerHeight"


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


def test_figures_that_nobody_has_scrolled_to_are_there_to_be_printed(signed_in: Visit, job: str) -> None:
    signed_in.page.set_viewport_size({"width": 1280, "height": 120})
    page = signed_in.open(f"/jobs/{job}/results")
    page.locator("#tracks path.line").wait_for(state="attached")
    assert page.evaluate(BENEATH) > 400
    assert page.evaluate("window.scrollY") == 0
    page.emulate_media(media="print")
    assert page.locator("#tracks svg.chart").is_visible()
    assert page.get_by_text("Loading …").count() == 0


def test_what_is_dark_on_the_screen_is_printed_dark_on_white(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/results")
    page.locator("#quality table").first.wait_for()
    ink = "getComputedStyle(document.querySelector('#quality td')).color"
    light = page.evaluate(ink)
    for _ in ("light", "dark"):
        page.get_by_role("button", name=re.compile("^Colours")).click()
    assert page.evaluate(ink) != light
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate(ink) == light
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


def test_a_figure_is_saved_as_numbers_as_drawing_and_as_picture(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/results")
    for name, begins in (
        ("save the numbers as CSV", b"track_id,"),
        ("save as SVG", b"<svg"),
        ("save as PNG", b"\x89PNG"),
    ):
        with page.expect_download() as download:
            page.get_by_role("button", name=f"Trajectories: {name}").click()
        assert download.value.path().read_bytes().startswith(begins), name


def test_a_figure_that_cannot_be_loaded_says_what_to_do(signed_in: Visit, job: str) -> None:
    signed_in.page.route("**/tracks/paths", lambda route: route.abort())
    page = signed_in.open(f"/jobs/{job}/results")
    page.locator("#tracks").get_by_text("This could not be loaded; reload the page to ask again.").wait_for()
    page.get_by_role("alert").get_by_text("The service does not answer.").wait_for()
    page.locator("#quality table").first.wait_for()  # all else is there
    page.unroute_all()
    page.reload()
    page.locator("#tracks path.line").wait_for(state="attached")
    signed_in.forgive("ERR_FAILED")


def test_bars_and_marks_are_as_high_as_the_numbers(signed_in: Visit) -> None:
    """By visibility, reliability, and what the data set holds."""

    def part(low: float, high: float, iou: float) -> dict[str, object]:
        return {"low": low, "high": high, "bev_iou": {"mean": iou, "sd": 0.1}, "recall": 0.5, "matched": 3, "missed": 3}

    metrics = {
        "by_visibility": {
            "baseline": [part(0, 0.5, 0.2), part(0.5, 1, 0.4)],
            "finetuned": [part(0, 0.5, 0.6), part(0.5, 1, 0.8)],
        },
        "reliability": {
            "finetuned": {
                "yaw": {"count": 9, "coverage": {"level": [0.5, 1], "laplace": [0.25, 0.75], "normal": [0, 1]}}
            }
        },
    }
    counts = {"by_views": {"2": 30, "3": 10}, "by_class": {"car": 6, "bus": 2}, "boxes_by_camera": {"cam1": 8}}
    histogram = {"edges": [0, 10, 20], "counts": [1, 4]}
    spread = dict.fromkeys(("depth_m", "elevation_deg", "vehicles_per_instant", "sightings_per_track"), histogram)
    signed_in.page.get_by_role("heading", name="Jobs").wait_for()
    found = signed_in.page.evaluate(FIGURES, [metrics, {**counts, **spread}])
    shown = {one["title"]: one for one in found}
    assert len(shown) == 9
    for title, heights in (
        (
            "By visibility",
            {"Baseline, 0–50": 0.2, "Fine-tuned, 0–50": 0.6, "Baseline, 50–100": 0.4, "Fine-tuned, 50–100": 0.8},
        ),
        ("Views of a vehicle", {"Views of a vehicle, 2": 30, "Views of a vehicle, 3": 10}),
        ("Road users by class", {"Road users by class, car": 6, "Road users by class, bus": 2}),
        ("Distance", {"Distance, 0": 1, "Distance, 10": 4}),
    ):
        bars = {text.rpartition(":")[0]: height for text, height in shown[title]["bars"]}
        assert set(bars) == set(heights)
        per_unit = [bars[name] / value for name, value in heights.items()]
        assert per_unit == pytest.approx([per_unit[0]] * len(per_unit)) and per_unit[0] > 0
    (x, y), (x_later, y_later) = shown["Reliability of yaw"]["marks"]
    assert x_later > x and y_later < y, "half of the errors more lie within the wider intervals"
