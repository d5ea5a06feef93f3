"""Wide lenses against OpenCV's own projection, and against their formula written out once more."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import look_at
from wibam_core.geometry.box3d import corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.cut_view import CutView
from wibam_core.geometry.ground import intersect_plane
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import SE3
from wibam_core.geometry.torch_ops import CameraTensors

SIZE = (1280, 960)
FISHEYE = (0.02, -0.01, 0.003, -0.0005)
OMNI = (-0.08, 0.015, 0.001, -0.0008)
#: Straight down from 10 m, as poles carry fisheyes.
DOWN = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 10.0]))


def wide(lens: str, dist: tuple[float, ...] = (), xi: float = 0.0, pose: SE3 = DOWN, focal_px: float = 322.0) -> Camera:
    K = np.array([[focal_px, 0.4, 632.7], [0, focal_px * 1.01, 473.8], [0, 0, 1]])
    return Camera(K, np.array(dist), pose, *SIZE, lens, xi)


def written_out(camera: Camera, point: np.ndarray) -> np.ndarray:
    """Mei's projection, one number after the other (cv2.omnidir's documentation)."""
    k1, k2, p1, p2 = camera.dist
    x, y, z = point / np.sqrt(point @ point)
    x, y = x / (z + camera.xi), y / (z + camera.xi)
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return (camera.K @ [u, v, 1.0])[:2]


@given(st.integers(0, 10_000))
def test_convention_a_fisheye_projects_as_cv2_fisheye_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    dist = tuple(rng.normal(0, [0.03, 0.01, 0.003, 0.0005]))
    camera = wide("fisheye", dist, pose=SE3.identity())
    points = rng.normal(size=(50, 3))
    points[:, 2] = np.abs(points[:, 2]) + 0.2
    seen = camera.sees(points)
    skew = camera.K[0, 1] / camera.K[0, 0]
    K = camera.K * [[1, 0, 1], [1, 1, 1], [1, 1, 1]]
    expected, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, np.array(dist), alpha=skew)
    np.testing.assert_allclose(camera.project(points)[0][seen], expected[seen, 0], atol=1e-8)
    assert seen.any()


@given(st.integers(0, 10_000))
def test_convention_an_omnidirectional_lens_projects_by_mei(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = wide("omnidirectional", OMNI, float(rng.uniform(0, 1.6)), SE3.identity(), focal_px=800.0)
    directions = camera.rays(rng.uniform(0, SIZE, (50, 2)))
    points = directions * rng.uniform(1, 50, (50, 1))
    expected = [written_out(camera, point) for point in points]
    np.testing.assert_allclose(camera.project(points)[0], expected, atol=1e-6)


@pytest.mark.parametrize(
    "camera",
    [wide("fisheye"), wide("fisheye", FISHEYE)]
    + [wide("omnidirectional", OMNI, xi, focal_px=900.0) for xi in (0.0, 0.7, 1.0, 1.4)],
)
def test_every_wide_lens_has_an_exact_inverse(camera: Camera) -> None:
    pixels = np.random.default_rng(0).uniform(-0.5, np.array(SIZE) - 0.5, (2000, 2))
    pixels[0] = camera.K[:2, 2]
    rays = camera.rays(pixels)
    shown = np.isfinite(rays).all(axis=1)
    assert shown[np.hypot(*(pixels - camera.K[:2, 2]).T) < 300].all()
    np.testing.assert_allclose(np.linalg.norm(rays[shown], axis=1), 1.0, atol=1e-9)
    back, _ = camera.project(camera.centre_m + 7.0 * rays[shown])
    np.testing.assert_allclose(back, pixels[shown], atol=1e-7)


def test_a_fisheye_sees_beside_and_behind_itself_as_far_as_its_formula_goes() -> None:
    camera = wide("fisheye", pose=SE3.identity())
    degrees = np.radians([0.0, 80.0, 100.0, 165.0, 175.0])
    points = np.stack([np.sin(degrees), 0 * degrees, np.cos(degrees)], axis=1)
    pixels, depth = camera.project(points)
    # equidistant: as many pixels from the middle as radians from the axis
    np.testing.assert_allclose(pixels[:4, 0], 632.7 + 322.0 * degrees[:4], atol=1e-9)
    assert np.isnan(pixels[4]).all()
    assert depth[2] < 0
    assert np.isnan(camera.undistort(pixels[2])).all()
    folding = wide("fisheye", (-0.2, 0.0, 0.0, 0.0), pose=SE3.identity())
    # θ − 0.2 θ³ begins to fold at θ² = 1 / 0.6
    assert folding.wide_lens.limit_rad == pytest.approx(np.sqrt(1 / 0.6), abs=0.05)


def test_pixels_of_the_ground_lead_back_to_it_all_around() -> None:
    camera = wide("fisheye", FISHEYE)
    angle, distance = np.random.default_rng(1).uniform([0, 0], [2 * np.pi, 40], (200, 2)).T
    ground = np.stack([distance * np.cos(angle), distance * np.sin(angle), 0 * angle], axis=1)
    pixels, _ = camera.project(ground)
    np.testing.assert_allclose(intersect_plane(camera, pixels), ground, atol=1e-6)


@pytest.mark.parametrize(
    "camera", [wide("fisheye", FISHEYE), wide("omnidirectional", OMNI, 1.1, focal_px=900.0)], ids=["fisheye", "omni"]
)
def test_the_box_of_a_bent_vehicle_touches_all_of_its_surface_and_no_more(camera: Camera) -> None:
    boxes = np.array([[0.5, -5, 1.5, 12, 2.5, 3, 0.0], [-9, 6, 0.8, 4.5, 1.8, 1.6, 2.0], [0.5, 0.2, 1, 5, 2, 2, 0]])
    share = np.linspace(-1, 1, 101)
    for box, found in zip(boxes, project_boxes(camera, boxes, clamp=False), strict=True):
        half = box[3:6] / 2
        a, b = (g.ravel() for g in np.meshgrid(share, share))
        sides = [
            np.insert(np.stack([a, b], axis=1), axis, sign, axis=1) * half for axis in range(3) for sign in (-1.0, 1.0)
        ]
        c, s = np.cos(box[6]), np.sin(box[6])
        surface = np.concatenate(sides) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + box[:3]
        pixels, _ = camera.project(surface)
        np.testing.assert_allclose(found, [*pixels.min(axis=0), *pixels.max(axis=0)], atol=0.3)
    straight, _ = camera.project(corners(boxes[:1])[0])
    assert np.abs(project_boxes(camera, boxes[:1])[0] - [*straight.min(axis=0), *straight.max(axis=0)]).max() > 2


def test_a_resized_picture_shows_the_same_rays() -> None:
    camera = wide("omnidirectional", OMNI, 1.1, focal_px=900.0)
    half = camera.resized(640, 480)
    pixels = np.random.default_rng(2).uniform(0, 400, (20, 2))
    np.testing.assert_allclose(half.rays(pixels), camera.rays((pixels + 0.5) * 2 - 0.5), atol=1e-9)


def test_a_cut_view_shows_what_a_pinhole_there_would_see() -> None:
    camera = wide("fisheye", FISHEYE)
    pinhole = look_at((0.0, 0.0, 10.0), (14.0, 9.0, 0.0), focal_px=300.0)
    view = CutView("v.1", camera.T_world_cam.rotation.T @ pinhole.T_world_cam.rotation, pinhole.K, *pinhole.size_px)
    points = np.random.default_rng(3).uniform([5, 0, 0], [30, 20, 3], (50, 3))
    np.testing.assert_allclose(view.camera(camera).project(points)[0], pinhole.project(points)[0], atol=1e-9)
    # a picture whose colours are its own pixels' places tells where each pixel of the view was taken
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    places = np.stack([u / 8, v / 8, 0 * u], axis=-1).astype(np.uint8)
    cut = view.cutter(camera).cut(places)
    seen, _ = camera.project(pinhole.centre_m + 5 * pinhole.rays([[100.0, 60.0], [500.0, 300.0], [320.0, 200.0]]))
    for (x, y), place in zip([(100, 60), (500, 300), (320, 200)], seen, strict=True):
        np.testing.assert_allclose(cut[y, x, :2].astype(float) * 8 + 4, place, atol=9)


def test_what_makes_no_wide_lens_is_refused() -> None:
    with pytest.raises(ValueError, match="0 or 4"):
        wide("fisheye", (0.1, 0.2, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="xi"):
        wide("fisheye", (), xi=1.0)
    with pytest.raises(ValueError, match="views"):
        CameraTensors.from_cameras([wide("fisheye")])
