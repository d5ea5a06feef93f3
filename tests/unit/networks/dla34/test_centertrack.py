"""Boxes encoded by hand into head maps, for many cameras, come back; the warp and its inverse are the published."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from tests.builders import look_at
from wibam_core.geometry.box3d import corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3, normalise_angle
from wibam_core.models.frames import Frame
from wibam_core.models.network import predict
from wibam_core.networks.dla34.architecture import DLA34, HEADS
from wibam_core.networks.dla34.centertrack import (
    TRAINED_FOCAL_PX,
    Decoded,
    InputWarp,
    decode_vehicles,
)
from wibam_core.networks.dla34.classes import RoadUserChannels
from wibam_core.networks.dla34.network import CenterTrack
from wibam_core.road_users import RoadUserClass
from wibam_core.traits import NUSCENES_CLASSES


def off_centre(camera: Camera, du_px: float, dv_px: float) -> Camera:
    K = camera.K + np.array([[0, 0, du_px], [0, 0, dv_px], [0, 0, 0]])
    return Camera(K, camera.dist, camera.T_world_cam, camera.width_px, camera.height_px)


def rolled(camera: Camera, roll_rad: float) -> Camera:
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    pose = camera.T_world_cam
    rotation = pose.rotation @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return Camera(camera.K, camera.dist, SE3(rotation, pose.translation), camera.width_px, camera.height_px)


CAMERAS = {
    "level": look_at((0.0, -25.0, 1.6), (0.0, 0.0, 1.6), focal_px=1266.0, width_px=1600, height_px=900),
    "pitched": look_at((20.0, 5.0, 8.0), focal_px=1100.0, width_px=1920, height_px=1080),
    "steep": look_at((6.0, 5.0, 12.0), focal_px=400.0, width_px=640, height_px=480),
    "portrait": look_at((-18.0, 12.0, 7.0), focal_px=1500.0, width_px=1080, height_px=1920),
    "off_centre": off_centre(look_at((18.0, 0.0, 7.0), focal_px=500.0), 60.0, -35.0),
    "distorted": look_at((15.0, -9.0, 7.0), focal_px=380.0, dist=(-0.25, 0.06, 0.001, -0.002, 0.0)),
    "rolled": rolled(look_at((-16.0, -12.0, 8.0), focal_px=500.0), 0.15),
}


def published_alpha_rad(camera: Camera, box: np.ndarray) -> float:
    """KITTI's rotation_y less the angle of the line of sight, in a camera turned level about its centre."""
    forward = camera.T_world_cam.rotation[:, 2] * [1, 1, 0]
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    heading = np.array([np.cos(box[6]), np.sin(box[6]), 0.0])
    rotation_y = np.arctan2(-heading @ forward, heading @ right)
    sight = box[:3] - camera.centre_m
    return float(normalise_angle(rotation_y - np.arctan2(sight @ right, sight @ forward)))


@dataclass(frozen=True)
class Truth:
    """A box (7,) in the world, its nuScenes class and score."""

    box: np.ndarray
    name: str = "car"
    score: float = 0.9


CLASSES = RoadUserChannels.of(NUSCENES_CLASSES)
FOUND = [NUSCENES_CLASSES[channel] for channel in CLASSES.channels]


def decode(heads: dict[str, torch.Tensor], warp: InputWarp, camera: Camera) -> Decoded:
    return decode_vehicles(heads, warp, camera, CLASSES, min_score=0.3, decode="depth")


def empty_heads(warp: InputWarp) -> dict[str, torch.Tensor]:
    width, height = (side // 4 for side in warp.input_px)
    heads = {name: torch.zeros(1, channels, height, width, dtype=torch.float64) for name, channels in HEADS.items()}
    heads["hm"] -= 9.0
    return heads


def cells(warp: InputWarp, camera: Camera, pixels: np.ndarray) -> np.ndarray:
    middle = np.array([camera.width_px, camera.height_px]) / 2
    return (warp.scale * (pixels - middle) + np.array(warp.input_px) / 2) / 4


def encode(heads: dict[str, torch.Tensor], warp: InputWarp, camera: Camera, truth: Truth) -> np.ndarray:
    """Write one vehicle into the maps by the published definitions, read forwards; returns its 2D box, px."""
    box = truth.box
    uv, _ = camera.project(corners(box))
    box2d = np.concatenate([uv.min(axis=0), uv.max(axis=0)])
    low, high = cells(warp, camera, box2d[:2]), cells(warp, camera, box2d[2:])
    middle = (low + high) / 2
    centre3d_px, depth_m = camera.project(box[:3])
    x, y = (int(v) for v in middle)
    focal_px = warp.scale * np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    seen_m = depth_m * (1266.0 / 2) / focal_px
    share = 1 / (1 + seen_m) - 1e-6
    alpha = published_alpha_rad(camera, box)
    first = alpha < 0  # the first bin is about −π/2, the second about π/2
    turned = alpha + np.pi / 2 if first else alpha - np.pi / 2
    rot = np.full(8, 9.0)
    rot[[1, 5]] = [2.0, -1.0] if first else [-1.0, 2.0]
    rot[slice(2, 4) if first else slice(6, 8)] = 3 * np.array([np.sin(turned), np.cos(turned)])
    heads["hm"][0, NUSCENES_CLASSES.index(truth.name), y, x] = np.log(truth.score / (1 - truth.score))
    for name, values in {
        "reg": middle - [x, y],
        "wh": high - low,
        "amodel_offset": cells(warp, camera, centre3d_px) - middle,
        "dep": np.log(share / (1 - share)),
        "dim": box[[5, 4, 3]],
        "rot": rot,
    }.items():
        heads[name][0, :, y, x] = torch.as_tensor(np.atleast_1d(values))
    return box2d


def decoded(camera: Camera, *truths: Truth, long_side_px: int = 800) -> tuple[Decoded, list[np.ndarray]]:
    warp = InputWarp.of(camera.width_px, camera.height_px, long_side_px)
    heads = empty_heads(warp)
    boxes2d = [encode(heads, warp, camera, truth) for truth in truths]
    return decode(heads, warp, camera), boxes2d


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("yaw", np.linspace(-3.0, 3.1, 7))
def test_a_box_comes_back(name: str, yaw: float) -> None:
    box = np.array([1.2, -1.7, 0.85, 4.6, 1.9, 1.7, yaw])
    found, boxes2d = decoded(CAMERAS[name], Truth(box))
    np.testing.assert_allclose(found.boxes, [box], atol=1e-6)
    np.testing.assert_allclose(found.boxes2d, boxes2d, atol=1e-6)
    assert found.scores == pytest.approx([0.9])


def test_convention_a_nuscenes_car_needs_no_scaling() -> None:
    camera = CAMERAS["level"]
    assert TRAINED_FOCAL_PX == 633.0
    warp = InputWarp.of(1600, 900)
    heads = empty_heads(warp)
    encode(heads, warp, camera, Truth(np.array([0.0, 5.0, 1.6, 4.5, 1.9, 1.6, 0.0])))
    row, column = (int(v) for v in np.argwhere(heads["hm"][0, 0].numpy() > 0)[0])
    assert 1 / (torch.sigmoid(heads["dep"][0, 0, row, column]) + 1e-6) - 1 == pytest.approx(30.0)


@pytest.mark.parametrize(("camera", "input_px"), [("level", 400), ("pitched", 1280)])
def test_the_depth_does_not_depend_on_the_inputs_size(camera: str, input_px: int) -> None:
    box = np.array([1.2, -1.7, 0.85, 4.6, 1.9, 1.7, 0.4])
    found, _ = decoded(CAMERAS[camera], Truth(box), long_side_px=input_px)
    np.testing.assert_allclose(found.boxes, [box], atol=1e-6)


def test_the_same_maps_mean_twice_the_distance_at_twice_the_focal_length() -> None:
    near, far = (look_at((0.0, -30.0, 6.0), focal_px=f, width_px=640, height_px=360) for f in (400.0, 800.0))
    warp = InputWarp.of(640, 360)
    heads = empty_heads(warp)
    encode(heads, warp, near, Truth(np.array([0.0, 0.0, 0.8, 4.5, 1.9, 1.6, 0.3])))
    depths = [float(camera.to_camera(decode(heads, warp, camera).boxes[0, :3])[2]) for camera in (near, far)]
    assert depths[1] == pytest.approx(2 * depths[0])


def test_a_pitched_cameras_yaw_is_not_the_level_formulas() -> None:
    camera = CAMERAS["steep"]
    box = np.array([2.5, -1.0, 0.8, 4.5, 1.9, 1.6, 0.7])
    found, _ = decoded(camera, Truth(box))
    uv, _ = camera.project(box[:3])
    axis = camera.T_world_cam.rotation[:, 2]
    rotation_y = published_alpha_rad(camera, box) + np.arctan2(uv[0] - camera.K[0, 2], camera.K[0, 0])
    level = normalise_angle(np.arctan2(axis[1], axis[0]) - np.pi / 2 - rotation_y)
    assert found.boxes[0, 6] == pytest.approx(0.7)
    assert abs(float(normalise_angle(level - 0.7))) > np.deg2rad(2)


def test_classes_are_ours_or_left_out() -> None:
    camera = look_at((0.0, -40.0, 12.0), focal_px=1100.0, width_px=1920, height_px=1080)
    truths = [
        Truth(np.array([6.0 * (i % 5) - 12.0, 12.0 * (i // 5) - 6.0, 0.8, 3.0, 1.8, 1.6, 0.2]), name, 0.9 - i / 100)
        for i, name in enumerate(NUSCENES_CLASSES)
    ]
    found, _ = decoded(camera, *truths)
    kinds = [RoadUserClass.CAR, RoadUserClass.TRUCK, RoadUserClass.BUS, RoadUserClass.TRUCK]
    kinds += [RoadUserClass.PEDESTRIAN, RoadUserClass.MOTORCYCLE, RoadUserClass.BICYCLE]
    assert found.classes.tolist() == [kind.number for kind in kinds]
    assert {"car", "truck", "bus", "construction_vehicle"} <= set(FOUND)
    assert not {"trailer", "traffic_cone", "barrier"} & set(FOUND)
    np.testing.assert_allclose(found.boxes, [t.box for t in truths if t.name in FOUND], atol=1e-6)


def test_one_vehicle_is_found_once() -> None:
    camera = CAMERAS["pitched"]
    box = np.array([1.2, -1.7, 0.85, 4.6, 1.9, 1.7, 0.4])
    both, _ = decoded(camera, Truth(box, "truck", 0.6), Truth(box, "bus", 0.8))  # two classes at one cell
    assert both.classes.tolist() == [RoadUserClass.BUS.number]
    warp = InputWarp.of(camera.width_px, camera.height_px)
    heads = empty_heads(warp)
    encode(heads, warp, camera, Truth(box))
    row, column = (int(v) for v in np.argwhere(heads["hm"][0, 0].numpy() > 0)[0])
    for values in heads.values():
        values[0, :, row, column + 3] = values[0, :, row, column]
    heads["hm"][0, 0, row, column + 3] -= 1.0
    assert len(decode(heads, warp, camera).boxes) == 2
    heads["reg"][0, 0, row, column + 3] -= 3.0  # two peaks that mean the same 2D box
    np.testing.assert_allclose(decode(heads, warp, camera).boxes, [box], atol=1e-6)


@pytest.mark.parametrize(
    ("head", "value"),
    [("dim", -1.0), ("dim", 0.0), ("dim", np.nan), ("rot", np.nan), ("reg", np.inf), ("amodel_offset", np.nan)],
)
@pytest.mark.parametrize("name", ["pitched", "distorted"])
def test_impossible_boxes_are_left_out(head: str, value: float, name: str) -> None:
    camera = CAMERAS[name]
    warp = InputWarp.of(camera.width_px, camera.height_px)
    heads = empty_heads(warp)
    encode(heads, warp, camera, Truth(np.array([1.2, -1.7, 0.85, 4.6, 1.9, 1.7, 0.4])))
    assert len(decode(heads, warp, camera).boxes) == 1
    heads[head][:] = value
    assert len(decode(heads, warp, camera).boxes) == 0


def test_convention_the_warp_is_the_published_one() -> None:
    warp = InputWarp.of(1600, 900)
    assert warp.input_px == (800, 448)
    assert warp.scale == 0.5
    np.testing.assert_allclose(
        warp.pixels(np.array([[100.0, 56.0], [0.0, 0.0], [200.0, 112.0]])), [[800, 450], [0, 2], [1600, 898]]
    )
    assert InputWarp.of(1920, 1080).input_px == (800, 448)
    assert InputWarp.of(640, 480).input_px == (800, 608)
    assert InputWarp.of(1080, 1920).input_px == (448, 800)


@pytest.mark.parametrize(("width", "height"), [(1600, 900), (640, 480), (300, 500)])
def test_a_bright_spot_lies_where_the_inverse_says(width: int, height: int) -> None:
    image = np.zeros((height, width, 3), dtype=np.uint8)
    u, v = width // 3, height // 4
    image[v - 4 : v + 5, u - 4 : u + 5] = 255  # centred on pixel (u, v)
    warp = InputWarp.of(width, height)
    tensor = warp.to_input(image)
    assert tensor.shape == (1, 3, warp.input_px[1], warp.input_px[0])
    weight = tensor[0, 0].double().numpy() - float(tensor.min(dim=-1).values.min(dim=-1).values[0, 0])
    rows, columns = np.indices(weight.shape)
    at = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
    np.testing.assert_allclose(warp.pixels(at / 4), [u, v], atol=0.06 / min(warp.scale, 1.0))


def test_convention_the_input_is_normalised_blue_green_red() -> None:
    image = np.full((90, 160, 3), (51, 102, 204), dtype=np.uint8)
    tensor = InputWarp.of(160, 90).to_input(image)
    expected = [(0.2 - 0.40789655) / 0.2886383, (0.4 - 0.44719303) / 0.27408165, (0.8 - 0.47026116) / 0.27809834]
    np.testing.assert_allclose(tensor[0, :, 100, 300].numpy(), expected, rtol=1e-5)
    assert tensor.dtype == torch.float32


def test_frames_of_any_size_give_one_answer_each() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    network = DLA34()
    with torch.no_grad():
        network.hm[2].bias.fill_(1.0)
        network.hm[2].weight.normal_(std=0.5)
        network.dim[2].bias.copy_(torch.tensor([1.6, 1.9, 4.5]))
    rng = np.random.default_rng(0)
    frames = [
        Frame(rng.integers(0, 256, (h, w, 3), dtype=np.uint8), CAMERAS["pitched"].resized(2 * w, 2 * h), f"cam{n}", n)
        for n, (w, h) in enumerate([(320, 180), (160, 120), (90, 160)])
    ]
    detector = CenterTrack(network.train())
    detector.long_side_px = 128
    found = list(predict(detector, frames, decode="depth", min_score=0.3))
    assert not network.training
    assert [(v.time_ns, v.camera_id) for v in found] == [(0, "cam0"), (1, "cam1"), (2, "cam2")]
    for vehicles in found:
        assert len(vehicles) > 0
        assert np.isnan(vehicles.sd).all()
        assert (np.diff(vehicles.scores) <= 0).all()
        assert (vehicles.scores >= 0.3).all()
    other = frames[0].camera.resized(320, 180)  # the camera's size does not matter
    alike = [Frame(frames[0].image, other, "cam0", 0)]
    again = next(predict(detector, alike, decode="depth", min_score=0.3))
    np.testing.assert_allclose(again.boxes, found[0].boxes)
    ways = next(detector.predict_each(frames, min_score=0.3, decodes=("plane", "depth")))
    np.testing.assert_array_equal(ways[1].boxes, found[0].boxes)
    assert not np.allclose(ways[0].boxes[0, :2], ways[1].boxes[0, :2])
