import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from tests.builders import corner_rig, look_at, site_of
from tests.stage_folders import StageFolders
from wibam_core.artifacts.catalogue import CALIBRATED_RIG, RESIDUALS
from wibam_core.calibration.matrices import build_camera, camera_from_matrices
from wibam_core.calibration.residuals import Residuals, metres_per_pixel
from wibam_core.calibration.rig import calibrate, check_overlap, solve_camera
from wibam_core.calibration.view import visible_ground
from wibam_core.config import CalibrateConfig
from wibam_core.errors import CalibrationError, NoOverlap
from wibam_core.geometry.ground import intersect_plane
from wibam_core.geometry.torch_ops import CameraTensors, undistort
from wibam_core.scene import CameraRig
from wibam_core.site import Site, SiteCamera
from wibam_core.stages import calibrate as stage

POINTS = np.array(
    [[-6, -5, 0], [6, -6, 0], [-5, 6, 0], [6, 6, 0], [0, 1, 0], [-3, 2, 0], [4, -2, 0], [1, 5, 0]], dtype=float
)
CONFIG = CalibrateConfig()


def correspondences(camera, points, noise_px=0.0, seed=0):
    pixels, _ = camera.project(points)
    pixels = pixels + np.random.default_rng(seed).normal(0, noise_px, pixels.shape)
    return [{"world": w.tolist(), "pixel": p.tolist()} for w, p in zip(points, pixels, strict=True)]


def mixed_site(rig, noise_px=0.0):
    """One camera of each kind of calibration."""
    raised = POINTS + np.array([0, 0, 1.0]) * np.arange(len(POINTS))[:, None] % 3
    entries = []
    for camera_id, camera in rig.items():
        kind = len(entries) % 3
        if kind == 0:
            rvec, tvec = camera.T_cam_world.to_rvec_tvec()
            calibration = {"kind": "matrices", "K": camera.K.tolist(), "rvec": rvec.tolist(), "tvec": tvec.tolist()}
        elif kind == 1:
            points = correspondences(camera, raised, noise_px)
            calibration = {"kind": "pnp", "K": camera.K.tolist(), "correspondences": points}
        else:
            calibration = {"kind": "homography", "correspondences": correspondences(camera, POINTS, noise_px)}
        size = {"width_px": camera.width_px, "height_px": camera.height_px}
        entries.append({"id": camera_id, **size, "calibration": calibration})
    return Site.model_validate({"name": "mixed", "cameras": entries})


def replaced(site, index, **calibration):
    document = site.model_dump(mode="json")
    document["cameras"][index]["calibration"].update(calibration)
    return Site.model_validate(document)


def test_every_kind_of_calibration_gives_its_camera_back():
    truth = corner_rig(3)
    rig, residuals = calibrate(mixed_site(truth), CONFIG)
    assert list(rig) == list(truth)
    for camera_id, camera in truth.items():
        np.testing.assert_allclose(rig[camera_id].centre_m, camera.centre_m, atol=1e-3)
        np.testing.assert_allclose(rig[camera_id].K, camera.K, rtol=1e-4)
    assert [r.kind for r in residuals.values()] == ["matrices", "pnp", "homography"]
    assert residuals["cam2"].median_px < 1e-3
    documents = {camera_id: result.document() for camera_id, result in residuals.items()}
    assert documents["cam1"].position_sd_m is None and documents["cam1"].covariance is None
    assert np.shape(documents["cam2"].covariance) == (6, 6) and documents["cam2"].focal_sd_px is None
    assert np.shape(documents["cam3"].covariance) == (9, 9) and 1 < documents["cam3"].focal_sd_px < 20
    assert documents["cam3"].ground_sd_m < 0.3  # its principal point is not known, but the ground is
    assert max(documents["cam2"].position_sd_m) < 1e-6 and max(documents["cam2"].rotation_sd_deg) < 1e-6
    assert residuals["cam1"].median_px is None


def test_noisy_clicks_give_residuals_of_their_size():
    _, residuals = calibrate(mixed_site(corner_rig(3), noise_px=1.0), CONFIG)
    assert 0.2 < residuals["cam2"].median_px < 2.0
    assert 0.01 < np.median(residuals["cam2"].error_m) < 0.5


def test_an_error_names_its_camera():
    site = mixed_site(corner_rig(3))
    site = replaced(
        site, 1, correspondences=site.model_dump(mode="json")["cameras"][1]["calibration"]["correspondences"][:3]
    )
    with pytest.raises(CalibrationError, match="camera cam2: 3 correspondences") as error:
        calibrate(site, CONFIG)
    assert error.value.details["camera"] == "cam2"


def test_a_bad_fit_is_refused():
    site = mixed_site(corner_rig(3), noise_px=40.0)
    with pytest.raises(CalibrationError, match="camera cam2"):
        calibrate(site, CONFIG)


def test_raised_points_do_not_pass_for_ground():
    rig = corner_rig(3)
    site = replaced(mixed_site(rig), 2, correspondences=correspondences(rig["cam3"], POINTS + [0, 0, 1.0]))
    with pytest.raises(CalibrationError, match="z = 0"):
        calibrate(site, CONFIG)


def test_pixels_of_another_image_size_are_refused():
    site = mixed_site(corner_rig(3))
    points = site.model_dump(mode="json")["cameras"][1]["calibration"]["correspondences"]
    scaled = [{**p, "pixel": [3 * p["pixel"][0], 3 * p["pixel"][1]]} for p in points]
    with pytest.raises(CalibrationError, match="outside the image of 640x360"):
        calibrate(replaced(site, 1, correspondences=scaled), CONFIG)


def test_a_camera_that_sees_nothing_of_the_others_is_named():
    rig = dict(corner_rig(3))
    rig["far"] = look_at((520.0, 500.0, 8.0), (500.0, 500.0, 0.0))
    with pytest.raises(NoOverlap, match="camera far"):
        check_overlap(CameraRig(rig))
    with pytest.raises(NoOverlap, match="camera far"):
        calibrate(site_of(CameraRig(rig)), CONFIG)


def test_overlap_may_be_a_chain_and_one_camera_is_enough():
    step = 22.0
    chain = {f"c{i}": look_at((i * step, -15.0, 6.0), (i * step, 0.0, 0.0)) for i in (0, 2, 1)}
    assert not check_overlap(CameraRig(chain))
    assert not check_overlap(CameraRig({"c0": chain["c0"]}))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"K": [[500, 0, 4000], [0, 500, 180], [0, 0, 1]]}, "principal point"),
        ({"K": [[-500, 0, 320], [0, 500, 180], [0, 0, 1]]}, "focal"),
        ({"dist": [0.1]}, "coefficients"),
        ({"tvec_scale": 1000.0}, "8000 m above"),
        ({"tvec_scale": -1.0}, "below the ground"),
        ({"look_up": True}, "no ground"),
    ],
)
def test_implausible_matrices_are_refused(change, match):
    change = dict(change)
    target = (0.0, 0.0, 30.0) if change.pop("look_up", False) else (0.0, 0.0, 0.0)
    camera = look_at((20.0, -12.0, 8.0), target)
    rvec, tvec = camera.T_cam_world.to_rvec_tvec()
    tvec = tvec * change.pop("tvec_scale", 1.0)
    given = {"K": camera.K, "dist": (), "rvec": rvec, "tvec": tvec, "width_px": 640, "height_px": 360, **change}
    with pytest.raises(CalibrationError, match=match) as error:
        camera_from_matrices(**given)
    assert error.value.hint


#: Stops growing at 1.53, inside the image of a lens whose focal length is 0.52 image widths.
FOLDING = (-0.33, 0.13, 0.0, 0.0, -0.025)


@pytest.mark.parametrize("size", [(640, 360), (512, 288)])
@pytest.mark.parametrize("kind", ["matrices", "pnp"])
def test_a_lens_that_folds_back_inside_the_image_is_refused_by_name(kind, size):
    width, height = size
    camera = look_at((20.0, -12.0, 8.0), focal_px=0.42 * width, width_px=width, height_px=height, dist=FOLDING)
    calibration = site_of(CameraRig({"pole": camera})).model_dump(mode="json")["cameras"][0]["calibration"]
    if kind == "pnp":
        shared = {"K": calibration["K"], "dist": calibration["dist"]}
        calibration = {"kind": "pnp", **shared, "correspondences": correspondences(camera, POINTS)}
    entry = {"id": "pole", "width_px": width, "height_px": height, "calibration": calibration}
    with pytest.raises(CalibrationError, match="camera pole: the distortion cannot be undone in") as error:
        calibrate(Site.model_validate({"name": "folded", "cameras": [entry]}), CONFIG)
    assert error.value.details["camera"] == "pole"
    u, v = error.value.details["pixel"]
    assert abs(u - width / 2) > width / 4 and abs(v - height / 2) > height / 4  # near a corner
    for way_out in ("over the whole image", "undistort the recording", "crop"):
        assert way_out in error.value.hint


def test_a_lens_that_folds_in_the_very_corners_is_accepted() -> None:
    """As those of action cameras do whose board was not held into the corners: 14 % of the image here."""
    lens = (-0.2576, 0.0877, -0.0003, -0.0006, -0.0152)
    pose = look_at((20.0, -12.0, 8.0), focal_px=860.0, width_px=1920, height_px=1080).T_world_cam
    camera = build_camera([[860.0, 0.0, 960.0], [0.0, 875.0, 550.0], [0.0, 0.0, 1.0]], lens, pose, 1920, 1080)
    corners_px = np.array([[0.0, 0.0], [1919.0, 0.0], [0.0, 1079.0], [1919.0, 1079.0]])
    rays = camera.rays(corners_px)
    assert np.isfinite(rays).all()
    back, _ = camera.project(camera.centre_m + 10 * rays)
    np.testing.assert_allclose(back, corners_px, atol=1e-6)


@pytest.mark.parametrize(
    ("focal_widths", "dist"),
    [
        (0.75, (-0.40, 0.20, 0.0, 0.0, -0.06)),  # folds beside the image
        (0.62, FOLDING),  # likewise
        (0.52, (-0.33, 0.13, 0.0, 0.0)),  # without its last coefficient, it does not fold
        (0.55, (-0.15, 0.02, 5e-4, -5e-4, 0.0)),
        (0.80, (0.3, 0.1, 0.001, 0.001, 0.0, 0.2, 0.05, 0.01, 0.001, 0.0, -0.001, 0.0, 0.0, 0.0)),
    ],
)
def test_strong_lenses_that_can_be_undone_are_accepted(focal_widths, dist):
    camera = look_at((20.0, -12.0, 8.0), focal_px=focal_widths * 640, dist=dist)
    given = {"K": camera.K, "dist": dist, "width_px": 640, "height_px": 360}
    rvec, tvec = camera.T_cam_world.to_rvec_tvec()
    found = camera_from_matrices(rvec=rvec, tvec=tvec, **given)
    twin = CameraTensors.from_cameras([found])
    for corner in ([-0.5, -0.5], [639.5, 359.5]):
        ray = found.undistort(corner)
        np.testing.assert_allclose(found.project_camera_points([*ray, 1.0]), corner, atol=1e-6)
        np.testing.assert_allclose(undistort(twin, torch.tensor([corner]))[0], ray, atol=1e-3)


def test_a_tilted_sensor_is_refused_by_name():
    site = site_of(corner_rig(2))
    tilted = [-0.1, *[0.0] * 11, 0.0, 0.02]
    with pytest.raises(CalibrationError, match="camera cam2: the lens model has a tilted sensor") as error:
        calibrate(replaced(site, 1, dist=tilted), CONFIG)
    assert "CALIB_TILTED_MODEL" in error.value.hint
    rig, _ = calibrate(replaced(site, 1, dist=[-0.1, *[0.0] * 13]), CONFIG)
    assert CameraTensors.from_cameras(list(rig.values())).dist[1, 0] == pytest.approx(-0.1)


def test_convention_rvec_and_tvec_are_world_to_camera():
    camera = look_at((20.0, -12.0, 8.0))
    rvec, tvec = camera.T_cam_world.to_rvec_tvec()
    expected, _ = cv2.projectPoints(POINTS, rvec, tvec, camera.K, None)
    found = camera_from_matrices(camera.K, (), rvec, tvec, 640, 360)
    np.testing.assert_allclose(found.project(POINTS)[0], expected.reshape(-1, 2), atol=1e-9)


def test_metres_per_pixel_agree_with_moving_the_pixel():
    camera = look_at((20.0, -12.0, 8.0))
    ground = visible_ground(camera, 12)
    pixels, _ = camera.project(ground)
    angles = np.linspace(0, 2 * np.pi, 73)
    moved = [intersect_plane(camera, pixels + 0.01 * np.array([np.cos(a), np.sin(a)])) for a in angles]
    worst = np.max([np.linalg.norm(m - ground, axis=1) / 0.01 for m in moved], axis=0)
    near = np.linalg.norm(ground - camera.centre_m, axis=1) < 60
    np.testing.assert_allclose(metres_per_pixel(camera, ground)[near], worst[near], rtol=0.02)


def test_zones_count_every_point_once_and_grow_coarser_with_distance():
    camera = look_at((20.0, -12.0, 8.0))
    pixels, _ = camera.project(POINTS)
    document = Residuals.of("pnp", camera, POINTS, pixels + 1.0).document()
    assert sum(zone.points for zone in document.zones) == len(POINTS)
    sizes = [zone.m_per_px for zone in document.zones if zone.m_per_px is not None]
    assert len(sizes) >= 3
    assert sizes == sorted(sizes)
    assert document.median_px == pytest.approx(np.sqrt(2))


def test_stage_writes_rig_and_residuals(tmp_path):
    site = mixed_site(corner_rig(3), noise_px=0.3)
    folders = StageFolders(tmp_path)
    summary = stage.run(folders.context("calibrate", site), CONFIG)
    assert list(folders.read(CALIBRATED_RIG)) == ["cam1", "cam2", "cam3"]
    residuals = folders.read(RESIDUALS).cameras["cam2"]
    assert len(residuals.residuals) == len(POINTS)
    assert summary["cameras"]["cam2"]["median_px"] == pytest.approx(residuals.median_px)


@pytest.mark.assets
def test_real_intersection_cameras_load_as_matrices(assets: Path):
    """The two southern cameras are published as OpenCV's world-to-camera pair in metres; they stand
    6 to 9 m above the station's frame. The other two are in other axes and units: they are refused."""
    folder = assets / "calibrations" / "tumtraf_s110"
    cameras = {}
    for name in ("south1", "south2", "north", "east"):
        data = json.loads((folder / f"s110_camera_basler_{name}_8mm.json").read_bytes())
        rvec, _ = cv2.Rodrigues(np.array(data["rotation_matrix"]))
        size = (data["image_width"], data["image_height"])
        given = (data["intrinsic_camera_matrix"], data["dist_coefficients"], rvec, data["translation_matrix"], *size)
        if name in ("north", "east"):
            with pytest.raises(CalibrationError, match="below the ground"):
                camera_from_matrices(*given)
        else:
            cameras[name] = camera_from_matrices(*given)
    for camera in cameras.values():
        assert camera.has_distortion
        assert 5 < camera.centre_m[2] < 10
        back, _ = camera.project(intersect_plane(camera, [960.0, 900.0]))
        np.testing.assert_allclose(back, [960.0, 900.0], atol=1e-3)
    published = json.loads((folder / "s110_camera_basler_south1_8mm.json").read_bytes())["projection_matrix"]
    np.testing.assert_allclose(cameras["south1"].P, published, rtol=1e-6, atol=1e-3)


@pytest.mark.assets
@pytest.mark.parametrize("name", ["south1", "south2"])
def test_real_lenses_and_poses_come_back_from_points_in_a_map_grid(assets: Path, name: str):
    """The intersection's own intrinsics and extrinsics as truth; clicks are off by 0.5 px."""
    folder = assets / "calibrations" / "tumtraf_s110"
    data = json.loads((folder / f"s110_camera_basler_{name}_8mm.json").read_bytes())
    rvec, _ = cv2.Rodrigues(np.array(data["rotation_matrix"]))
    K, dist = data["intrinsic_camera_matrix"], data["dist_coefficients"]
    size = {"width_px": data["image_width"], "height_px": data["image_height"]}
    ready = {"kind": "matrices", "K": K, "dist": dist, "rvec": rvec.ravel(), "tvec": data["translation_matrix"]}
    given = SiteCamera.model_validate({"id": name, **size, "calibration": ready})
    known = solve_camera(given, CONFIG)
    assert known.cautions == ()
    ground = visible_ground(known.camera, 7)
    ground = ground[np.linalg.norm(ground - known.camera.centre_m, axis=1) < 80]
    grid = np.array([691_000.0, 5_334_000.0, 0.0])
    pixels = known.camera.project(ground)[0] + np.random.default_rng(0).normal(0, 0.5, (len(ground), 2))
    points = [
        {"world": world, "pixel": pixel} for world, pixel in zip((ground + grid).tolist(), pixels.tolist(), strict=True)
    ]
    clicked = {"kind": "pnp", "K": K, "dist": dist, "correspondences": points}
    found = solve_camera(SiteCamera.model_validate({"id": name, **size, "calibration": clicked}), CONFIG)
    error_m = found.camera.centre_m - grid - known.camera.centre_m
    assert found.covariance is not None
    assert (np.abs(error_m) < 3.5 * np.array(found.covariance.position_sd_m)).all()
    assert np.linalg.norm(error_m) < 0.2
    assert [caution.code for caution in found.cautions] in ([], ["pixels_outside"])
