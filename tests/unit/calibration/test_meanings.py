"""Calibrations that mean something else than they say, by kinds: each is refused or warned of by its cause."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.builders import look_at
from tests.unit.calibration.test_inputs import CAMERA, CONFIG, GROUND, RAISED, clicked, codes, entry, matrices, refused
from wibam_core.calibration.rig import calibrate, solve_camera
from wibam_core.errors import NoOverlap, SiteFileError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.site import Site, SiteCamera

FLIP = SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
Y_UP = SE3(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.zeros(3))
#: From camera coordinates to x forward, y left, z up.
BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
TWO = (look_at((-18.0, -14.0, 8.0), focal_px=700.0), look_at((17.0, -15.0, 7.5), focal_px=700.0))


def pair(poses: list[SE3]) -> Site:
    cameras = [matrices(*pose.to_rvec_tvec()).model_copy(update={"id": f"c{k}"}) for k, pose in enumerate(poses)]
    return Site(name="pair", cameras=tuple(cameras))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (FLIP @ CAMERA.T_cam_world, "OpenGL's (y up, z backwards): change"),
        (CAMERA.T_world_cam @ FLIP, "camera to world with OpenGL's axes"),
        (CAMERA.T_cam_world @ Y_UP.inverse(), "Y axis looks to point up"),
    ],
)
def test_poses_with_other_axes_are_refused_by_name(given: SE3, words: str) -> None:
    assert words in refused(matrices(*given.to_rvec_tvec()))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (SE3(BODY, np.zeros(3)) @ CAMERA.T_cam_world, "like those of ROS"),
        (CAMERA.T_world_cam @ SE3(BODY, np.zeros(3)).inverse(), "pose in the world with axes of ROS"),
    ],
)
def test_poses_of_a_robots_body_are_refused_by_name(given: SE3, words: str) -> None:
    assert words in refused(matrices(*given.to_rvec_tvec()))


@pytest.mark.parametrize("order", ["xyz", "XYZ", "zyx", "ZYX"])
def test_angles_about_axes_are_told_from_a_rotation_vector(order: str) -> None:
    turned = Rotation.from_matrix(CAMERA.T_cam_world.rotation)
    said = refused(matrices(turned.inv().as_euler(order), CAMERA.centre_m))
    assert f"{order!r} in SciPy), camera to world, and tvec the camera's position C:" in said
    given = matrices(turned.as_euler(order), CAMERA.T_cam_world.translation)
    if order in ("zyx", "ZYX"):
        assert f"{order!r} in SciPy), world to camera:" in refused(given)
    else:  # a camera could be held so
        [caution] = [one for one in solve_camera(given, CONFIG).cautions if one.code == "rolled_camera"]
        assert "not three angles" in caution.hint


def test_a_part_of_a_quaternion_is_told_from_a_rotation_vector() -> None:
    quaternion = Rotation.from_matrix(CAMERA.T_cam_world.rotation).as_quat(canonical=True)
    assert "x, y and z of a quaternion, world to camera" in refused(
        matrices(quaternion[:3], CAMERA.T_cam_world.translation)
    )


@pytest.mark.parametrize("rvec", [[0.1, 0.2, 0.3, 0.9], np.eye(3).tolist()])
def test_a_quaternion_or_a_matrix_as_rotation_vector_is_refused_with_how_to_turn_it(rvec: list[object]) -> None:
    site = pair([TWO[0].T_cam_world]).model_dump(mode="json")
    site["cameras"][0]["calibration"]["rvec"] = rvec
    with pytest.raises(SiteFileError) as caught:
        Site.parse(json.dumps(site))
    assert "cv2.Rodrigues" in caught.value.hint and "from_quat" in caught.value.hint


def test_cameras_that_share_no_ground_are_refused_with_what_is_odd_about_their_intrinsics() -> None:
    """K of a sensor's full size, of which the recording has a third."""
    site = pair([camera.T_cam_world for camera in TWO])
    K = ((2100.0, 0.0, 950.0), (0.0, 2100.0, 530.0), (0.0, 0.0, 1.0))
    cameras = [
        camera.model_copy(update={"calibration": camera.calibration.model_copy(update={"K": K})})
        for camera in site.cameras
    ]
    with pytest.raises(NoOverlap) as caught:
        calibrate(site.model_copy(update={"cameras": tuple(cameras)}), CONFIG)
    assert "Of c0, c1 the principal point (950, 530)" in caught.value.hint


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (lambda c: SE3(c.T_cam_world.rotation, -c.centre_m), "sign changed"),
        (lambda c: SE3(c.T_world_cam.rotation, c.centre_m + [0, 0, 34.0]).inverse(), "from the sea"),
    ],
)
def test_what_no_camera_shows_by_itself_all_of_them_do(read, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(NoOverlap) as caught:
        calibrate(pair([read(camera) for camera in TWO]), CONFIG)
    assert words in caught.value.hint


def test_a_camera_in_a_world_of_its_own_is_refused_with_how_far_off_it_is() -> None:
    away = SE3(TWO[1].T_world_cam.rotation, TWO[1].centre_m + [1000.0, 0, 0])
    with pytest.raises(NoOverlap, match=r"10[0-9]{2} m from the nearest") as caught:
        calibrate(pair([TWO[0].T_cam_world, away.inverse()]), CONFIG)
    assert "one world frame" in caught.value.hint and "looks" not in caught.value.hint


def test_one_calibration_for_two_cameras_is_warned_of() -> None:
    residuals = calibrate(pair([TWO[0].T_cam_world, TWO[0].T_cam_world]), CONFIG)[1]
    assert codes(residuals["c0"]) == [] and codes(residuals["c1"]) == ["same_pose"]


def test_a_picture_that_is_aslant_is_warned_of() -> None:
    turn = SE3.from_rvec_tvec([0.0, 0.0, np.radians(25.0)], np.zeros(3))
    assert codes(solve_camera(matrices(*(turn @ CAMERA.T_cam_world).to_rvec_tvec()), CONFIG)) == ["rolled_camera"]


@pytest.mark.parametrize(
    ("focal_px", "dist", "code"),
    [
        (320.0, [0.045, -0.012, 0.006, -0.002], "lens_model"),
        (700.0, [-0.3, 0.1, -0.02, 0.001, 0.0], "distortion_order"),
        (320.0, [-0.01, 0.0, 0.0004, -0.0003], None),
        (700.0, [-0.3, 0.1, 0.001, -0.002, 0.02], None),
    ],
)
def test_coefficients_that_no_pinhole_has_are_warned_of(focal_px: float, dist: list[float], code: str | None) -> None:
    K = [[focal_px, 0, 319.5], [0, focal_px, 179.5], [0, 0, 1]]
    result = solve_camera(matrices(*CAMERA.T_cam_world.to_rvec_tvec(), K=K, dist=dist), CONFIG)
    assert codes(result) == ([] if code is None else [code])


@pytest.mark.parametrize(("cx", "cy", "words"), [(179.5, 319.5, "swapped"), (0.0, 0.0, "(319.5, 179.5), not (0, 0)")])
def test_principal_points_of_another_layout_are_named(cx: float, cy: float, words: str) -> None:
    K = [[700.0, 0, cx], [0, 700.0, cy], [0, 0, 1]]
    [caution] = solve_camera(matrices(*CAMERA.T_cam_world.to_rvec_tvec(), K=K), CONFIG).cautions
    assert caution.code == "principal_point" and words in caution.hint


def geocentric(points: np.ndarray) -> np.ndarray:
    """Of a site at 48.13° N, 11.57° E: axes east, north and up there, and about where it lies."""
    lat, lon = np.radians(48.13), np.radians(11.57)
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    return points @ np.stack([east, np.cross(up, east), up]) + [4_177_900.0, 855_500.0, 4_727_100.0]


@pytest.mark.parametrize("kind", ["pnp", "homography", "points"])
def test_geocentric_coordinates_and_radians_are_refused_by_name(kind: str) -> None:
    points = GROUND if kind == "homography" else RAISED
    assert "geocentric" in refused(entry(kind, geocentric(points), clicked(points)))
    radians = np.radians([48.13, 11.57, 0.0]) + points / [6.37e6, 4.25e6, 1.0]
    assert "in radians" in refused(entry(kind, radians, clicked(points)))


@pytest.mark.parametrize(
    ("pixels", "words"),
    [
        (lambda p: p / [640, 360], "shares of the picture"),
        (lambda p: p - [319.5, 179.5], "counted from the middle: add 319.5 to u and 179.5"),
        (lambda p: (p + 0.5) * 1.5 - 0.5, "0.667 times"),
    ],
)
def test_pixels_counted_otherwise_are_refused_by_name(pixels, words: str) -> None:  # type: ignore[no-untyped-def]
    assert words in refused(entry("pnp", RAISED, pixels(clicked(RAISED))))


@pytest.mark.parametrize(
    ("world", "words"),
    [
        (RAISED * [1, 1, 1 / 0.3048], "heights look like feet"),
        (RAISED * [1, 1, 100.0], "heights look like centimetres"),
        (RAISED * [1.5, 1.5, 1.0] + [1.288e6, 6.139e6, 0.0], "Web Mercator"),
        (RAISED[:, [0, 2, 1]] * [1, 1, -1], "Y axis points up"),
    ],
)
def test_heights_in_another_unit_or_axis_are_refused_by_name(world: np.ndarray, words: str) -> None:
    assert words in refused(entry("pnp", world, clicked(RAISED)))


def test_a_camera_that_hangs_sideways_is_no_world_that_lies_on_its_side() -> None:
    upright = look_at((-20.0, 15.0, 8.0), focal_px=300.0)
    turn = SE3.from_rvec_tvec([0.0, 0.0, np.pi / 2], np.zeros(3))
    sideways = Camera(upright.K, upright.dist, upright.T_world_cam @ turn, 640, 360)
    given = entry("pnp", RAISED, clicked(RAISED, sideways), sideways)
    assert "rolled_camera" in codes(solve_camera(given, CONFIG))


def test_another_focal_length_than_that_of_K_is_named_with_it() -> None:
    K = (CAMERA.K + np.diag([210.0, 210.0, 0.0])).tolist()
    said = refused(entry("pnp", GROUND, clicked(GROUND, noise_px=0.2), K=K))
    assert "0.77 times that of K" in said and "'homography'" in said
    result = solve_camera(entry("pnp", RAISED, clicked(RAISED, noise_px=0.2), K=K), CONFIG)
    [caution] = [caution for caution in result.cautions if caution.code == "other_reading"]
    assert "0.77 times that of K" in caution.message and "'points'" in caution.hint


def listed(world: np.ndarray, pixels: np.ndarray, *rows: int) -> SiteCamera:
    return entry("pnp", world[list(rows)], pixels[list(rows)])


def test_a_point_that_is_listed_twice_is_said_and_counts_once() -> None:
    pixels = clicked(RAISED)
    result = solve_camera(listed(RAISED, pixels, 0, 1, 2, 3, 4, 8, 8), CONFIG)
    assert codes(result) == ["points_repeated"]
    assert "3 correspondences are too few" in refused(listed(RAISED, pixels, 0, 1, 2, 2))


def test_six_points_of_which_two_are_exchanged_are_refused() -> None:
    pixels = clicked(RAISED)
    swapped = entry("points", RAISED[[1, 0, 2, 3, 8, 9]], pixels[[0, 1, 2, 3, 8, 9]])
    assert refused(swapped)
