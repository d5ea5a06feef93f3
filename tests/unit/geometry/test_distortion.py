"""Lenses: the formula, its inverse inside and outside the image, and boxes whose edges it bends."""

from __future__ import annotations

from dataclasses import replace

import cv2
import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import given, settings

from tests.builders import look_at
from wibam_core.geometry import distortion, torch_ops
from wibam_core.geometry.box3d import EDGES, corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane
from wibam_core.geometry.projection import project_boxes

#: Its formula stops growing at a radius of 1.53, inside the image of a lens this wide.
FOLDING = (0.52, (-0.33, 0.13, 0.0, 0.0, -0.025))
#: Focal length in image widths, and coefficients, of lenses that are one-to-one over the image; the first of them only
#: just.
STRONG = {
    "folds beside the image": (0.75, (-0.40, 0.20, 0.0, 0.0, -0.06)),
    "wide": (0.55, (-0.25, 0.06, 0.0, 0.0, -0.006)),
    "off centre": (0.75, (-0.30, 0.12, 0.02, -0.015, -0.02)),
    "pincushion": (0.60, (0.30, 0.10, 0.001, 0.0)),
    "rational and prism": (0.60, (-0.2, 0.05, 0.001, 0.001, 0.0, 0.1, 0.02, 0.003, 0.002, -0.001, 0.001, 0.002)),
}


def lens(focal_widths: float, dist: tuple[float, ...], width_px: int = 640, height_px: int = 360) -> Camera:
    return look_at(
        (0.0, -8.0, 5.5),
        (0.0, 2.0, 0.0),
        focal_px=focal_widths * width_px,
        width_px=width_px,
        height_px=height_px,
        dist=dist,
    )


def pixel_grid(camera: Camera, margin_px: float) -> np.ndarray:
    """(1271, 2) regular pixels of the image, and of a margin around it."""
    u = np.linspace(-0.5 - margin_px, camera.width_px - 0.5 + margin_px, 41)
    v = np.linspace(-0.5 - margin_px, camera.height_px - 0.5 + margin_px, 31)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def project_xy(camera: Camera, xy: np.ndarray) -> np.ndarray:
    return camera.project_camera_points(np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1))


def random_coefficients(rng: np.random.Generator) -> tuple[float, ...]:
    """Any lens at all, most of them worse than real ones; a quarter of them radial alone."""
    sd = np.array([0.4, 0.4, 0.02, 0.02, 0.1, 0.3, 0.3, 0.3, 0.02, 0.02, 0.02, 0.02])
    sd[[2, 5, 8, 12][rng.integers(4)] :] *= 0.0
    return tuple(rng.normal(0.0, 1.0, 12) * sd)


# --- the formula -------------------------------------------------------------------------------
@given(st.integers(0, 10_000))
@settings(max_examples=50)
def test_convention_coefficients_are_opencvs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    coefficients = random_coefficients(rng)
    points = np.concatenate([rng.uniform(-0.5, 0.5, (20, 2)), np.ones((20, 1))], axis=1)
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(coefficients))
    found = distortion.polynomial(coefficients, points[:, 0], points[:, 1])
    np.testing.assert_allclose(np.stack(found, axis=-1), expected[:, 0], rtol=1e-9, atol=1e-12)


@given(st.integers(0, 10_000))
@settings(max_examples=50)
def test_slopes_are_the_formulas_derivatives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    coefficients = random_coefficients(rng)
    x, y, step = *rng.uniform(-0.5, 0.5, (2, 20)), 1e-6
    across, down = (
        (
            np.array(distortion.polynomial(coefficients, x + dx, y + dy))
            - distortion.polynomial(coefficients, x - dx, y - dy)
        )
        / (2 * step)
        for dx, dy in ((step, 0.0), (0.0, step))
    )
    found = distortion.polynomial_slopes(coefficients, x, y)
    np.testing.assert_allclose(found, [across[0], down[0], across[1], down[1]], rtol=1e-6, atol=1e-7)


# --- its inverse -------------------------------------------------------------------------------
@given(st.integers(0, 100_000))
def test_every_lens_has_an_exact_inverse_inside_and_outside_the_image(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = lens(rng.uniform(0.3, 1.5), random_coefficients(rng))
    pixels = np.concatenate([pixel_grid(camera, 150.0), rng.normal(0.0, 1e5, (20, 2))])
    np.testing.assert_allclose(project_xy(camera, camera.undistort(pixels)), pixels, rtol=1e-9, atol=1e-8)
    xy = rng.normal(0.0, 3.0, (200, 2))
    np.testing.assert_allclose(camera.undistort(project_xy(camera, xy)), xy, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("focal_widths", "dist"), STRONG.values(), ids=STRONG)
def test_inside_the_image_the_inverse_is_that_of_opencvs_formula(focal_widths: float, dist: tuple[float, ...]) -> None:
    camera = lens(focal_widths, dist)
    pixels = pixel_grid(camera, 0.0)
    rays = np.concatenate([camera.undistort(pixels), np.ones((len(pixels), 1))], axis=1)
    back, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K.copy(), camera.dist.copy())
    np.testing.assert_allclose(back[:, 0], pixels, atol=1e-8)


def test_one_pixel_no_pixels_and_no_number() -> None:
    camera = lens(*STRONG["wide"])
    pixels = np.array([[10.0, 20.0], [np.nan, 5.0]])
    both = camera.undistort(pixels)
    assert np.isnan(both[1]).all()
    np.testing.assert_array_equal(camera.undistort(pixels[0]), both[0])
    assert camera.undistort(np.zeros((3, 0, 2))).shape == (3, 0, 2)


def test_the_limit_of_a_folding_lens_lies_where_the_formula_still_grows() -> None:
    k1, k2, _, _, k3 = FOLDING[1]
    folds = np.sqrt(min(r.real for r in np.roots([7 * k3, 5 * k2, 3 * k1, 1]) if abs(r.imag) < 1e-9 and r.real > 0))
    assert folds == pytest.approx(1.53, abs=0.005)
    camera = lens(*FOLDING)
    assert 0.9 * folds < camera.distortion_limit < folds
    beside = lens(*STRONG["folds beside the image"])
    inner = np.linalg.norm(beside.undistort(pixel_grid(beside, 0.0)), axis=1).max()
    assert inner < beside.distortion_limit < 1.3 * inner
    mild = lens(0.6, (-0.1, 0.01, 0.0, 0.0))
    inner = np.linalg.norm(mild.undistort(pixel_grid(mild, 0.0)), axis=1).max()
    assert mild.distortion_limit == pytest.approx(1.3 * inner)


def test_far_points_beside_the_view_stay_out_of_the_image_up_to_the_limit_and_beyond() -> None:
    camera = lens(*STRONG["folds beside the image"])
    border = np.abs(camera.undistort([[639.5, 359.5], [639.5, 179.5]])).max(axis=0)
    x = np.linspace(border[0] + 1e-3, 50.0, 5000)
    pixels = project_xy(camera, np.stack([x, np.zeros_like(x)], axis=1))
    assert (np.diff(pixels[:, 0]) > 0).all()
    assert not camera.contains(pixels).any()


def test_a_tilted_sensor_is_refused() -> None:
    with pytest.raises(ValueError, match="tilted"):
        lens(0.8, (*([0.0] * 12), 0.01, 0.0))
    assert lens(0.8, (-0.1, *([0.0] * 13))).has_distortion


# --- torch twins -------------------------------------------------------------------------------
LENSES = {**STRONG, "folds inside the image": FOLDING}


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-9), (torch.float32, 2e-4)])
@pytest.mark.parametrize("width_px", [640, 512])
def test_torch_undistorts_like_numpy_inside_and_outside_the_image(
    dtype: torch.dtype, tolerance: float, width_px: int
) -> None:
    cameras = [lens(*given, width_px, width_px * 9 // 16) for given in (*LENSES.values(), (0.8, ()))]
    pixels = np.concatenate([pixel_grid(cameras[0], 60.0), [[-1e4, 3e3], [2e4, 150.0]]])
    twin = torch_ops.CameraTensors.from_cameras(cameras, dtype)
    uv = torch.tensor(pixels, dtype=dtype).expand(len(cameras), -1, -1)
    found = torch_ops.undistort(twin, uv)
    back = torch_ops.project_camera_points(twin, torch.cat([found, torch.ones_like(found[..., :1])], dim=-1))
    assert found.dtype == dtype
    for v, camera in enumerate(cameras):
        expected = camera.undistort(pixels)
        np.testing.assert_allclose(found[v].numpy(), expected, rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(back[v].numpy(), project_xy(camera, expected), rtol=tolerance, atol=1e3 * tolerance)


def test_torch_meets_the_ground_like_numpy_under_strong_lenses() -> None:
    cameras = [lens(*given) for given in LENSES.values()]
    twin = torch_ops.CameraTensors.from_cameras(cameras, torch.float64)
    pixels = pixel_grid(cameras[0], 60.0)
    uv = torch.tensor(pixels).expand(len(cameras), -1, -1)
    ground = torch_ops.intersect_plane(twin, uv, torch.full(uv.shape[:-1], 0.7, dtype=torch.float64))
    for v, camera in enumerate(cameras):
        expected = intersect_plane(camera, pixels, 0.7)
        near = np.linalg.norm(expected - camera.centre_m, axis=1) < 200.0
        assert near.sum() > 500
        np.testing.assert_allclose(ground[v].numpy()[near], expected[near], rtol=1e-7, atol=1e-7)


def test_undistortion_is_differentiable_in_pixels_and_camera() -> None:
    cameras = [lens(*LENSES[name]) for name in ("folds beside the image", "rational and prism")]
    twin = torch_ops.CameraTensors.from_cameras(cameras, torch.float64)
    pixels = torch.tensor([[30.0, 20.0], [320.0, 180.0], [-45.0, -30.0], [690.0, 200.0]])
    uv = pixels.double().expand(len(cameras), -1, -1).clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda u: torch_ops.undistort(twin, u), (uv,))
    K, dist = twin.K.clone().requires_grad_(), twin.dist.clone().requires_grad_()

    def of_camera(K: torch.Tensor, dist: torch.Tensor) -> torch.Tensor:
        return torch_ops.undistort(replace(twin, K=K, dist=dist), uv.detach())

    assert torch.autograd.gradcheck(of_camera, (K, dist), atol=1e-4)


# --- boxes -------------------------------------------------------------------------------------
def near_vehicles(count: int = 600) -> np.ndarray:
    rng = np.random.default_rng(8)
    height = rng.uniform(1.4, 3.5, count)
    return np.column_stack(
        [
            rng.uniform(-15, 15, count),
            rng.uniform(-6, 25, count),
            height / 2,
            rng.uniform(3.5, 14, count),
            rng.uniform(1.7, 2.6, count),
            height,
            rng.uniform(-np.pi, np.pi, count),
        ]
    )


def hull(camera: Camera, boxes: np.ndarray, points_per_edge: int) -> np.ndarray:
    """(N, 4) around points along the edges, none of which may be behind the camera; NaN for those not all in view."""
    ends = corners(boxes)[:, EDGES]
    share = np.linspace(0.0, 1.0, points_per_edge)[:, None]
    points = ends[:, :, None, 0] * (1 - share) + ends[:, :, None, 1] * share
    pixels, _ = camera.project(points.reshape(len(boxes), -1, 3))
    in_view = camera.contains(pixels).all(axis=1)
    return np.where(in_view[:, None], np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1), np.nan)


@pytest.mark.parametrize(("focal_widths", "dist"), STRONG.values(), ids=STRONG)
def test_boxes_hold_edges_that_the_lens_bends(focal_widths: float, dist: tuple[float, ...]) -> None:
    camera, boxes = lens(focal_widths, dist), near_vehicles()
    exact = hull(camera, boxes, 101)
    in_view = ~np.isnan(exact[:, 0])
    assert in_view.sum() > 100
    found = project_boxes(camera, boxes)
    assert np.nanmax(np.abs(found - exact)) < 0.4
    assert np.nanmax(np.abs(hull(camera, boxes, 2) - exact)) > 1.0  # the corners alone would not do


def test_without_distortion_boxes_are_exactly_those_of_the_corners() -> None:
    camera, boxes = lens(0.55, ()), near_vehicles()
    corner_hull = hull(camera, boxes, 2)
    in_view = ~np.isnan(corner_hull[:, 0])
    np.testing.assert_array_equal(project_boxes(camera, boxes)[in_view], corner_hull[in_view])


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_a_camera_without_distortion_is_exact_beside_one_that_has_it(dtype: torch.dtype) -> None:
    camera, boxes = lens(0.55, ()), torch.tensor(near_vehicles(), dtype=dtype)
    boxes[::2, 6] = 0.0  # edges along image rows, where a rounding error decides which point is outermost
    alone = torch_ops.CameraTensors.from_cameras([camera], dtype)
    beside_another = torch_ops.CameraTensors.from_cameras([lens(*STRONG["wide"]), camera], dtype)
    expected, seen = torch_ops.tight_boxes(alone, boxes[None])
    found, seen_beside = torch_ops.tight_boxes(beside_another, boxes.expand(2, -1, -1))
    assert seen.sum() > 100
    assert torch.equal(seen_beside[1], seen[0])
    assert torch.equal(found[1], expected[0])


@pytest.mark.parametrize("clamp", [True, False])
def test_torch_boxes_equal_numpys_under_strong_lenses_and_across_the_near_plane(clamp: bool) -> None:
    cameras, boxes = [lens(*given) for given in LENSES.values()], near_vehicles()
    boxes[:300, 1] -= 8.0  # under and behind the cameras
    twin = torch_ops.CameraTensors.from_cameras(cameras, torch.float64)
    found, seen = torch_ops.tight_boxes(twin, torch.tensor(boxes).expand(len(cameras), -1, -1), clamp=clamp)
    depths = cameras[0].to_camera(corners(boxes))[..., 2]
    assert ((depths.min(axis=1) < 0) & (depths.max(axis=1) > 0)).sum() > 50
    for v, camera in enumerate(cameras):
        expected = project_boxes(camera, boxes, clamp=clamp)
        np.testing.assert_array_equal(seen[v].numpy(), ~np.isnan(expected[:, 0]))
        np.testing.assert_allclose(found[v][seen[v]].numpy(), expected[seen[v].numpy()], rtol=1e-9, atol=1e-6)


def test_boxes_under_a_strong_lens_are_differentiable() -> None:
    twin = torch_ops.CameraTensors.from_cameras([lens(*STRONG["wide"])], torch.float64)
    boxes = torch.tensor(near_vehicles(12)[None], requires_grad=True)
    assert torch.autograd.gradcheck(lambda b: torch_ops.tight_boxes(twin, b, clamp=False)[0], (boxes,))
