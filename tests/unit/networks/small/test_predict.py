"""From frames of any size to vehicles in the world, one answer per frame, in order."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from tests.builders import look_at
from wibam_core.evaluation.matching import match_on_ground
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.models.frames import Frame, prepare_camera, prepare_image, to_input
from wibam_core.models.peaks import find_peaks, standing_apart
from wibam_core.models.second_look import Edges, SecondLook
from wibam_core.models.trunk import TrunkShape
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import load_network
from wibam_core.networks.small.architecture import SmallNetwork, SmallOutputs
from wibam_core.networks.small.decode import boxes2d_px, boxes3d, gather_around, standard_deviations
from wibam_core.networks.small.network import SmallMonocular
from wibam_core.networks.small.predict import kept_peaks
from wibam_core.networks.small.reconcile import reconciled
from wibam_core.placing import Decode
from wibam_core.road_users import BODIES, RoadUserClass
from wibam_core.scene import Vehicles3D
from wibam_core.synthetic.sampling import sample_views

TINY = TrunkShape(channels=(8, 8, 8, 8, 8), blocks=(0, 0, 0, 0), neck=8)


@pytest.fixture(scope="module")
def network() -> SmallNetwork:
    torch.set_num_threads(1)
    torch.manual_seed(3)
    made = SmallNetwork(TINY)
    torch.nn.init.normal_(made.heads["heat"].get_parameter("weight"), std=0.5)
    return made.eval()


def bundled_network() -> SmallNetwork:
    """It tells apart the first classes of the catalogue, in its order."""
    network = load_network(bundled("mono_small.safetensors")).module
    assert isinstance(network, SmallNetwork)
    return network


def predict(
    network: SmallNetwork, frames: Iterable[Frame], *, decode: Decode, min_score: float, batch_size: int = 8
) -> Iterator[Vehicles3D]:
    placed = predict_each(network, frames, decodes=(decode,), min_score=min_score, batch_size=batch_size)
    return (found for (found,) in placed)


def predict_each(network: SmallNetwork, frames: Iterable[Frame], **options: Any) -> Iterator[tuple[Vehicles3D, ...]]:
    return SmallMonocular(network).predict_each(frames, **options)


def frame(width: int, height: int, number: int, camera_size: tuple[int, int] | None = None) -> Frame:
    rng = np.random.default_rng(number)
    camera_width, camera_height = camera_size or (width, height)
    camera = look_at((20, 0, 7), focal_px=0.8 * camera_width, width_px=camera_width, height_px=camera_height)
    return Frame(rng.integers(0, 256, (height, width, 3), dtype=np.uint8), camera, f"cam{number % 2}", number)


def test_every_frame_gets_one_answer_in_order_whatever_the_batches(network: SmallNetwork) -> None:
    sizes = [(640, 360), (640, 360), (512, 384), (960, 540), (300, 500)]
    frames = [frame(*size, number) for number, size in enumerate(sizes)]
    batched = list(predict(network, iter(frames), decode="plane", min_score=0.05, batch_size=2))
    single = list(predict(network, frames, decode="plane", min_score=0.05, batch_size=1))
    assert [v.time_ns for v in batched] == [0, 1, 2, 3, 4]
    assert [v.camera_id for v in batched] == ["cam0", "cam1", "cam0", "cam1", "cam0"]
    assert sum(map(len, batched)) > 0
    for one, two in zip(batched, single, strict=True):
        np.testing.assert_allclose(one.boxes, two.boxes, atol=1e-3)
        np.testing.assert_allclose(one.scores, two.scores, atol=1e-5)
        assert np.isfinite(one.sd).all()
        assert (np.diff(one.scores) <= 0).all()


def test_fitted_boxes_agree_with_the_cells_about_their_peaks() -> None:
    network = bundled_network()
    view = next(sample_views(990_000, "site", 1, (640, 384)))
    one = Frame(view.image, view.camera, "cam", 0)
    cameras = CameraTensors.from_cameras([prepare_camera(one.camera)], torch.float64)
    (found,) = predict(network, [one], decode="fitted", min_score=0.2)
    with torch.inference_mode():
        outputs = network(to_input(prepare_image(one.image)[None]))
        peaks = find_peaks(outputs.heat, 0.2)
    kept = torch.from_numpy(np.isin(peaks.scores.double().numpy(), found.scores))
    values = gather_around(outputs, peaks.image, peaks.cells, peaks.classes)[kept]
    start = boxes3d(values, cameras, network.mean_sizes_m, "ground")
    bodies = torch.tensor(BODIES)[values.classes]
    sd = standard_deviations(values, start, cameras, "ground")
    boxes, sd = reconciled(values, start, sd, cameras, bodies)
    np.testing.assert_allclose(found.boxes, boxes.numpy(), atol=1e-6)
    np.testing.assert_allclose(found.sd, sd.numpy(), rtol=1e-6)
    assert int((boxes != start).any(dim=1).sum()) > 2


def test_refined_boxes_agree_with_a_second_look_at_the_images_own_pixels() -> None:
    """Two images of different sizes, as a camera may have them, in one batch and one by one."""
    network = bundled_network()
    views = list(sample_views(990_000, "site", 2, (1280, 768)))
    small = cv2.resize(views[1].image, (960, 576), interpolation=cv2.INTER_AREA)
    frames = [
        Frame(np.asarray(image, np.uint8), view.camera, "cam", number)
        for number, (view, image) in enumerate(zip(views, (views[0].image, small), strict=True))
    ]
    found = list(predict(network, frames, decode="refined", min_score=0.2))
    look = SecondLook()
    for one, answer in zip(frames, found, strict=True):
        camera = prepare_camera(one.camera)
        cameras = CameraTensors.from_cameras([camera], torch.float64)
        with torch.inference_mode():
            outputs = network(to_input(prepare_image(one.image)[None]))
            peaks = find_peaks(outputs.heat, 0.2)
        kept = torch.from_numpy(np.isin(peaks.scores.double().numpy(), answer.scores))
        values = gather_around(outputs, peaks.image, peaks.cells, peaks.classes)[kept]
        scale = one.image.shape[1] / 640
        seen = look.edges(one.image, ((boxes2d_px(values) + 0.5) * scale - 0.5).numpy())
        edges = Edges((seen.px + 0.5) / scale - 0.5, seen.sd_px / scale)
        start = boxes3d(values, cameras, network.mean_sizes_m, "ground")
        sd = standard_deviations(values, start, cameras, "ground")
        boxes, sd = reconciled(values, start, sd, cameras, torch.tensor(BODIES)[values.classes], edges)
        assert len(answer) > 4
        np.testing.assert_allclose(answer.boxes, boxes.numpy(), atol=1e-3)
        np.testing.assert_allclose(answer.sd, sd.numpy(), rtol=1e-3)


def test_several_ways_to_place_boxes_take_one_run_of_the_network() -> None:
    network = bundled_network()
    views = list(sample_views(990_000, "site", 3, (640, 384)))
    frames = [Frame(view.image, view.camera, "cam", number) for number, view in enumerate(views)]
    decodes: tuple[Decode, ...] = ("refined", "plane", "depth", "fitted")
    runs: list[int] = []
    hook = network.register_forward_hook(lambda _network, images, _outputs: runs.append(len(images[0])))
    each = list(predict_each(network, frames, decodes=decodes, min_score=0.2, batch_size=2))
    hook.remove()
    assert runs == [2, 1]
    assert len(each) == 3
    for decode, found in zip(decodes, zip(*each, strict=True), strict=True):
        alone = list(predict(network, frames, decode=decode, min_score=0.2, batch_size=2))
        assert sum(map(len, alone)) > 6
        for ours, wanted in zip(found, alone, strict=True):
            assert ours.time_ns == wanted.time_ns
            for name in ("boxes", "sd", "scores", "classes"):
                np.testing.assert_array_equal(getattr(ours, name), getattr(wanted, name))


def test_a_second_look_places_vehicles_better() -> None:
    """Without a hand-made case: the bundled network on simulated views of an elevated camera."""
    network = bundled_network()
    views = list(sample_views(310_500, "site", 6, (1280, 720)))
    frames = [Frame(view.image, view.camera, "cam", number) for number, view in enumerate(views)]

    def error_m(decode: Decode) -> float:
        errors = []
        for view, found in zip(views, predict(network, frames, decode=decode, min_score=0.3), strict=True):
            truth = view.vehicles.boxes[view.visibility > 0.3]
            match = match_on_ground(truth, np.ones(len(truth), bool), found.boxes, 3.0)
            gap = truth[match.labels, :2] - found.boxes[match.detections, :2]
            errors.extend(np.linalg.norm(gap, axis=1).tolist())
        assert len(errors) > 20
        return float(np.median(errors))

    assert error_m("refined") < 0.8 * error_m("fitted")


def test_duplicates_do_not_hide_the_vehicle_that_they_repeat() -> None:
    boxes2d = torch.tensor([(100.0, 100.0, 200.0, 200.0), (100.0, 101.0, 200.0, 201.5), (0.0, 0.0, 9.0, 9.0)])
    boxes = torch.ones(3, 7).double()
    boxes[2, 0] = torch.nan
    assert kept_peaks(torch.tensor([0, 0, 0]), boxes, boxes2d).tolist() == [0]
    assert kept_peaks(torch.tensor([1, 0, 1]), boxes, boxes2d).tolist() == [1, 0]


def test_of_two_that_stand_on_one_place_the_weaker_is_left_out() -> None:
    def car(x: float, y: float) -> list[float]:
        return [x, y, 0.75, 4.5, 1.8, 1.5, 0.0]

    # a pick-up, its rear half beside it, the car that stands 0.4 m behind, one in the next lane, somebody beside it
    boxes = np.array(
        [car(0.0, 0.0), car(-2.0, 0.1), car(-4.9, 0.0), car(0.0, 2.2), [0.0, 1.3, 0.9, 0.8, 0.7, 1.7, 0.0]]
    )
    classes = np.array([RoadUserClass.CAR.number] * 4 + [RoadUserClass.PEDESTRIAN.number])
    assert standing_apart(boxes, classes).tolist() == [0, 2, 3, 4]
    assert standing_apart(boxes[[1, 0]], classes[:2]).tolist() == [0]
    assert standing_apart(boxes[:0], classes[:0]).tolist() == []


def test_the_camera_may_have_another_size_than_the_image(network: SmallNetwork) -> None:
    one = next(predict(network, [frame(640, 360, 1)], decode="plane", min_score=0.05))
    two = next(predict(network, [frame(640, 360, 1, (1920, 1080))], decode="plane", min_score=0.05))
    np.testing.assert_allclose(one.boxes, two.boxes, atol=0.02)


@pytest.mark.parametrize(
    ("head", "number"), [("centre3d", np.nan), ("centre3d", np.inf), ("depth", np.nan), ("yaw", np.nan)]
)
def test_boxes_that_are_not_finite_are_left_out(network: SmallNetwork, head: str, number: float) -> None:
    frames = [frame(640, 360, 0), frame(640, 360, 1)]
    whole = list(predict(network, frames, decode="depth", min_score=0.05))

    def break_left_half(_: object, __: object, outputs: SmallOutputs) -> SmallOutputs:
        values = getattr(outputs, head).clone()
        values[..., : values.shape[-1] // 2] = number
        return replace(outputs, **{head: values})

    hook = network.register_forward_hook(break_left_half)
    try:
        broken = list(predict(network, frames, decode="depth", min_score=0.05))
    finally:
        hook.remove()
    assert [v.time_ns for v in broken] == [0, 1]
    for before, after in zip(whole, broken, strict=True):
        assert 0 < len(after) < len(before)
        assert np.isin(after.scores, before.scores).all()
        assert np.isfinite(after.boxes).all()


def test_no_frames_no_answers(network: SmallNetwork) -> None:
    assert list(predict(network, [], decode="depth", min_score=0.1)) == []


def test_a_bar_that_nothing_reaches_gives_empty_answers(network: SmallNetwork) -> None:
    (answer,) = predict(network, [frame(640, 360, 0)], decode="depth", min_score=1.0)
    assert len(answer) == 0


def test_images_are_scaled_to_the_width_and_padded_below() -> None:
    image = np.full((1080, 1920, 3), 200, np.uint8)
    prepared = prepare_image(image)
    assert prepared.shape == (384, 640, 3)
    tall = prepare_image(np.full((300, 400, 3), 200, np.uint8))
    assert tall.shape == (480, 640, 3)
    odd = prepare_image(np.full((301, 640, 3), 200, np.uint8))
    assert odd.shape == (320, 640, 3)
    assert (odd[:301] == 200).all()
    assert (odd[301:] == 0).all()
    assert prepare_image(image, 960).shape == (544, 960, 3)


@pytest.mark.parametrize("input_width_px", [640, 960])
def test_the_prepared_camera_sees_where_the_prepared_image_shows(input_width_px: int) -> None:
    camera = look_at((20, 0, 7), focal_px=1500.0, width_px=1920, height_px=1080)
    point = np.array([2.0, 1.0, 0.0])
    uv, _ = camera.project(point)
    scaled, _ = prepare_camera(camera, input_width_px).project(point)
    np.testing.assert_allclose(scaled, (uv + 0.5) * input_width_px / 1920 - 0.5)


def test_frames_refuse_other_images() -> None:
    good = frame(64, 36, 0)
    with pytest.raises(ValueError, match="uint8"):
        Frame(good.image.astype(float), good.camera, "a", 0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="uint8"):
        Frame(good.image[..., 0], good.camera, "a", 0)
