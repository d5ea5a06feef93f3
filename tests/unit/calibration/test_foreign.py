"""Calibrations and points as other programs write them: each says the same camera in its own way."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from pyproj import Geod, Transformer
from scipy.io import savemat
from typer.testing import CliRunner

from tests.builders import look_at
from wibam_core.calibration.foreign.registry import read_file, read_named
from wibam_core.cli.app import app
from wibam_core.errors import InputError
from wibam_core.geometry.camera import Camera
from wibam_core.site import HomographyCalibration, MatrixCalibration, PnPCalibration, PointsCalibration, Site

DIST = (-0.21, 0.06, 0.001, -0.0007)
CAMERA = look_at((-20.0, -15.0, 8.0), focal_px=700.0, width_px=1280, height_px=720, dist=DIST)
FX, CX, CY = CAMERA.K[0, 0], CAMERA.K[0, 2], CAMERA.K[1, 2]
RVEC, TVEC = CAMERA.T_cam_world.to_rvec_tvec()
ROAD = np.array([[-9, -6], [-4, 5], [3, -3], [8, 7], [2, 9], [-3, -2], [9, 2], [-7, 3]], dtype=float)
GROUND = np.column_stack([ROAD, np.zeros(len(ROAD))])
PIXELS = CAMERA.project(GROUND)[0]


def saved(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def opencv_file(folder: Path, ending: str) -> Path:
    path = folder / f"lens.{ending}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1280)
    storage.write("image_height", 720)
    storage.write("camera_matrix", np.array(CAMERA.K))
    storage.write("distortion_coefficients", np.array(DIST)[None])
    storage.release()
    return path


def ros_file(folder: Path) -> Path:
    K = CAMERA.K.ravel().tolist()
    text = f"image_width: 1280\nimage_height: 720\ncamera_matrix: {{rows: 3, cols: 3, data: {K}}}\n"
    text += f"distortion_model: plumb_bob\ndistortion_coefficients: {{rows: 1, cols: 4, data: {list(DIST)}}}\n"
    return saved(folder, "ros.yaml", text)


def kalibr_file(folder: Path) -> Path:
    text = "cam0:\n  camera_model: pinhole\n  distortion_model: radtan\n"
    text += f"  distortion_coeffs: {list(DIST)}\n  intrinsics: [{FX}, {FX}, {CX}, {CY}]\n  resolution: [1280, 720]\n"
    return saved(folder, "camchain.yaml", text)


def colmap_file(folder: Path) -> Path:
    numbers = " ".join(map(str, (FX, FX, CX + 0.5, CY + 0.5, *DIST)))
    return saved(folder, "cameras.txt", f"# Camera list\n1 OPENCV 1280 720 {numbers}\n")


def matlab_file(folder: Path) -> Path:
    K = np.array(CAMERA.K)
    K[:2, 2] += 1
    content = {"RadialDistortion": DIST[:2], "TangentialDistortion": DIST[2:], "ImageSize": [720, 1280]}
    return saved(folder, "matlab.json", json.dumps({**content, "IntrinsicMatrix": K.T.tolist()}))


def tumtraf_file(folder: Path) -> Path:
    pose = CAMERA.T_cam_world
    content = {"image_width": 1280, "image_height": 720, "intrinsic_camera_matrix": CAMERA.K.tolist()}
    content |= {"dist_coefficients": DIST, "rotation_matrix": pose.rotation.tolist()}
    return saved(folder, "s1_camera.json", json.dumps(content | {"translation_matrix": pose.translation.tolist()}))


FILES = {
    "OpenCV YAML": lambda folder: opencv_file(folder, "yml"),
    "OpenCV JSON": lambda folder: opencv_file(folder, "json"),
    "ROS": ros_file,
    "Kalibr": kalibr_file,
    "COLMAP": colmap_file,
    "MATLAB": matlab_file,
    "TUMTraf": tumtraf_file,
}


@pytest.mark.parametrize("make", FILES.values(), ids=FILES)
def test_every_format_says_the_same_lens(make, tmp_path: Path) -> None:
    _, (found,) = read_file(make(tmp_path))
    assert found.intrinsics is not None
    np.testing.assert_allclose(found.intrinsics.K, CAMERA.K, atol=1e-9)
    np.testing.assert_allclose(found.intrinsics.dist, DIST)
    assert (found.intrinsics.lens, found.intrinsics.size_px) == ("pinhole", (1280, 720))


def test_wide_lenses_of_other_programs(tmp_path: Path) -> None:
    equi = kalibr_file(tmp_path).read_text().replace("radtan", "equidistant")
    assert read_file(saved(tmp_path, "equi.yaml", equi))[1][0].intrinsics.lens == "fisheye"
    omni = (
        equi.replace("pinhole", "omni").replace("equidistant", "radtan").replace("intrinsics: [", "intrinsics: [1.3, ")
    )
    found = read_file(saved(tmp_path, "omni.yaml", omni))[1][0].intrinsics
    assert (found.lens, found.xi, found.K[0, 0]) == ("omnidirectional", 1.3, FX)
    colmap = colmap_file(tmp_path).read_text().replace("OPENCV", "OPENCV_FISHEYE")
    assert read_file(saved(tmp_path, "c.txt", colmap))[1][0].intrinsics.lens == "fisheye"
    ros = ros_file(tmp_path).read_text().replace("plumb_bob", "equidistant")
    assert read_file(saved(tmp_path, "r.yaml", ros))[1][0].intrinsics.lens == "fisheye"
    with pytest.raises(InputError, match="eucm"):
        read_file(saved(tmp_path, "eucm.yaml", equi.replace("pinhole", "eucm")))
    with pytest.raises(InputError, match="polynomial"):
        read_file(saved(tmp_path, "m.json", json.dumps({"MappingCoefficients": [1, 2, 3, 4]})))


def test_poses_of_colmap_and_tumtraf_are_world_to_camera(tmp_path: Path) -> None:
    w, xyz = np.cos(np.linalg.norm(RVEC) / 2), np.sin(np.linalg.norm(RVEC) / 2) * RVEC / np.linalg.norm(RVEC)
    numbers = " ".join(map(str, (w, *xyz, *TVEC)))
    text = f"# IMAGE_ID, ...\n1 {numbers} 1 shots/north.jpg\n\n2 1 0 0 0 0 0 0 1 shots/south side.jpg\n12 13 -1\n"
    _, images = read_file(saved(tmp_path, "images.txt", text))
    assert [image.name for image in images] == ["north", "south side"]
    for found in (images[0], read_file(tumtraf_file(tmp_path))[1][0]):
        np.testing.assert_allclose(found.rvec, RVEC, atol=1e-9)
        np.testing.assert_allclose(found.tvec, TVEC, atol=1e-9)


def test_an_unknown_or_a_broken_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"notes\.txt is of no known calibration format"):
        read_file(saved(tmp_path, "notes.txt", "north camera: 6 m high"))
    with pytest.raises(InputError, match=r"broken\.yaml.*3 x 3"):
        read_file(saved(tmp_path, "broken.yaml", "camera_matrix: [1, 2, 3]\n"))


# --- points on Earth ---------------------------------------------------------------------------
LATITUDE, LONGITUDE = 48.137154, 11.576124


def on_earth(world: np.ndarray) -> np.ndarray:
    """Longitude and latitude (N, 2) of places (N, 2), m east and north of the origin: along geodesics, not by us."""
    bearing = np.degrees(np.arctan2(world[:, 0], world[:, 1]))
    at = np.full(len(world), LONGITUDE), np.full(len(world), LATITUDE)
    longitude, latitude, _ = Geod(ellps="WGS84").fwd(*at, bearing, np.hypot(*world.T))
    return np.column_stack([longitude, latitude])


def geojson_file(folder: Path, **properties) -> Path:
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": place.tolist()},
            "properties": {"pixel": pixel.tolist(), **properties},
        }
        for place, pixel in zip(on_earth(ROAD), PIXELS, strict=True)
    ]
    return saved(folder, "points.geojson", json.dumps({"type": "FeatureCollection", "features": features}))


def qgis_file(folder: Path, crs: str | None, places: np.ndarray) -> Path:
    rows = [f"{x},{y},{u + 0.5},{-(v + 0.5)},1,0,0,0" for (x, y), (u, v) in zip(places, PIXELS, strict=True)]
    rows.append("1,2,3,-4,0,0,0,0")
    head = [] if crs is None else [f"#CRS: {crs}"]
    return saved(folder, "north.points", "\n".join([*head, "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual", *rows]))


def told(site: Path, camera: str, *files: Path) -> str:
    arguments = ["calibration", str(site), camera, *map(str, files)]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def origin_at(site: Path) -> None:
    """A site that has its origin, and another camera, already."""
    calibration = {"kind": "homography", "correspondences": []}
    other = {"id": "other", "width_px": 640, "height_px": 360, "calibration": calibration}
    document = {"name": "x", "cameras": [other], "origin": {"latitude_deg": LATITUDE, "longitude_deg": LONGITUDE}}
    site.mkdir()
    (site / "site.json").write_text(json.dumps(document))


def camera_of(site: Path, camera_id: str) -> tuple[Site, object]:
    found = Site.load(site / "site.json")
    return found, next(one for one in found.cameras if one.id == camera_id)


@pytest.mark.parametrize("form", ["geojson", "qgis 4326", "qgis utm"])
def test_points_on_earth_and_a_lens_calibrate_in_the_sites_world(form: str, tmp_path: Path) -> None:
    site = tmp_path / "site"
    origin_at(site)
    if form == "geojson":
        points = geojson_file(tmp_path)
    elif form == "qgis 4326":
        points = qgis_file(tmp_path, "EPSG:4326", on_earth(ROAD))
    else:
        to_utm = Transformer.from_crs(4326, 32632, always_xy=True)
        points = qgis_file(tmp_path, "EPSG:32632", np.column_stack(to_utm.transform(*on_earth(ROAD).T)))
    output = told(site, "north", kalibr_file(tmp_path), points)
    assert "metres from 48.137" in output
    found, north = camera_of(site, "north")
    assert isinstance(north.calibration, PnPCalibration)
    world = np.array([one.world for one in north.calibration.correspondences])
    np.testing.assert_allclose(world, GROUND, atol=2e-3)
    np.testing.assert_allclose([one.pixel for one in north.calibration.correspondences], PIXELS, atol=1e-6)
    assert "at -20.0" in output and "-15.0" in output
    assert found.camera_ids == ("other", "north")
    assert (north.width_px, north.height_px) == (1280, 720)


def test_points_alone_make_a_homography_and_the_sites_first_origin(tmp_path: Path) -> None:
    straight = look_at((-20.0, -15.0, 8.0), focal_px=700.0, width_px=1280, height_px=720)
    pixels, _ = straight.project(GROUND)
    content = json.loads(geojson_file(tmp_path).read_text())
    for feature, pixel in zip(content["features"], pixels, strict=True):
        feature["properties"] = {"u": pixel[0], "v": pixel[1], "camera": "north"}
    content["features"].append({"type": "Feature", "geometry": None, "properties": None})
    file = saved(tmp_path, "gcp.json", json.dumps(content))
    site = tmp_path / "new"
    site.mkdir()
    with pytest.raises(InputError, match="size of camera north"):
        told(site, "north", file)
    lens = told(site, "north", tumtraf_file(tmp_path))  # says the size, and is replaced then
    assert "matrices" in lens
    document = json.loads((site / "site.json").read_text())
    document["cameras"][0]["calibration"] = {"kind": "homography", "correspondences": []}
    (site / "site.json").write_text(json.dumps(document))
    output = told(site, "north", file)
    assert "1 features that are no points" in output and "no origin" in output
    found, north = camera_of(site, "north")
    assert isinstance(north.calibration, HomographyCalibration)
    assert found.origin is not None and found.origin.latitude_deg == pytest.approx(LATITUDE, abs=1e-4)


def test_points_alone_of_which_some_are_raised_tell_the_lens_as_well(tmp_path: Path) -> None:
    raised = np.array([[-6.0, -4.0, 3.0], [5.0, 6.0, 4.0], [7.0, -3.0, 2.5], [-3.0, 6.0, 3.5]])
    bent = look_at((-20.0, -15.0, 8.0), focal_px=700.0, width_px=1280, height_px=720, dist=(-0.2, 0.0, 0.0, 0.0))
    world = np.concatenate([GROUND, raised])
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
            "properties": {"pixel": pixel, "height_m": height},
        }
        for (longitude, latitude), pixel, height in zip(
            on_earth(world[:, :2]).tolist(), bent.project(world)[0].tolist(), world[:, 2].tolist(), strict=True
        )
    ]
    file = saved(tmp_path, "gcp.geojson", json.dumps({"type": "FeatureCollection", "features": features}))
    site = tmp_path / "site"
    origin_at(site)
    told(site, "north", tumtraf_file(tmp_path))
    document = json.loads((site / "site.json").read_text())
    document["cameras"][1]["calibration"] = {"kind": "homography", "correspondences": []}
    (site / "site.json").write_text(json.dumps(document))
    assert "points, at -20." in told(site, "north", file)
    _, north = camera_of(site, "north")
    assert isinstance(north.calibration, PointsCalibration)


def test_a_ready_pose_and_its_lens_are_taken_as_they_are_and_scaled_with_the_picture(tmp_path: Path) -> None:
    site = tmp_path / "site"
    told(site, "north", tumtraf_file(tmp_path))
    _, north = camera_of(site, "north")
    assert isinstance(north.calibration, MatrixCalibration)
    again = Camera(north.calibration.K, np.array(north.calibration.dist), CAMERA.T_world_cam, 1280, 720)
    np.testing.assert_allclose(again.project(GROUND)[0], PIXELS, atol=1e-9)
    document = json.loads((site / "site.json").read_text())
    document["cameras"][0] |= {"width_px": 640, "height_px": 360}
    (site / "site.json").write_text(json.dumps(document))
    assert "K was scaled" in told(site, "north", tumtraf_file(tmp_path))
    _, half = camera_of(site, "north")
    assert half.calibration.K[0][2] == pytest.approx((CX + 0.5) / 2 - 0.5)
    document["cameras"][0] |= {"width_px": 640, "height_px": 480}
    (site / "site.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="1280x720 px, and the recording has 640x480 px"):
        told(site, "north", tumtraf_file(tmp_path))
    with pytest.raises(InputError, match="no surveyed points"):
        told(tmp_path / "other", "north", kalibr_file(tmp_path))


def test_opencvs_xml_says_what_its_yaml_says(tmp_path: Path) -> None:
    """As `cv2.FileStorage` itself writes it."""
    path = tmp_path / "lens.xml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1280)
    storage.write("image_height", 720)
    storage.write("camera_matrix", np.array(CAMERA.K))
    storage.write("distortion_coefficients", np.array([DIST]))
    storage.write("distortion_model", "plumb_bob")
    storage.release()
    form, (found,) = read_file(path)
    assert form == "OpenCV YAML, JSON or XML" and found.intrinsics is not None
    np.testing.assert_allclose(found.intrinsics.K, CAMERA.K)
    np.testing.assert_allclose(found.intrinsics.dist, DIST)
    assert found.intrinsics.size_px == (1280, 720)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("bomb.xml", '<!DOCTYPE x [<!ENTITY a "aa">]><opencv_storage><K>&a;</K></opencv_storage>'),
        ("bomb.yaml", "a: &a [1, 1]\nb: &b [*a, *a]\nK: [*b, *b]\n"),
        ("deep.json", "[" * 100_000),
        ("deep.yaml", "K: " + "[" * 5_000),
    ],
)
def test_texts_that_stand_for_more_than_they_are_long_are_refused(name: str, text: str) -> None:
    with pytest.raises(InputError):
        read_named(name, text)


def double_sphere(points: np.ndarray, numbers: list[float]) -> np.ndarray:
    """Pixels (N, 2) of camera-frame points (N, 3), written down from the model's paper."""
    xi, alpha, fu, fv, pu, pv = numbers
    x, y, z = points.T
    d1 = np.sqrt(x * x + y * y + z * z)
    d2 = np.sqrt(x * x + y * y + (xi * d1 + z) ** 2)
    below = alpha * d2 + (1 - alpha) * (xi * d1 + z)
    return np.column_stack([fu * x / below + pu, fv * y / below + pv])


def enhanced_unified(points: np.ndarray, numbers: list[float]) -> np.ndarray:
    """The same of the enhanced unified model."""
    alpha, beta, fu, fv, pu, pv = numbers
    x, y, z = points.T
    below = alpha * np.sqrt(beta * (x * x + y * y) + z * z) + (1 - alpha) * z
    return np.column_stack([fu * x / below + pu, fv * y / below + pv])


@pytest.mark.parametrize(
    ("model", "numbers", "project"),
    [
        ("ds", [-0.2, 0.59, 320.0, 321.0, 639.5, 479.5], double_sphere),
        ("eucm", [0.62, 1.05, 340.0, 340.0, 645.0, 470.0], enhanced_unified),
    ],
)
def test_kalibrs_spheres_become_the_fisheye_that_they_look_like(model, numbers, project, tmp_path: Path) -> None:
    text = (
        f"cam0:\n  camera_model: {model}\n  distortion_model: none\n  distortion_coeffs: []\n"
        f"  intrinsics: {numbers}\n  resolution: [1280, 960]\n"
    )
    _, (found,) = read_file(saved(tmp_path, "camchain.yaml", text))
    lens = found.intrinsics
    assert lens is not None and lens.lens == "fisheye" and any("differs from it by" in note for note in found.notes)
    camera = Camera(lens.K, lens.dist, CAMERA.T_world_cam, 1280, 960, "fisheye")
    angle, around = np.meshgrid(np.radians(np.arange(0.5, 85.0, 3.0)), np.radians(np.arange(0, 360, 30)))
    rays = np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], axis=-1)
    rays = rays.reshape(-1, 3)
    expected = project(rays, numbers)
    shown = camera.contains(expected)
    assert shown.sum() > 100
    np.testing.assert_allclose(camera.project_camera_points(rays[shown]), expected[shown], atol=0.25)


def test_a_sphere_that_no_fisheye_is_like_is_refused_with_what_to_do(tmp_path: Path) -> None:
    text = "cam0:\n  camera_model: eucm\n  intrinsics: [0.0, 1.0, 300, 300, 639.5, 479.5]\n  resolution: [1280, 960]\n"
    with pytest.raises(InputError, match="differs from") as refused:
        read_file(saved(tmp_path, "camchain.yaml", text))
    assert "pinhole-equi" in (refused.value.hint or "")
    broken = text.replace("[0.0, 1.0, 300,", "[7.0, 1.0, 300,")
    with pytest.raises(InputError, match="not those of a lens"):
        read_file(saved(tmp_path, "camchain.yaml", broken))


def test_matlabs_structs_are_read_from_its_own_files(tmp_path: Path) -> None:
    path = tmp_path / "lens.mat"
    struct = {
        "RadialDistortion": [DIST[0], DIST[1]],
        "TangentialDistortion": [DIST[2], DIST[3]],
        "ImageSize": [720.0, 1280.0],
        "IntrinsicMatrix": (CAMERA.K + [[0, 0, 1], [0, 0, 1], [0, 0, 0]]).T,
    }
    savemat(path, {"params": struct, "note": "x"})
    form, (found,) = read_file(path)
    assert "MATLAB" in form and found.name == "params" and found.intrinsics is not None
    np.testing.assert_allclose(found.intrinsics.K, CAMERA.K)
    np.testing.assert_allclose(found.intrinsics.dist, DIST)
    savemat(path, {"other": {"a": 1.0}})
    with pytest.raises(InputError, match="RadialDistortion") as refused:
        read_file(path)
    assert "toStruct" in (refused.value.hint or "")
    path.write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    with pytest.raises(InputError, match="broken"):
        read_file(path)
