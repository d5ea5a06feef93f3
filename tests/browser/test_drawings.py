"""What is drawn: the ground in a camera's frame as the core projects it, colours and trails on the player's plan."""

from __future__ import annotations

from colorsys import hls_to_rgb
from typing import Any

import numpy as np
import pytest

from tests.browser.conftest import Visit
from tests.builders import corner_rig
from tests.finished import finished_job
from tests.service import LiveApi
from wibam_core.geometry.camera import Camera

#: Keeps the lines that a canvas strokes from now on: colour, dashes, opacity and corners in px of the canvas.
RECORD = """() => {
  const of = CanvasRenderingContext2D.prototype, kept = window.strokes = [], { beginPath, moveTo, lineTo, stroke } = of;
  of.beginPath = function () { this.corners = []; return beginPath.call(this); };
  of.moveTo = function (x, y) { this.corners?.push([x, y]); return moveTo.call(this, x, y); };
  of.lineTo = function (x, y) { this.corners?.push([x, y]); return lineTo.call(this, x, y); };
  of.stroke = function () {
    kept.push({ canvas: this.canvas.id, colour: this.strokeStyle, dashed: this.getLineDash().length > 0,
      alpha: this.globalAlpha, corners: this.corners ?? [] });
    return stroke.call(this);
  };
}"""


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


def hsl(hue_deg: float, saturation: float, lightness: float) -> str:
    """A colour as a canvas gives it back."""
    return "#" + "".join(f"{round(255 * one):02x}" for one in hls_to_rgb(hue_deg / 360, lightness, saturation))


def strokes(page: Any, canvas: str) -> list[dict[str, Any]]:
    """What has been drawn on a canvas since it was last asked."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    found = page.evaluate("canvas => window.strokes.splice(0).filter((one) => one.canvas === canvas)", canvas)
    return list(found)


def px(camera: Camera, world: np.ndarray, scale: float) -> np.ndarray:
    """Where the core sees points, in px of the canvas."""
    pixels, _ = camera.project(world)
    return np.asarray((pixels + 0.5) * scale)


def test_grid_and_horizon_lie_where_the_core_projects_them(signed_in: Visit, api: LiveApi) -> None:
    """Pieces of the grid's lines end where lines cross; the camera looks at the world's origin."""
    site = api.site(cameras=1)
    camera = corner_rig(1)["cam1"]
    signed_in.page.add_init_script(f"({RECORD})()")
    page = signed_in.open(f"/sites/{site}/cameras/cam1")
    page.locator("#solution dd").first.wait_for()
    scale = page.evaluate("document.getElementById('frame').width") / camera.width_px
    drawn = strokes(page, "frame")
    grid = np.array(
        [corner for one in drawn if one["colour"] == "rgba(90, 200, 255, 0.5)" for corner in one["corners"]]
    )
    crossings = np.array([[x, y, 0.0] for x in range(-10, 11, 5) for y in range(-10, 11, 5)])
    for place in px(camera, crossings, scale):
        assert np.hypot(*(grid - place).T).min() < 0.1
    horizon = next(np.array(one["corners"]) for one in drawn if one["colour"] == "#ffd54a" and one["dashed"])
    x, y, height_m = camera.centre_m
    [ahead] = px(camera, np.array([[-1e5 * x, -1e5 * y, height_m]]), scale)
    assert np.hypot(*(horizon - ahead).T).min() < 0.1


@pytest.mark.parametrize(
    ("by", "car", "bus"),
    [("track", "#d55e00", "#009e73"), ("speed", hsl(115, 0.85, 0.49), hsl(230, 0.85, 0.42)), ("class", "", "")],
)
def test_trails_are_as_long_and_as_coloured_as_asked(
    signed_in: Visit, api: LiveApi, job: str, by: str, car: str, bus: str
) -> None:
    """At 4 s the car has driven along X at 10 m/s all the time; the bus stands."""
    signed_in.page.add_init_script(f"({RECORD})()")
    page = signed_in.open(f"/jobs/{job}/player?time_ns=4000000000")
    page.get_by_text("100 of 100 states").wait_for()
    page.locator("#present option:nth-child(3)").wait_for(state="attached")
    if by == "class":
        classes = api.http.get(f"/v1/jobs/{job}/scene").json()["classes"]
        car, bus = (next(one["colour"] for one in classes if one["name"] == name) for name in ("car", "bus"))
        assert car != bus
    strokes(page, "plan")
    page.get_by_label("Colour by").select_option("speed" if by == "track" else "track")
    page.get_by_label("Colour by").select_option(by)
    lengths_px = []
    for seconds in (2, 3):
        page.locator("#trail").fill(str(seconds))
        strokes(page, "plan")
        page.locator("#trail").dispatch_event("input")
        trails = {one["colour"]: np.array(one["corners"]) for one in strokes(page, "plan") if one["alpha"] < 1}
        trails = {colour: corners for colour, corners in trails.items() if colour in (car, bus)}
        assert set(trails) == {car, bus}
        assert np.ptp(trails[car][:, 1]) < 0.01, "Y does not change"
        assert np.ptp(trails[bus], axis=0) == pytest.approx(0, abs=0.01)
        lengths_px.append(np.ptp(trails[car][:, 0]))
    assert lengths_px[1] / lengths_px[0] == pytest.approx(1.5, abs=0.01)
    page.locator("#trail").fill("0")
    strokes(page, "plan")
    page.locator("#trail").dispatch_event("input")
    assert [one for one in strokes(page, "plan") if one["colour"] in (car, bus)] == []
