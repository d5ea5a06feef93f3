import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.builders import look_at
from wibam_core.calibration.pnp import solve_pose
from wibam_core.errors import CalibrationError

GROUND = np.array(
    [[-9, -6, 0], [8, -7, 0], [-7, 8, 0], [9, 9, 0], [0, 1, 0], [-4, 3, 0], [5, -2, 0], [2, 7, 0]], dtype=float
)
RAISED = GROUND + np.array([0, 0, 1.0]) * np.array([0, 2, 0, 4, 1, 0, 3, 0])[:, None]
DIST = (-0.2, 0.05, 1e-3, -5e-4)


def angle_deg(one, two):
    cosine = (np.trace(one.rotation.T @ two.rotation) - 1) / 2
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


@settings(max_examples=25)
@given(
    azimuth=st.floats(0, 6.28),
    height=st.floats(4, 14),
    radius=st.floats(24, 40),
    points=st.sampled_from([GROUND, RAISED]),
    dist=st.sampled_from([(), DIST]),
)
def test_exact_points_give_the_exact_pose(azimuth, height, radius, points, dist):
    camera = look_at((radius * np.cos(azimuth), radius * np.sin(azimuth), height), dist=dist)
    pixels, _ = camera.project(points)
    assume(camera.contains(pixels).all())
    fit = solve_pose(points, pixels, camera.K, camera.dist)
    np.testing.assert_allclose(fit.T_world_cam.translation, camera.centre_m, atol=1e-4)
    assert angle_deg(fit.T_world_cam, camera.T_world_cam) < 1e-3
    assert fit.errors_px.max() < 1e-3
    assert fit.used.all()


@settings(max_examples=25)
@given(
    easting=st.floats(-1e6, 1e6),
    northing=st.floats(-1e7, 1e7),
    points=st.sampled_from([GROUND, RAISED]),
    seed=st.integers(0, 1000),
)
def test_law_clicks_in_a_map_grid_give_the_pose_that_they_give_near_the_origin(easting, northing, points, seed):
    camera = look_at((20.0, -12.0, 8.0))
    pixels, _ = camera.project(points)
    pixels += np.random.default_rng(seed).normal(0, 0.4, pixels.shape)
    origin = np.array([easting, northing, 0.0])
    here = solve_pose(points, pixels, camera.K, camera.dist)
    there = solve_pose(points + origin, pixels, camera.K, camera.dist)
    np.testing.assert_allclose(there.T_world_cam.translation - origin, here.T_world_cam.translation, atol=1e-4)
    assert angle_deg(here.T_world_cam, there.T_world_cam) < 1e-3


@pytest.mark.parametrize("points", [GROUND, RAISED])
def test_one_wrong_click_is_found_and_left_out(points):
    camera = look_at((20.0, -12.0, 8.0))
    pixels, _ = camera.project(points)
    pixels += np.random.default_rng(0).normal(0, 0.4, pixels.shape)
    pixels[3] += [90.0, -60.0]
    fit = solve_pose(points, pixels, camera.K, camera.dist)
    assert fit.used.tolist() == [True, True, True, False, True, True, True, True]
    assert np.linalg.norm(fit.T_world_cam.translation - camera.centre_m) < 0.6
    assert fit.errors_px[3] > 50


def test_noise_of_half_a_pixel_moves_the_camera_little():
    camera = look_at((20.0, -12.0, 8.0))
    exact, _ = camera.project(RAISED)
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(10):
        fit = solve_pose(RAISED, exact + rng.normal(0, 0.5, exact.shape), camera.K, camera.dist)
        errors.append(np.linalg.norm(fit.T_world_cam.translation - camera.centre_m))
        assert fit.used.all()
    assert np.median(errors) < 0.15


def test_too_few_points():
    camera = look_at((20.0, -12.0, 8.0))
    pixels, _ = camera.project(RAISED[:3])
    with pytest.raises(CalibrationError, match="3 correspondences are too few"):
        solve_pose(RAISED[:3], pixels, camera.K, camera.dist)


def test_points_on_one_line():
    camera = look_at((20.0, -12.0, 8.0))
    line = np.linspace([-8, -3, 0], [8, 5, 0], 8)
    pixels, _ = camera.project(line)
    with pytest.raises(CalibrationError, match="one line in the world"):
        solve_pose(line, pixels, camera.K, camera.dist)


def test_four_points_on_the_ground_are_enough():
    camera = look_at((20.0, -12.0, 8.0))
    pixels, _ = camera.project(GROUND[:4])
    fit = solve_pose(GROUND[:4], pixels, camera.K, camera.dist)
    np.testing.assert_allclose(fit.T_world_cam.translation, camera.centre_m, atol=1e-3)


def test_shuffled_points_do_not_pass_for_a_fit():
    camera = look_at((20.0, -12.0, 8.0))
    pixels, _ = camera.project(RAISED)
    try:
        fit = solve_pose(RAISED, pixels[[3, 0, 6, 1, 7, 2, 4, 5]], camera.K, camera.dist)
    except CalibrationError:
        return
    assert np.median(fit.errors_px) > 10
