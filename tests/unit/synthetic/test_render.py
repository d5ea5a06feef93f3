"""The renderer's truth: boxes, visibility and occlusion agree with geometry and with the id mask."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from wibam_core.geometry.box3d import corners, vehicle_to_world
from wibam_core.geometry.camera import Camera
from wibam_core.synthetic.cameras import intrinsics, look, look_at
from wibam_core.synthetic.layout import Layout, Pole, make_layout
from wibam_core.synthetic.lighting import Lighting, Photometry, develop
from wibam_core.synthetic.render import Drawing, Renderer
from wibam_core.synthetic.vehicles import VehicleModel, sample_vehicle, vehicle_mesh

SIZE = (480, 270)
LIGHT = Lighting((0.3, 0.2, 0.93), 0.6, 0.5, 0.6, (200, 150, 100), (220, 210, 200), 300.0)
OFF = {"a": "red", "b": "red"}


def empty_layout(*poles: Pole) -> Layout:
    """Roads, and nothing upright but the given poles (and signal heads)."""
    full = make_layout(1)
    return Layout(1, full.arms, (), poles, (), full.signals, full.asphalt, full.sidewalk, full.terrain)


def camera_at(x: float, y: float, z: float, target: tuple[float, float, float], dist: tuple[float, ...] = ()) -> Camera:
    pose = look_at(np.array([x, y, z]), np.array(target))
    return Camera(intrinsics(0.7, SIZE), np.array(dist), pose, *SIZE)


def car(x: float, y: float, yaw: float = 0.4, seed: int = 0) -> tuple[VehicleModel, np.ndarray]:
    model = sample_vehicle(np.random.default_rng(seed))
    length, width, height = model.size_m
    return model, np.array([x, y, height / 2, length, width, height, yaw])


def draw(camera: Camera, *cars: tuple[VehicleModel, np.ndarray], layout: Layout | None = None) -> Drawing:
    renderer = Renderer(layout or empty_layout(), LIGHT, camera)
    return renderer.draw([m for m, _ in cars], np.array([b for _, b in cars]).reshape(-1, 7), OFF)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("dist", [(), (-0.15, 0.02, 0.0, 0.0, 0.0)])
def test_boxes_of_a_free_vehicle_are_those_of_its_projected_body(seed: int, dist: tuple[float, ...]) -> None:
    rng = np.random.default_rng(seed)
    camera = camera_at(14, -3, rng.uniform(1.5, 9), (0, 0, 0.7), dist)
    model, box = car(float(rng.uniform(-4, 4)), float(rng.uniform(-3, 3)), float(rng.uniform(-3, 3)), seed)
    drawing = draw(camera, (model, box))
    uv, _ = camera.project(vehicle_to_world(box, vehicle_mesh(model).points))
    expected = np.concatenate([uv.min(axis=0), uv.max(axis=0)])
    inside = (expected[:2] > 0).all() and (expected[2:] < np.array(SIZE) - 1).all()
    assert inside, "choose the scene so that the vehicle is in view"
    assert drawing.amodal_boxes[0] == pytest.approx(expected, abs=1e-6)
    assert drawing.visible_boxes[0] == pytest.approx(expected, abs=1.0)
    assert drawing.visibility[0] > 0.99
    rows, columns = np.nonzero(drawing.ids == 1)
    mask_box = np.array([columns.min(), rows.min(), columns.max(), rows.max()])
    assert np.abs(mask_box - drawing.visible_boxes[0]).max() <= 1.0


def test_tight_box_is_smaller_than_the_cuboids() -> None:
    """The reason for tapered bodies: projected cuboids are larger than silhouettes."""
    camera = camera_at(14, -3, 7, (0, 0, 0.7))
    model, box = car(0, 0, 0.8)
    drawing = draw(camera, (model, box))
    uv, _ = camera.project(corners(box))
    cuboid = np.concatenate([uv.min(axis=0), uv.max(axis=0)])
    x0, y0, x1, y1 = drawing.amodal_boxes[0]
    assert (x1 - x0) * (y1 - y0) < 0.93 * np.prod(cuboid[2:] - cuboid[:2])


@pytest.mark.parametrize("seed", range(6))
def test_visible_lies_in_amodal_and_pixels_are_counted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cars = [car(*rng.uniform(-12, 12, 2), rng.uniform(-3, 3), i) for i in range(12)]
    drawing = draw(camera_at(18, 4, 3, (0, 0, 0.5)), *cars)
    seen = drawing.visibility > 0
    visible, amodal = drawing.visible_boxes[seen], drawing.amodal_boxes[seen]
    assert (visible[:, :2] >= amodal[:, :2]).all()
    assert (visible[:, 2:] <= amodal[:, 2:]).all()
    assert ((drawing.visibility >= 0) & (drawing.visibility <= 1)).all()
    shown = np.unique(drawing.ids)
    assert set(shown[shown > 0] - 1) == set(np.flatnonzero(seen))


def test_a_nearer_vehicle_hides_a_farther_one() -> None:
    camera = camera_at(20, 0, 1.6, (0, 0, 1.0))
    far, near = car(-6, 0, np.pi / 2, 1), car(4, 0, np.pi / 2, 2)
    for order in ((far, near), (near, far)):
        drawing = draw(camera, *order)
        by_distance = drawing.visibility[[order.index(far), order.index(near)]]
        assert by_distance[1] > 0.99
        assert by_distance[0] < 0.7
        alone = draw(camera, far)
        assert drawing.amodal_boxes[order.index(far)] == pytest.approx(alone.amodal_boxes[0])


def test_long_vehicles_side_by_side_are_painted_in_the_right_order() -> None:
    """A car beside the front half of a bus is nearer to the camera than the bus, though its centre is farther."""
    bus = VehicleModel("city", 12.0, 2.5, 3.0, (200, 80, 40), (200, 200, 200))
    small = VehicleModel("hatchback", 4.0, 1.7, 1.5, (30, 30, 200), (90, 90, 90))
    camera = camera_at(0, -14, 2.0, (6, 0, 1.0))
    boxes = [np.array([0, 0, 1.5, 12, 2.5, 3.0, 0.0]), np.array([10.0, -2.4, 0.75, 4.0, 1.7, 1.5, 0.0])]
    drawing = draw(camera, (bus, boxes[0]), (small, boxes[1]))
    assert drawing.visibility[1] > 0.99


def test_a_pole_hides_what_is_behind_it_alone() -> None:
    camera = camera_at(20, 0, 2.0, (0, 0, 1.0))
    pole = Pole(8.0, 0.0, 6.0, 0.25, (90.0, 90.0, 90.0))
    behind, before = car(0, 0, np.pi / 2, 3), car(11, 0, np.pi / 2, 3)
    layout = empty_layout(pole)
    hidden = draw(camera, behind, layout=layout)
    assert 0.6 < hidden.visibility[0] < 0.97
    assert draw(camera, behind).visibility[0] > 0.99
    assert draw(camera, before, layout=layout).visibility[0] > 0.99


def test_a_pole_behind_a_long_vehicle_does_not_hide_it() -> None:
    camera = camera_at(-12, -9, 4.0, (0, 0, 1.0))
    bus = VehicleModel("city", 12.0, 2.5, 3.0, (200, 80, 40), (200, 200, 200))
    box = np.array([0, 0, 1.5, 12, 2.5, 3.0, 0.0])
    pole = Pole(-4.0, 1.6, 6.0, 0.2, (90.0, 90.0, 90.0))  # beyond the bus, but nearer than the bus's centre
    assert draw(camera, (bus, box), layout=empty_layout(pole)).visibility[0] > 0.99


def test_truncated_vehicles_count_what_is_outside_the_image() -> None:
    camera = camera_at(10, 0, 1.6, (0, 0, 1.0))
    model, box = car(0, 0, np.pi / 2, 5)
    uv, _ = camera.project(box[:3])
    shifted = Camera(intrinsics(0.7, SIZE, (-0.5, 0.0)), np.zeros(0), camera.T_world_cam, *SIZE)
    drawing = draw(shifted, (model, box))
    assert uv[0] == pytest.approx(SIZE[0] / 2, abs=1)
    assert drawing.amodal_boxes[0, 0] == -0.5
    assert drawing.visibility[0] == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("offset", [0.0, 1.0, 2.5])
def test_vehicles_across_the_near_plane_are_clipped(offset: float) -> None:
    pose = look(np.array([0.0, 0.0, 1.4]), 0.0, 0.0)
    camera = Camera(intrinsics(0.7, SIZE), np.zeros(0), pose, *SIZE)
    model, box = car(1.0, 1.4 + offset, 0.1, 6)
    drawing = draw(camera, (model, box))
    assert np.isfinite(drawing.amodal_boxes).all()
    assert 0 <= drawing.visibility[0] < 0.95
    behind = draw(camera, car(-8.0, 0.0, 0.1, 6))
    assert not behind.in_view[0]
    assert behind.visibility[0] == 0
    assert (behind.visible_boxes == 0).all()


def test_lamps_show_the_state_of_their_phase() -> None:
    layout = empty_layout()
    head = layout.signals[0]
    away = np.array([np.cos(head.facing_rad), np.sin(head.facing_rad), 0.0])
    place = np.array([head.x_m, head.y_m, head.z_m])
    camera = camera_at(*(place + 9 * away), tuple(place))
    renderer = Renderer(layout, LIGHT, camera)
    lamps = np.rint(camera.project(head.lamp_centres())[0]).astype(int)
    assert renderer.background.sees(head)
    for number, state in enumerate(("red", "amber", "green")):
        image = renderer.draw([], np.zeros((0, 7)), {head.phase: state}).image
        brightness = [int(image[v, u].max()) for u, v in lamps]
        assert int(np.argmax(brightness)) == number
        b, g, r = image[lamps[number][1], lamps[number][0]].astype(int)
        assert {"red": r > g + 60, "amber": r > b + 60 and g > b + 40, "green": g > r + 40}[state]


def test_too_many_vehicles_are_refused() -> None:
    model, box = car(0, 0)
    with pytest.raises(ValueError, match="254"):
        Renderer(empty_layout(), LIGHT, camera_at(9, 0, 3, (0, 0, 0))).draw([model] * 255, np.tile(box, (255, 1)), OFF)


def test_noise_has_the_asked_strength_and_keeps_the_mean() -> None:
    grey = np.full((200, 300, 3), 120, np.uint8)
    noisy = develop(grey, Photometry(noise_sd=4.5, blur_px=0.0), np.random.default_rng(1))
    assert noisy.std() == pytest.approx(4.5, rel=0.1)
    assert noisy.mean() == pytest.approx(120, abs=0.3)
    assert cv2.absdiff(grey, develop(grey, Photometry(noise_sd=0, blur_px=0), np.random.default_rng(1))).max() == 0
