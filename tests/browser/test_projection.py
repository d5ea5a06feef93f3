"""Projection in the browser against the core's, on random boxes and lenses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from api.routes.scene import scene_camera
from tests.browser.conftest import Visit
from tests.builders import look_at
from wibam_core.geometry.box3d import corners
from wibam_core.geometry.ground import intersect_plane
from wibam_core.geometry.projection import project_boxes
from wibam_core.site import Lens

LENSES: dict[str, tuple[Lens, tuple[float, ...], float]] = {
    "pinhole": ("pinhole", (), 0.0),
    "barrel": ("pinhole", (-0.28, 0.09, 0.001, -0.0005, -0.01), 0.0),
    "rational": (
        "pinhole",
        (0.4, 0.1, 0.0008, -0.0004, 0.01, 0.75, 0.2, 0.02, 0.001, -0.002, 0.001, 0.0005),
        0.0,
    ),
    "fisheye": ("fisheye", (0.05, -0.02, 0.004, -0.0006), 0.0),
    "omnidirectional": ("omnidirectional", (-0.1, 0.02, 0.0005, -0.0003), 0.9),
}
SCRIPT = """async ([scene, boxes, pixels]) => {
  const { Camera, corners } = await import("/static/js/projection.js");
  const camera = new Camera(scene);
  return {
    corners: boxes.map(corners),
    projected: boxes.map((box) => corners(box).map((point) => camera.project(point))),
    around: boxes.map((box) => camera.boxAround(box)),
    ground: pixels.map((pixel) => camera.ground(pixel)),
  };
}"""


@pytest.mark.parametrize("kind", LENSES)
def test_it_is_the_cores(tab: Visit, kind: str) -> None:
    lens, dist, xi = LENSES[kind]
    pinhole = look_at((18.0, -14.0, 7.5), (2.0, 1.0, 0.0), focal_px=420.0 if lens == "pinhole" else 230.0)
    camera = replace(pinhole, dist=np.array(dist), lens=lens, xi=xi)
    rng = np.random.default_rng(3)
    count = 200
    boxes = np.column_stack(
        [
            rng.uniform(-40, 40, (count, 2)),
            rng.uniform(0.5, 2, count),
            rng.uniform(1, 12, (count, 1)),
            rng.uniform(0.6, 2.6, count),
            rng.uniform(1, 4, count),
            rng.uniform(-np.pi, np.pi, count),
        ]
    )
    pixels = rng.uniform((0, 0), (camera.width_px - 1, camera.height_px - 1), (count, 2))
    page = tab.open("/sign-in")
    scene = scene_camera("cam1", camera, None).model_dump()
    found = page.evaluate(SCRIPT, [scene, boxes.tolist(), pixels.tolist()])
    np.testing.assert_allclose(found["corners"], corners(boxes), atol=1e-9)
    expected, _ = camera.project(corners(boxes))
    seen = camera.sees(camera.to_camera(corners(boxes)))
    for box in range(count):
        for corner in range(8):
            uv = found["projected"][box][corner]
            assert (uv is None) == (not seen[box, corner])
            if uv is not None and np.abs(expected[box, corner]).max() < 5000:
                np.testing.assert_allclose(uv, expected[box, corner], atol=0.01)
    around = np.array([[np.nan] * 4 if box is None else box for box in found["around"]])
    np.testing.assert_allclose(around, project_boxes(camera, boxes), atol=0.1)
    assert np.isfinite(around).all(axis=1).sum() > 20
    ground = intersect_plane(camera, pixels)
    near = np.linalg.norm(ground - camera.centre_m, axis=1) < 200
    assert near.sum() > 50
    for index in np.flatnonzero(near):
        np.testing.assert_allclose(found["ground"][index], ground[index], atol=0.01)
