"""Cameras with wide lenses, solved and checked as those with pinholes are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wibam_core.calibration.readings import Sighting
from wibam_core.calibration.rig import calibrate, solve_camera
from wibam_core.calibration.views import cut_view, suggested_views
from wibam_core.config import CalibrateConfig
from wibam_core.errors import CalibrationError, SiteFileError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.site import Site, SiteCamera, ViewDirection

SIZE = (1280, 960)
LENSES = {
    "fisheye": {"lens": "fisheye", "dist": [0.02, -0.01, 0.003, -0.0005], "xi": 0.0},
    "omnidirectional": {"lens": "omnidirectional", "dist": [-0.06, 0.01, 0.001, -0.0008], "xi": 1.1},
}
FOCAL_PX = {"fisheye": 322.0, "omnidirectional": 650.0}
CONFIG = CalibrateConfig()
ROAD = np.array(
    [[-9, -6], [-4, 5], [3, -3], [8, 7], [2, 9], [-3, -2], [9, 2], [-7, 3], [15, -4], [-14, 8]], dtype=float
)
POINTS = np.concatenate([np.concatenate([ROAD, np.zeros((10, 1))], axis=1), [[6, 6, 3.2], [-5, -7, 4.0]]])


def camera_with(lens: str, position: tuple[float, float, float], tilt_rad: float, spin_rad: float) -> Camera:
    """A camera that looks down, tilted about the world's x axis and spun about its own."""
    K = np.array([[FOCAL_PX[lens], 0, 632.7], [0, FOCAL_PX[lens], 473.8], [0, 0, 1]])
    c, s, ct, st_ = np.cos(spin_rad), np.sin(spin_rad), np.cos(tilt_rad), np.sin(tilt_rad)
    spin = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    tilt = np.array([[1, 0, 0], [0, ct, -st_], [0, st_, ct]])
    pose = SE3(tilt @ np.diag([1.0, -1, -1]) @ spin, np.array(position))
    return Camera(K, np.array(LENSES[lens]["dist"]), pose, *SIZE, lens, LENSES[lens]["xi"])


def entry(camera: Camera, world: np.ndarray, pixels: np.ndarray, **change) -> SiteCamera:
    points = [{"world": w.tolist(), "pixel": p.tolist()} for w, p in zip(world, pixels, strict=True)]
    calibration = {"kind": "pnp", "K": camera.K.tolist(), **LENSES[camera.lens], "correspondences": points} | change
    return SiteCamera.model_validate(
        {"id": "pole", "width_px": SIZE[0], "height_px": SIZE[1], "calibration": calibration}
    )


@pytest.mark.parametrize("lens", LENSES)
@settings(max_examples=10, deadline=None)
@given(tilt=st.floats(0, 0.9), spin=st.floats(0, 6.28), far=st.sampled_from([0.0, 4.0e6]), flat=st.booleans())
def test_exact_points_give_the_exact_pose_whichever_way_the_camera_looks(lens, tilt, spin, far, flat) -> None:
    camera = camera_with(lens, (1.0, -2.0, 9.0), tilt, spin)
    points = POINTS[:10] if flat else POINTS
    pixels, _ = camera.project(points)
    shown = camera.contains(pixels)
    origin = np.array([far, -far, 0.0])
    result = solve_camera(entry(camera, points[shown] + origin, pixels[shown]), CONFIG)
    np.testing.assert_allclose(result.camera.centre_m - origin, camera.centre_m, atol=1e-3)
    np.testing.assert_allclose(result.camera.T_world_cam.rotation, camera.T_world_cam.rotation, atol=1e-4)
    assert result.camera.lens == lens


@pytest.mark.parametrize("lens", LENSES)
def test_a_wrong_click_is_left_out_and_the_stated_deviations_hold_the_errors(lens: str) -> None:
    camera = camera_with(lens, (1.0, -2.0, 9.0), 0.3, 1.0)
    pixels, _ = camera.project(POINTS)
    assert camera.contains(pixels).all()
    errors = []
    for seed in range(12):
        noisy = pixels + np.random.default_rng(seed).normal(0, 0.5, pixels.shape)
        if seed == 0:
            noisy[4] += [60.0, -50.0]
        sighting = Sighting(POINTS, noisy, *SIZE, camera.K, camera.dist, camera.lens, camera.xi)
        found, used = sighting.solve()
        assert used.tolist() == [seed != 0 or k != 4 for k in range(len(POINTS))]
        covariance = sighting.covariance(found, used)
        assert covariance is not None
        errors.append((found.centre_m - camera.centre_m) / covariance.position_sd_m)
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_numbers_of_another_lens_model_are_called_by_name() -> None:
    camera = camera_with("fisheye", (1.0, -2.0, 9.0), 0.3, 1.0)
    pixels, _ = camera.project(POINTS)
    with pytest.raises(CalibrationError) as caught:
        solve_camera(entry(camera, POINTS, pixels, lens="pinhole"), CONFIG)
    assert '"lens": "fisheye"' in str(caught.value.hint)
    mild = replace(camera, dist=np.array([0.01, 0.0, 0.0, 0.0]))
    pixels, _ = mild.project(POINTS)
    with pytest.raises(CalibrationError, match=r"cv2\.fisheye") as caught:
        solve_camera(entry(mild, POINTS, pixels, lens="pinhole", dist=[0.01, 0, 0, 0]), CONFIG)
    assert '"lens": "fisheye"' in str(caught.value.hint)


def test_a_lens_that_ends_within_the_picture_is_refused_with_its_angle() -> None:
    camera = camera_with("fisheye", (1.0, -2.0, 9.0), 0.3, 1.0)
    pixels, _ = camera.project(POINTS)
    with pytest.raises(CalibrationError, match=r"ends \d+° from its axis"):
        solve_camera(entry(camera, POINTS, pixels, dist=[-0.5, 0, 0, 0]), CONFIG)
    beyond = pixels.copy()
    beyond[3] = [3.0, 3.0]
    with pytest.raises(CalibrationError, match=r"shows nothing at \d of 12 pixels"):
        solve_camera(entry(camera, POINTS, beyond, dist=[-0.1, 0, 0, 0]), CONFIG)


def site(cameras: dict[str, Camera], **views) -> Site:
    entries = []
    for camera_id, camera in cameras.items():
        rvec, tvec = camera.T_cam_world.to_rvec_tvec()
        calibration = {"kind": "matrices", "K": camera.K.tolist(), "dist": camera.dist.tolist(), "lens": camera.lens}
        calibration |= {"xi": camera.xi, "rvec": rvec.tolist(), "tvec": tvec.tolist()}
        described = {"id": camera_id, "width_px": SIZE[0], "height_px": SIZE[1], "calibration": calibration}
        entries.append(described | ({"views": views[camera_id]} if camera_id in views else {}))
    return Site.model_validate({"name": "wide", "cameras": entries})


def in_views(camera: Camera, views: list[Camera], ground: np.ndarray) -> np.ndarray:
    """Which ground points that the camera shows at least one of its views shows, too."""
    shown = camera.contains(camera.project(ground)[0])
    assert shown.any()
    return np.any([view.contains(view.project(ground[shown])[0]) for view in views], axis=0)


def test_views_of_cameras_that_look_down_show_the_road_towards_the_others() -> None:
    cameras = {
        f"cam{k + 1}": camera_with("fisheye", (20 * x, 18 * y, 10.0), 0.05 * k, 1.0 + k)
        for k, (x, y) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    }
    rig, _ = calibrate(site(cameras), CONFIG)
    assert rig.reference_id == "cam1"
    assert list(rig)[:4] == ["cam1.1", "cam1.2", "cam1.3", "cam2.1"]
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(-18, 18, 13), np.linspace(-16, 16, 13)))
    for camera_id, camera in cameras.items():
        views = [rig[view.id] for view in rig.views[camera_id]]
        assert {rig.mounted_id(view.id) for view in rig.views[camera_id]} == {camera_id}
        assert in_views(camera, views, np.stack([x, y, 0 * x], axis=1)).all()
        for view in views:  # upright, and at the camera's place
            assert abs(view.T_world_cam.rotation[2, 0]) < 1e-9
            assert view.T_world_cam.rotation[2, 1] < 0
            np.testing.assert_allclose(view.centre_m, camera.centre_m, atol=1e-9)


def test_one_camera_alone_that_looks_down_is_cut_all_around_and_one_that_looks_ahead_is_not() -> None:
    nobody = np.zeros((0, 2))
    down = suggested_views(camera_with("fisheye", (0.0, 0.0, 10.0), 0.0, 0.0), nobody)
    assert len(down) == 6
    ahead = camera_with("fisheye", (0.0, 0.0, 8.0), np.radians(65), 0.0)
    views = suggested_views(ahead, nobody)
    assert len(views) == 3
    middle = np.degrees(np.arctan2(*ahead.T_world_cam.rotation[1::-1, 2]))
    assert views[1].azimuth_deg == pytest.approx(middle, abs=2)
    assert views[0].azimuth_deg > views[2].azimuth_deg  # from left to right


def test_a_view_looks_where_the_user_says() -> None:
    camera = camera_with("fisheye", (-20.0, -18.0, 10.0), 0.1, 2.0)
    other = camera_with("fisheye", (20.0, 18.0, 10.0), 0.0, 0.0)
    wanted = [{"azimuth_deg": 42, "down_deg": 30, "across_deg": 106, "height_deg": 80}]
    rig, _ = calibrate(site({"a": camera, "b": other}, a=wanted), CONFIG)
    (view,) = (rig[v.id] for v in rig.views["a"])
    forward = view.T_world_cam.rotation[:, 2]
    assert np.degrees(np.arctan2(forward[1], forward[0])) == pytest.approx(42)
    assert np.degrees(np.arcsin(-forward[2])) == pytest.approx(30)
    assert 2 * np.degrees(np.arctan(view.width_px / 2 / view.K[0, 0])) == pytest.approx(106, abs=0.5)
    assert 2 * np.degrees(np.arctan(view.height_px / 2 / view.K[1, 1])) == pytest.approx(80, abs=0.5)


def test_views_that_cannot_be_cut_are_refused_by_name() -> None:
    ahead = camera_with("fisheye", (0.0, 0.0, 8.0), np.radians(65), 0.0)
    behind = suggested_views(ahead, np.zeros((0, 2)))[1].azimuth_deg + 180
    with pytest.raises(CalibrationError, match=r"the view a\.1 looks"):
        cut_view(ahead, ViewDirection(azimuth_deg=behind, down_deg=0), "a.1")
    pinhole = {"id": "a", "width_px": 640, "height_px": 360, "views": [{"azimuth_deg": 0}]}
    pinhole["calibration"] = {"kind": "homography", "correspondences": []}
    with pytest.raises(SiteFileError, match="pinhole"):
        Site.model_validate({"name": "x", "cameras": [pinhole]}).check()
