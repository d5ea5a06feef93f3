"""Laws and conventions of the rigid geometry."""

from __future__ import annotations

import cv2
import hypothesis.strategies as st
import numpy as np
import pytest
import shapely
import torch
from hypothesis import given, settings
from shapely.geometry import Polygon

from tests.builders import corner_rig, look_at
from wibam_core.geometry import torch_ops
from wibam_core.geometry.box3d import corners, footprints, vehicle_to_world
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane
from wibam_core.geometry.iou import bev_iou, bev_iou_paired, iou_3d_paired
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import SE3, normalise_angle
from wibam_core.scene import Vehicles3D

RATIONAL = (-0.3, 0.12, 0.001, -0.0007, -0.02)


def random_boxes(rng: np.random.Generator, n: int, spread_m: float = 12.0) -> np.ndarray:
    return np.column_stack(
        [
            rng.uniform(-spread_m, spread_m, (n, 2)),
            rng.uniform(0.5, 2.0, n),
            rng.uniform(0.5, 12, n),
            rng.uniform(0.5, 3, n),
            rng.uniform(1, 4, n),
            rng.uniform(-np.pi, np.pi, n),
        ]
    )


def random_se3(rng: np.random.Generator) -> SE3:
    return SE3.from_rvec_tvec(rng.normal(size=3), rng.normal(size=3) * 10)


# --- SE3 ---------------------------------------------------------------------------------------
@given(st.integers(0, 10_000))
def test_se3_laws(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = (random_se3(rng) for _ in range(3))
    points = rng.normal(size=(5, 3))
    np.testing.assert_allclose(((a @ b) @ c).matrix, (a @ (b @ c)).matrix, atol=1e-9)
    np.testing.assert_allclose((a @ a.inverse()).matrix, np.eye(4), atol=1e-9)
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-9)
    np.testing.assert_allclose(SE3.from_rvec_tvec(*a.to_rvec_tvec()).matrix, a.matrix, atol=1e-9)


def test_mirrored_rotation_is_refused() -> None:
    with pytest.raises(ValueError, match="mirrored"):
        SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3))


@given(st.floats(-1e3, 1e3))
def test_convention_angles_lie_in_minus_pi_exclusive_to_pi(angle: float) -> None:
    wrapped = float(normalise_angle(angle))
    assert -np.pi < wrapped <= np.pi
    assert np.isclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-9)


# --- cameras -----------------------------------------------------------------------------------
def test_convention_opencv_extrinsics_are_T_cam_world() -> None:
    camera = look_at((10, -7, 6), dist=RATIONAL)
    points = np.random.default_rng(0).uniform(-5, 5, (20, 3))
    rvec, tvec = camera.T_cam_world.to_rvec_tvec()
    expected, _ = cv2.projectPoints(points, rvec, tvec, camera.K.copy(), camera.dist.copy())
    pixels, depth = camera.project(points)
    assert (depth > 0).all()
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-6)


def test_convention_p_is_k_times_r_t() -> None:
    camera = look_at((10, -7, 6))
    x = np.array([1.0, 2.0, 0.5, 1.0])
    uvw = camera.P @ x
    np.testing.assert_allclose(uvw[:2] / uvw[2], camera.project(x[:3])[0])


def test_convention_camera_axes_are_right_down_forward() -> None:
    camera = look_at((-10, 0, 2), (0, 0, 2))  # looks along +X: left of it is +Y, up is +Z
    (u0, v0), (u1, v1) = camera.project(np.array([[0, 1.0, 2.0], [0, 0, 3.0]]))[0]
    assert u0 < camera.K[0, 2] and np.isclose(v0, camera.K[1, 2])
    assert v1 < camera.K[1, 2] and np.isclose(u1, camera.K[0, 2])


@given(st.integers(0, 10_000), st.booleans())
def test_rays_and_projection_are_inverse(seed: int, distorted: bool) -> None:
    rng = np.random.default_rng(seed)
    camera = look_at((15, 3, 7), dist=RATIONAL if distorted else ())
    pixels = rng.uniform(-0.5, [639.5, 359.5], (30, 2))
    points = camera.centre_m + camera.rays(pixels) * rng.uniform(1, 80, (30, 1))
    np.testing.assert_allclose(camera.project(points)[0], pixels, atol=1e-6)


def test_plane_intersection_lands_on_the_plane_and_refuses_the_sky() -> None:
    camera = look_at((15, 3, 7))
    target = np.array([2.0, -1.0, 0.6])
    pixel, _ = camera.project(target)
    np.testing.assert_allclose(intersect_plane(camera, pixel, 0.6), target, atol=1e-9)
    assert np.isnan(intersect_plane(look_at((15, 3, 7), (0, 0, 9)), np.array([320.0, 0.0]))).all()


def test_distortion_never_folds_far_points_into_the_image() -> None:
    camera = look_at((0, -20, 6), dist=(-0.4, 0.1, 0, 0))
    side = np.column_stack([np.linspace(20, 2000, 200), np.zeros(200), np.full(200, 1.0)])
    assert not camera.contains(camera.project(side)[0]).any()


def test_points_behind_the_camera_are_nan() -> None:
    pixels, depth = look_at((0, -20, 6)).project(np.array([0.0, -40.0, 6.0]))
    assert np.isnan(pixels).all() and depth < 0


@pytest.mark.parametrize("bad", [np.eye(2), np.diag([0.0, 1, 1]), np.full((3, 3), np.nan)])
def test_bad_intrinsics_are_refused(bad: np.ndarray) -> None:
    with pytest.raises(ValueError):
        Camera(bad, np.zeros(0), SE3.identity(), 10, 10)


# --- boxes -------------------------------------------------------------------------------------
def test_convention_yaw_is_counter_clockwise_from_x_and_corner_zero_is_front_left() -> None:
    box = np.array([1, 2, 0.75, 4, 2, 1.5, np.pi / 2])  # drives along +Y: its left is −X
    np.testing.assert_allclose(corners(box)[0], [0, 4, 0], atol=1e-12)
    np.testing.assert_allclose(corners(box)[7], [2, 4, 1.5], atol=1e-12)
    np.testing.assert_allclose(vehicle_to_world(box, [[2, 1, -0.75]]), [[0, 4, 0]], atol=1e-12)


def test_footprints_run_counter_clockwise() -> None:
    for ring in footprints(random_boxes(np.random.default_rng(1), 20)):
        assert shapely.is_ccw(shapely.linearrings(np.vstack([ring, ring[:1]])))


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan])
def test_impossible_boxes_are_refused(size: float) -> None:
    with pytest.raises(ValueError):
        Vehicles3D.of(0, np.array([[0, 0, 0, size, 1, 1, 0]]))


# --- IoU ---------------------------------------------------------------------------------------
def test_bev_iou_equals_shapely() -> None:
    rng = np.random.default_rng(2)
    a, b = random_boxes(rng, 2000, 4), random_boxes(rng, 2000, 4)
    expected = [
        (p := Polygon(fa)).intersection(q := Polygon(fb)).area / p.union(q).area
        for fa, fb in zip(footprints(a), footprints(b), strict=True)
    ]
    np.testing.assert_allclose(bev_iou_paired(a, b), expected, atol=1e-9)


def test_iou_3d_equals_shapely_times_the_overlap_in_height() -> None:
    rng = np.random.default_rng(6)
    a, b = random_boxes(rng, 2000, 4), random_boxes(rng, 2000, 4)
    b[::4, 2] += rng.uniform(-6, 6, 500)  # some pass above or below each other
    expected = []
    for box_a, box_b, fa, fb in zip(a, b, footprints(a), footprints(b), strict=True):
        (_, _, za, la, wa, ha, _), (_, _, zb, lb, wb, hb, _) = box_a, box_b
        height = max(0.0, min(za + ha / 2, zb + hb / 2) - max(za - ha / 2, zb - hb / 2))
        common = Polygon(fa).intersection(Polygon(fb)).area * height
        expected.append(common / (la * wa * ha + lb * wb * hb - common))
    found = iou_3d_paired(a, b)
    assert (found > 0).sum() > 500
    assert ((found == 0) & (bev_iou_paired(a, b) > 0)).sum() > 50
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@given(st.integers(0, 10_000))
@settings(max_examples=50)
def test_iou_laws(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_boxes(rng, 8, 5), random_boxes(rng, 8, 5)
    iou = bev_iou(a, b)
    np.testing.assert_allclose(iou, bev_iou(b, a).T, atol=1e-12)
    assert ((iou >= 0) & (iou <= 1 + 1e-12)).all()
    np.testing.assert_allclose(bev_iou_paired(a, a), 1, atol=1e-12)
    np.testing.assert_allclose(iou_3d_paired(a, a), 1, atol=1e-12)
    turned = a.copy()
    turned[:, 6] += np.pi
    np.testing.assert_allclose(bev_iou_paired(a, turned), 1, atol=1e-9)
    shift = np.concatenate([rng.normal(size=3) * 100, np.zeros(4)])
    np.testing.assert_allclose(iou_3d_paired(a + shift, b + shift), iou_3d_paired(a, b), atol=1e-9)


@given(st.floats(1, 12), st.floats(0.1, 1), st.floats(-np.pi, np.pi), st.floats(0, 1e-12), st.integers(0, 3))
def test_edges_that_all_but_coincide_do_not_matter(
    length_m: float, slimness: float, yaw_rad: float, off_m: float, quarters: int
) -> None:
    width_m = length_m * slimness
    box = [20.0, -30.0, 1.0, length_m, width_m, 2.0, yaw_rad]
    turned = [20.0 + off_m, -30.0 - off_m, 1.0, length_m, width_m, 2.0, yaw_rad + quarters * np.pi / 2 + off_m]
    expected = 1.0 if quarters % 2 == 0 else slimness / (2 - slimness)
    np.testing.assert_allclose(bev_iou_paired([box], [turned]), expected, atol=1e-9)


def test_iou_of_touching_and_nested_boxes() -> None:
    box = np.array([0, 0, 1, 4, 2, 2, 0.0])
    touching = box + [4, 0, 0, 0, 0, 0, 0]
    nested = box * [1, 1, 1, 0.5, 1, 1, 1]
    above = box + [0, 0, 2, 0, 0, 0, 0]
    np.testing.assert_allclose(bev_iou_paired([box, box], [touching, nested]), [0, 0.5], atol=1e-12)
    np.testing.assert_allclose(iou_3d_paired([box], [above]), 0, atol=1e-12)


# --- projection --------------------------------------------------------------------------------
def test_projection_in_front_is_the_hull_of_the_corners() -> None:
    rig = corner_rig()
    boxes = random_boxes(np.random.default_rng(3), 20, 5)
    for camera in rig.values():
        pixels, depth = camera.project(corners(boxes))
        assert (depth > 0).all()
        expected = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
        np.testing.assert_allclose(project_boxes(camera, boxes, clamp=False), expected, atol=1e-9)


@pytest.mark.parametrize("dist", [(), RATIONAL, (-0.40, 0.20, 0, 0, -0.06)])
def test_corners_behind_the_camera_do_not_flip_the_box(dist: tuple[float, ...]) -> None:
    camera = look_at((0, 0, 1.5), (10, 0, 1.5), dist=dist)
    beside = np.array([0.0, -3.0, 1.0, 8.0, 2.0, 2.0, 0.0])  # half in front, half behind, on the right
    u0, v0, u1, v1 = project_boxes(camera, beside)[0]
    assert u0 > camera.K[0, 2] and u1 == camera.width_px - 0.5
    assert v0 < v1
    behind = beside + [-10, 0, 0, 0, 0, 0, 0]
    assert np.isnan(project_boxes(camera, behind)).all()


# --- torch twins -------------------------------------------------------------------------------
@pytest.mark.parametrize("dist", [(), RATIONAL])
def test_torch_twins_agree_with_numpy(dist: tuple[float, ...]) -> None:
    rng = np.random.default_rng(4)
    rig = corner_rig(dist=dist)
    boxes = random_boxes(rng, 50, 30)
    cameras = torch_ops.CameraTensors.from_cameras(list(rig.values()), dtype=torch.float64)
    batch = torch.tensor(boxes).expand(len(rig), -1, -1)
    np.testing.assert_allclose(torch_ops.corners(torch.tensor(boxes)).numpy(), corners(boxes), atol=1e-12)
    found, valid = torch_ops.tight_boxes(cameras, batch)
    pixels = torch.tensor(rng.uniform(0, [640, 360], (len(rig), 30, 2)))
    pixels[..., 1] = 180 + pixels[..., 1] / 2
    planes = torch_ops.intersect_plane(cameras, pixels, torch.full(pixels.shape[:-1], 0.7, dtype=torch.float64))
    for v, camera in enumerate(rig.values()):
        expected = project_boxes(camera, boxes)
        np.testing.assert_array_equal(valid[v].numpy(), ~np.isnan(expected[:, 0]))
        np.testing.assert_allclose(found[v][valid[v]].numpy(), expected[valid[v].numpy()], atol=1e-6)
        np.testing.assert_allclose(planes[v].numpy(), intersect_plane(camera, pixels[v].numpy(), 0.7), atol=1e-8)
        np.testing.assert_allclose(cameras[v].centre_m.numpy(), camera.centre_m, atol=1e-9)


def test_reprojection_is_differentiable_even_across_the_near_plane() -> None:
    camera = look_at((0, 0, 1.5), (10, 0, 1.5), dist=(-0.1, 0.01, 0, 0))
    cameras = torch_ops.CameraTensors.from_cameras([camera], dtype=torch.float64)
    boxes = torch.tensor(
        [[[0.5, -3.0, 1.0, 8.0, 2.0, 2.0, 0.1], [12.0, 1.0, 1.0, 4.0, 2.0, 1.5, 0.7]]],
        dtype=torch.float64,
        requires_grad=True,
    )
    assert torch.autograd.gradcheck(lambda b: torch_ops.tight_boxes(cameras, b, clamp=False)[0], (boxes,))
    other = torch.tensor([[[300.0, 100, 500, 300], [200, 150, 330, 260]]], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda b: torch_ops.giou(torch_ops.tight_boxes(cameras, b)[0], other), (boxes,))


def test_giou_values() -> None:
    a = torch.tensor([[0.0, 0, 2, 2], [0, 0, 1, 1]], dtype=torch.float64)
    b = torch.tensor([[0.0, 0, 2, 2], [3, 0, 4, 1]], dtype=torch.float64)
    np.testing.assert_allclose(torch_ops.giou(a, b).numpy(), [1.0, -0.5])
