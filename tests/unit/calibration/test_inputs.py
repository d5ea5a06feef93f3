"""Calibrations as people bring them: other units, axes, origins and conventions than asked for."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.builders import look_at
from tests.stage_folders import StageFolders
from wibam_core.calibration.matrices import intrinsics_cautions
from wibam_core.calibration.residuals import Residuals, misfit_problem
from wibam_core.calibration.rig import solve_camera
from wibam_core.config import CalibrateConfig
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.site import Site, SiteCamera
from wibam_core.stages import calibrate as stage

ROAD = np.array([[-9, -6], [-4, 5], [3, -3], [8, 7], [2, 9], [-3, -2], [9, 2], [-7, 3]], dtype=float)
GROUND = np.concatenate([ROAD, np.zeros((8, 1))], axis=1)
RAISED = np.concatenate([GROUND, [[-9, -6, 3.2], [8, 7, 4.0], [3, -3, 2.5]]])
UTM = np.array([691_234.5, 5_334_567.25, 0.0])
CONFIG = CalibrateConfig()
CAMERA = look_at((-20.0, -15.0, 8.0), focal_px=700.0)


def entry(kind: str, world: np.ndarray, pixels: np.ndarray, camera: Camera = CAMERA, **intrinsics) -> SiteCamera:
    points = [{"world": w.tolist(), "pixel": p.tolist()} for w, p in zip(world, pixels, strict=True)]
    calibration = {"kind": kind, "correspondences": points}
    if kind == "pnp":
        calibration |= {"K": camera.K.tolist(), "dist": camera.dist.tolist(), **intrinsics}
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    return SiteCamera.model_validate({"id": "pole", **size, "calibration": calibration})


def clicked(points: np.ndarray, camera: Camera = CAMERA, noise_px: float = 0.4, seed: int = 0) -> np.ndarray:
    pixels, _ = camera.project(points)
    assert camera.contains(pixels).all()
    return pixels + np.random.default_rng(seed).normal(0, noise_px, pixels.shape)


def points_for(kind: str) -> np.ndarray:
    return GROUND if kind == "homography" else RAISED


def matrices(rvec, tvec, **change) -> SiteCamera:
    calibration = {"kind": "matrices", "K": CAMERA.K.tolist(), "rvec": list(rvec), "tvec": list(tvec), **change}
    size = {"width_px": CAMERA.width_px, "height_px": CAMERA.height_px}
    return SiteCamera.model_validate({"id": "pole", **size, "calibration": calibration})


def codes(result: Residuals) -> list[str]:
    return [caution.code for caution in result.cautions]


def refused(given: SiteCamera) -> str:
    with pytest.raises(CalibrationError) as caught:
        solve_camera(given, CONFIG)
    assert caught.value.hint
    return f"{caught.value.message} | {caught.value.hint}"


BOTH = pytest.mark.parametrize("kind", ["pnp", "homography"])


@BOTH
@pytest.mark.parametrize("origin", [np.zeros(3), UTM, np.array([2_600_000.0, 1_200_000.0, 0.0])])
def test_metres_in_any_grid_give_the_camera_without_a_word(kind, origin):
    points = points_for(kind)
    result = solve_camera(entry(kind, points + origin, clicked(points)), CONFIG)
    np.testing.assert_allclose(result.camera.centre_m - origin, CAMERA.centre_m, atol=0.3)
    assert np.isfinite(result.error_px).all()
    assert result.cautions == ()


@BOTH
@pytest.mark.parametrize(
    ("per_metre", "name"),
    [(1e-3, "kilometres"), (100.0, "centimetres"), (1000.0, "millimetres"), (1 / 0.0254, "inches")],
)
def test_units_are_refused_by_name(kind, per_metre, name):
    points = points_for(kind)
    assert name in refused(entry(kind, points * per_metre, clicked(points)))


@BOTH
@pytest.mark.parametrize("origin", [np.zeros(3), UTM])
def test_feet_are_warned_of_by_name(kind, origin):
    points = points_for(kind)
    result = solve_camera(entry(kind, (points + origin) / 0.3048, clicked(points)), CONFIG)
    [caution] = result.cautions
    assert caution.code == "check_units"
    assert "feet" in caution.hint and "8.0 m" in caution.hint


@BOTH
@pytest.mark.parametrize("order", [[0, 1, 2], [1, 0, 2]])
def test_degrees_are_refused_by_name(kind, order):
    points = points_for(kind)
    degrees = np.stack([11.57 + points[:, 0] / 74_000, 48.13 + points[:, 1] / 111_000, points[:, 2]], axis=1)
    assert "longitude and latitude" in refused(entry(kind, degrees[:, order], clicked(points)))


@BOTH
@pytest.mark.parametrize("axes", [[[1, 0, 0], [0, -1, 0], [0, 0, 1]], [[0, 1, 0], [1, 0, 0], [0, 0, 1]]])
def test_left_handed_axes_are_refused_by_name(kind, axes):
    points = points_for(kind)
    assert "mirrored" in refused(entry(kind, points @ np.array(axes, dtype=float), clicked(points)))


@pytest.mark.parametrize(
    ("axes", "words"), [([1.0, -1.0, -1.0], "Z axis points down"), ([1.0, 1.0, -1.0], "heights count downwards")]
)
def test_heights_that_count_downwards_are_refused_by_name(axes, words):
    assert words in refused(entry("pnp", RAISED * axes, clicked(RAISED)))


@BOTH
def test_pixels_counted_from_the_bottom_are_refused_by_name(kind):
    points = points_for(kind)
    pixels = clicked(points) * [1, -1] + [0, CAMERA.height_px - 1]
    assert "counted from the bottom" in refused(entry(kind, points, pixels))


def test_swapped_pixels_are_refused_by_name():
    camera = look_at((-20.0, -15.0, 8.0), focal_px=400.0, width_px=640, height_px=640)
    assert "swapped" in refused(entry("pnp", RAISED, clicked(RAISED, camera)[:, ::-1], camera))


@pytest.mark.parametrize("road_m", [34.0, 112.0, 512.0, -12.0])
@BOTH
def test_heights_above_the_sea_are_refused_with_the_offset(kind, road_m):
    points = points_for(kind)
    said = refused(entry(kind, points + [0, 0, road_m], clicked(points)))
    assert f"take {road_m:.2f} m off every z" in said.lower()


@pytest.mark.parametrize("road_m", [2.0, 5.0, -2.0])
def test_a_road_a_little_off_the_plane_is_warned_of_with_the_offset(road_m):
    slope = 0.1 * np.random.default_rng(1).normal(size=len(RAISED))[:, None] * [0, 0, 1]
    result = solve_camera(entry("pnp", RAISED + slope + [0, 0, road_m], clicked(RAISED, noise_px=0.1)), CONFIG)
    warned = next(caution for caution in result.cautions if caution.code == "road_level")
    assert warned.details["level_m"] == pytest.approx(road_m, abs=0.3)


def test_a_crowned_road_is_not_warned_of():
    crown = np.array([0.0, 0.0, 1.0]) * (0.15 - 0.02 * np.abs(RAISED[:, :1]))
    result = solve_camera(entry("pnp", RAISED + crown, clicked(RAISED + crown)), CONFIG)
    assert result.cautions == ()


def test_a_mistyped_coordinate_is_named():
    world = RAISED + UTM
    world[3, 1] -= 5_000_000.0
    assert "691242.50, 334574.25" in refused(entry("pnp", world, clicked(RAISED)))


def test_a_wrong_click_is_left_out_and_named():
    pixels = clicked(RAISED)
    pixels[4] += [60.0, -40.0]
    result = solve_camera(entry("pnp", RAISED, pixels), CONFIG)
    [caution] = result.cautions
    assert caution.code == "points_left_out"
    assert "1 of 11 points" in caution.message and "(2.00, 9.00, 0.00) by" in caution.message


def test_points_that_hardly_fix_the_camera_are_warned_of():
    clump = np.concatenate([0.05 * GROUND[:, :2] + [2.0, 1.0], np.zeros((8, 1))], axis=1)
    result = solve_camera(entry("pnp", clump, clicked(clump, noise_px=1.5)), CONFIG)
    assert "loose_camera" in codes(result)
    assert result.document().ground_sd_m == result.ground_sd_m
    assert result.ground_sd_m is not None and result.ground_sd_m > 1.0


def test_points_that_fit_poorly_are_warned_of():
    result = solve_camera(entry("pnp", RAISED, clicked(RAISED, noise_px=6.0)), CONFIG)
    [caution] = [caution for caution in result.cautions if caution.code == "poor_fit"]
    assert caution.details["median_px"] == result.median_px


@pytest.mark.parametrize("kind", ["homography", "points"])
@pytest.mark.parametrize("axis", [0, 1])
def test_pixels_that_are_not_square_are_solved_for_where_they_are_said(kind, axis):
    scale = np.where(np.arange(2) == axis, 0.75, 1.0)
    points = points_for(kind)
    pixels = (clicked(points) + 0.5) * scale - 0.5
    given = entry(kind, points, pixels, CAMERA).model_dump(mode="json")
    given["width_px"], given["height_px"] = (np.array([640, 360]) * scale).astype(int).tolist()
    given["calibration"]["pixel_aspect"] = 1 / 0.75 if axis == 0 else 0.75
    result = solve_camera(SiteCamera.model_validate(given), CONFIG)
    np.testing.assert_allclose(result.camera.centre_m, CAMERA.centre_m, atol=0.3)
    np.testing.assert_allclose(result.camera.K[[0, 1], [0, 1]] / scale, 700.0, rtol=0.03)
    assert result.cautions == ()


@pytest.mark.parametrize("axis", [0, 1])
def test_pixels_that_are_not_square_are_named_where_raised_points_show_it(axis):
    pixels = (clicked(RAISED) + 0.5) * np.where(np.arange(2) == axis, 0.75, 1.0) - 0.5
    assert '"pixel_aspect"' in refused(entry("points", RAISED, pixels))
    assert "times as " + ("wide", "high")[axis] in refused(entry("pnp", RAISED, pixels))


def test_the_skew_of_K_counts_and_that_of_another_lens_is_seen():
    K = np.array(CAMERA.K)
    K[0, 1] = 40.0
    skewed = Camera(K, CAMERA.dist, CAMERA.T_world_cam, 640, 360)
    result = solve_camera(entry("pnp", RAISED, clicked(RAISED, skewed), skewed), CONFIG)
    np.testing.assert_allclose(result.camera.centre_m, CAMERA.centre_m, atol=0.1)
    assert result.cautions == ()


def test_coefficients_with_their_signs_changed_are_refused_by_name():
    lens = look_at((-20.0, -15.0, 8.0), focal_px=450.0)
    bent = Camera(lens.K, np.array([-0.3, 0.09, 0.0, 0.0]), lens.T_world_cam, 640, 360)
    wide = np.concatenate([1.4 * RAISED, [[-14.0, 9.0, 3.0], [13.0, -9.0, 2.0], [-2.0, 16.0, 5.0]]])
    given = entry("pnp", wide, clicked(wide, bent), bent, dist=[0.3, -0.09, 0.0, 0.0])
    assert "signs changed" in refused(given)


def test_a_principal_point_that_counts_from_the_middle_is_refused_by_name():
    K = np.diag([700.0, 700.0, 1.0])
    assert "count from the middle" in refused(entry("pnp", RAISED, clicked(RAISED), K=K.tolist()))


@BOTH
def test_pixels_that_count_from_the_middle_upwards_or_in_per_cent_are_refused_by_name(kind):
    points = points_for(kind)
    middle = np.array([CAMERA.width_px - 1, CAMERA.height_px - 1]) / 2
    up = (clicked(points) - middle) * [1, -1]
    assert "upwards: add 319.5 to u, and take v from 179.5" in refused(entry(kind, points, up))
    share = 100 * (clicked(points) + 0.5) / [640, 360]
    assert "per cent" in refused(entry(kind, points, share))


@BOTH
def test_a_camera_as_high_as_decimetres_make_it_is_said_with_the_factor(kind):
    points = points_for(kind)
    result = solve_camera(entry(kind, 10 * points, clicked(points)), CONFIG)
    [caution] = result.cautions
    assert caution.code == "camera_height" and "decimetres, multiply them by 0.1" in caution.hint
    assert result.document().ground_sd_m is None


def test_heights_of_a_sloping_road_above_the_sea_are_refused_with_the_offset_for_a_homography():
    sloping = GROUND + np.array([0.0, 0.0, 1.0]) * (34.0 + 0.1 * GROUND[:, :1])
    assert "off every z" in refused(entry("homography", sloping, clicked(GROUND)))


def test_pixels_of_a_smaller_picture_fit_ground_points_poorly():
    pixels = (clicked(GROUND) + 0.5) / 2 - 0.5
    assert {"poor_fit", "pixels_in_corner"} <= set(codes(solve_camera(entry("homography", GROUND, pixels), CONFIG)))


def test_a_principal_point_far_off_is_blamed_on_what_was_given():
    K = np.array(CAMERA.K) + [[0, 0, 100.0], [0, 0, 0], [0, 0, 0]]
    camera = Camera(K, CAMERA.dist, CAMERA.T_world_cam, 640, 360)
    for solved, blamed in ((False, "Is K that of another"), (True, "the points lie off one plane")):
        [caution] = intrinsics_cautions(camera, solved=solved)
        assert caution.code == "principal_point" and blamed in caution.hint


def test_a_click_just_beside_the_image_is_warned_of():
    camera = look_at((-20.0, -15.0, 8.0), focal_px=700.0)
    pixels = clicked(RAISED, camera)
    shifted = Camera(
        camera.K - [[0, 0, 0], [0, 0, pixels[:, 1].min() + 3.0], [0, 0, 0]], camera.dist, camera.T_world_cam, 640, 360
    )
    given = entry("pnp", RAISED, shifted.project(RAISED)[0], shifted)
    assert "pixels_outside" in codes(solve_camera(given, CONFIG))


def test_few_points_are_warned_of():
    result = solve_camera(entry("pnp", GROUND[:4], clicked(GROUND[:4], noise_px=0.1)), CONFIG)
    assert codes(result) == ["few_points"]


@pytest.mark.parametrize(("scale", "size"), [(1.5, "960x540"), (0.5, "320x180"), (2.0, "1280x720")])
def test_intrinsics_of_another_resolution_are_refused_with_that_resolution(scale, size):
    K = np.diag([scale, scale, 1.0]) @ CAMERA.K
    assert size in refused(entry("pnp", RAISED, clicked(RAISED), K=K.tolist()))


def test_intrinsics_and_pixels_of_another_resolution_are_warned_of():
    K = np.diag([0.5, 0.5, 1.0]) @ CAMERA.K
    result = solve_camera(entry("pnp", RAISED, (clicked(RAISED) + 0.5) / 2 - 0.5, K=K.tolist()), CONFIG)
    assert codes(result) == ["pixels_in_corner", "principal_point"]
    assert "320x180" in result.cautions[1].hint


def test_a_squeezed_picture_is_refused_by_name():
    camera = look_at((-20.0, -15.0, 8.0), focal_px=700.0)
    pixels = (clicked(RAISED, camera) + 0.5) * [0.75, 1.0] - 0.5
    assert "squeezed" in refused(entry("pnp", RAISED, pixels, camera))


@pytest.mark.parametrize(
    ("K", "words"),
    [
        (CAMERA.K.T.tolist(), "transposed"),
        ([[4.6, 0, 3.2], [0, 4.6, 1.8], [0, 0, 1]], "millimetres"),
        ([[1.1, 0, 0.5], [0, 1.1, 0.28], [0, 0, 1]], "shares of the width"),
    ],
)
def test_intrinsics_in_other_layouts_and_units_are_refused_by_name(K, words):
    assert words in refused(entry("pnp", RAISED, clicked(RAISED), K=K))
    rvec, tvec = CAMERA.T_cam_world.to_rvec_tvec()
    assert words in refused(matrices(rvec, tvec, K=K))


def test_coefficients_of_a_fisheye_are_told_from_those_of_a_pinhole():
    K = np.array([[320.0, 0, 319.5], [0, 320.0, 179.5], [0, 0, 1]])
    fisheye = np.array([0.045, -0.012, 0.006, -0.002])
    wide = look_at((-14.0, -10.0, 8.0), focal_px=320.0)
    rvec, tvec = wide.T_cam_world.to_rvec_tvec()
    pixels = cv2.fisheye.projectPoints(RAISED[None], rvec, tvec[:, None], K, fisheye)[0][0]
    given = entry("pnp", RAISED, pixels, wide, K=K.tolist(), dist=fisheye.tolist())
    result = solve_camera(given, CONFIG)
    assert any("cv2.fisheye" in caution.message for caution in result.cautions)


def test_a_lens_that_was_undistorted_already_is_named():
    wide = look_at((-13.0, -11.0, 7.0), focal_px=320.0)
    given = entry("pnp", RAISED, clicked(RAISED, wide), wide, dist=[-0.3, 0.1, 0.0, 0.0, 0.0])
    result = solve_camera(given, CONFIG)
    assert any("without distortion" in caution.message for caution in result.cautions)


def test_rotation_vectors_in_degrees_are_refused_by_name():
    rvec, tvec = CAMERA.T_cam_world.to_rvec_tvec()
    assert "degrees" in refused(matrices(np.degrees(rvec), tvec))


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (CAMERA.T_world_cam, "camera to world"),
        (CAMERA.T_cam_world @ SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3)), "point down"),
        (SE3(CAMERA.T_cam_world.rotation, CAMERA.centre_m), "camera's position"),
    ],
)
def test_poses_of_another_convention_are_refused_by_name(pose, words):
    assert words in refused(matrices(*pose.to_rvec_tvec()))


def test_a_picture_that_is_upside_down_is_warned_of():
    upright = CAMERA.T_world_cam
    rolled = SE3(upright.rotation @ np.diag([-1.0, -1.0, 1.0]), upright.translation)
    result = solve_camera(matrices(*rolled.inverse().to_rvec_tvec()), CONFIG)
    assert codes(result) == ["rolled_camera"]
    assert "180°" in result.cautions[0].message


@pytest.mark.parametrize(("height_m", "expected"), [(1.2, "camera_height"), (80.0, "camera_height"), (7.0, None)])
def test_unusual_heights_are_warned_of(height_m, expected):
    camera = look_at((-20.0, -15.0, height_m))
    result = solve_camera(matrices(*camera.T_cam_world.to_rvec_tvec()), CONFIG)
    assert codes(result) == ([] if expected is None else [expected])


def test_points_behind_a_camera_are_a_problem_that_names_them():
    world = np.concatenate([GROUND, [[-40.0, -30.0, 0.0]]])
    result = Residuals.of("pnp", CAMERA, world, np.concatenate([clicked(GROUND), [[320.0, 180.0]]]))
    problem = misfit_problem(result, 10.0)
    assert problem is not None and "1 of 9 points" in problem.message and "(-40.00, -30.00, 0.00)" in problem.message


@settings(max_examples=30)
@given(
    azimuth=st.floats(0, 6.28),
    height=st.floats(4, 14),
    radius=st.floats(20, 30),
    kind=st.sampled_from(["pnp", "homography"]),
    seed=st.integers(0, 1000),
)
def test_law_good_points_are_never_doubted(azimuth, height, radius, kind, seed):
    camera = look_at((radius * np.cos(azimuth), radius * np.sin(azimuth), height))
    points = points_for(kind)
    pixels, _ = camera.project(points)
    assume(camera.contains(pixels).all())
    pixels += np.random.default_rng(seed).normal(0, 0.5, pixels.shape)
    pixels = np.clip(pixels, 0, [639, 359])
    result = solve_camera(entry(kind, points + UTM, pixels, camera), CONFIG)
    assert [code for code in codes(result) if code != "points_left_out"] == []
    assert np.linalg.norm(result.camera.centre_m - UTM - camera.centre_m) < 3.0


def test_the_stage_warns_and_names_the_camera(tmp_path):
    site = Site(name="feet", cameras=(entry("pnp", RAISED / 0.3048, clicked(RAISED)),))
    folders = StageFolders(tmp_path)
    stage.run(folders.context("calibrate", site), CONFIG)
    [warning] = folders.warnings
    assert (warning.stage, warning.code, warning.details["camera"]) == ("calibrate", "check_units", "pole")
    assert warning.message.startswith("Camera pole: ")
