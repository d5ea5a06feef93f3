"""Fine-tuning of DLA-34: it learns by every method, says what inference says, and resumes to the bit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.builders import look_at
from tests.site_dataset import TinySite, tiny_site
from wibam_core.config import FinetuneConfig
from wibam_core.errors import NonFiniteLoss
from wibam_core.geometry.box3d import corners
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.models.frames import Frame
from wibam_core.models.network import predict
from wibam_core.networks.dla34.architecture import DLA34, HEADS
from wibam_core.networks.dla34.centertrack import InputWarp, boxes3d, decode_vehicles, read_heads
from wibam_core.networks.dla34.classes import RoadUserChannels
from wibam_core.networks.dla34.losses import heat_part, lifted_parts
from wibam_core.networks.dla34.network import CenterTrack, input_view, stacked
from wibam_core.networks.dla34.targets import encode
from wibam_core.networks.registry import load_network, save_network
from wibam_core.progress import silent
from wibam_core.road_users import RoadUserClass
from wibam_core.training.dataset import SiteView, site_views
from wibam_core.training.finetune import FinetuneResult, SiteDataset, finetune
from wibam_core.training.multiview import OtherCameras
from wibam_core.training.views import LabelledView
from wibam_core.traits import NUSCENES_CLASSES


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> TinySite:
    return tiny_site(tmp_path_factory.mktemp("site"))


@pytest.fixture(autouse=True)
def _small_input_and_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CenterTrack, "long_side_px", 128)
    torch.set_num_threads(1)


CLASSES = RoadUserChannels.of(NUSCENES_CLASSES)


def views_of(site: TinySite) -> list[SiteView]:
    return site_views(site.instants, site.frames, site.lifts, site.rig)


def network() -> DLA34:
    """Random weights that say something possible: vehicles of a car's size, 20 m away from the small input's camera."""
    torch.manual_seed(0)
    made = DLA34()
    with torch.no_grad():
        for head, values in {"dim": [1.6, 1.9, 4.5], "dep": [-5.0], "wh": [6.0, 4.0], "hm": [-2.0] * 10}.items():
            made.get_submodule(head)[2].bias.copy_(torch.tensor(values))
    return made


def options(**values: object) -> FinetuneConfig:
    return FinetuneConfig.model_validate(
        {"network": "custom", "steps": 2, "steps_per_epoch": 1, "batch_size": 2, "crop_share": 0.4} | values
    )


def train(site: TinySite, scratch: Path, config: FinetuneConfig, start: DLA34 | None = None) -> FinetuneResult:
    views = views_of(site)
    dataset = SiteDataset(site.frames, site.rig, views[:2], views[9:10])
    return finetune(CenterTrack(start or network()), dataset, config, silent, scratch)


# --- learning -----------------------------------------------------------------------------------
@pytest.mark.parametrize(("method", "decode"), [("lifted", "plane"), ("paper", "depth"), ("combined", "plane")])
def test_the_loss_falls(site: TinySite, tmp_path: Path, method: str, decode: str) -> None:
    config = options(method=method, decode=decode, steps=16, steps_per_epoch=4, learning_rate=1e-3)
    totals = [epoch.train["total"] for epoch in train(site, tmp_path, config).epochs]
    assert min(totals[1:]) < 0.95 * totals[0]  # the first steps from random weights may raise it, as rounding has it


@pytest.mark.parametrize(
    ("method", "silent_heads"),
    [("lifted", set()), ("combined", set()), ("paper", {"wh"})],
)
def test_gradients_reach_the_heads(site: TinySite, method: str, silent_heads: set[str]) -> None:
    """Under the published loss boxes are placed by all heads but the 2D box's size."""
    trained = network()
    trainable = CenterTrack(trained)
    sources = views_of(site)[:2]
    read = trainable.reader(Path("unused"), sources, site.frames)
    views = [read(0), read(1)]
    others = OtherCameras(site.rig).of(sources, [False, False])
    config = options(method=method, decode="depth")
    trainable.losses(trainable.maps(views, slice(None)), views, others, config)["total"].backward()
    reached = {
        name
        for name in HEADS
        if (gradient := trained.get_submodule(name)[2].weight.grad) is not None and bool((gradient != 0).any())
    }
    assert reached == set(HEADS) - silent_heads
    assert trained.base.base_layer[0].weight.grad is not None


def test_box_heads_of_the_published_code_are_an_option(site: TinySite, tmp_path: Path) -> None:
    assert {"reg", "wh"} <= train(site, tmp_path, options(method="paper", box_heads=True, steps=1)).epochs[
        0
    ].train.keys()


def test_resumes_equal_to_the_bit(site: TinySite, tmp_path: Path) -> None:
    views = views_of(site)
    dataset = SiteDataset(site.frames, site.rig, views[:4], views[9:10])
    whole = finetune(CenterTrack(network()), dataset, options(), silent, tmp_path / "whole")

    def stop_in_the_second_epoch(fraction: float, message: str = "", **figures: float) -> None:
        if fraction == 1.0:
            raise InterruptedError("stop")

    with pytest.raises(InterruptedError):
        finetune(CenterTrack(network()), dataset, options(), stop_in_the_second_epoch, tmp_path / "cut")
    resumed = finetune(CenterTrack(network()), dataset, options(), silent, tmp_path / "cut")
    for name, value in whole.network.module.state_dict().items():
        assert torch.equal(value, resumed.network.module.state_dict()[name]), name
    assert whole.epochs == resumed.epochs


def test_a_loss_that_is_not_finite_is_an_error(site: TinySite, tmp_path: Path) -> None:
    poisoned = network()
    poisoned.get_submodule("dep")[2].bias.data.fill_(float("nan"))
    with pytest.raises(NonFiniteLoss):
        train(site, tmp_path, options(decode="depth"), poisoned)


# --- what is saved ------------------------------------------------------------------------------
def test_what_was_trained_and_saved_finds_the_same_boxes(site: TinySite, tmp_path: Path) -> None:
    trained = train(site, tmp_path, options(steps=1)).network
    # as loaded: another order of summation gives other last digits
    trained.module.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    save_network(trained, tmp_path / "weights.safetensors")
    frame = Frame(site.frames.image("north", 0), site.rig["north"], "north", 0)
    before, after = (
        next(predict(one, [frame], decode="depth", min_score=0.01))
        for one in (trained, load_network(tmp_path / "weights.safetensors"))
    )
    assert len(before) > 0
    np.testing.assert_array_equal(before.boxes, after.boxes)


# --- encoding -----------------------------------------------------------------------------------
CAMERAS = [
    look_at((20.0, 5.0, 8.0), focal_px=500.0, width_px=960, height_px=540),
    look_at((-15.0, -9.0, 7.0), focal_px=380.0, dist=(-0.2, 0.05, 0.001, -0.002, 0.0)),
    look_at((5.0, -18.0, 9.0), focal_px=900.0, width_px=540, height_px=960),
]
BOXES = np.array([[1.2, -1.7, 0.85, 4.6, 1.9, 1.7, 0.4], [-2.0, 3.0, 1.0, 5.0, 2.0, 2.0, -2.8]])


def labelled(number: int) -> tuple[LabelledView, InputWarp]:
    """`BOXES` exactly as the input of camera ``number`` shows them."""
    camera = CAMERAS[number]
    warp = InputWarp.of(camera.width_px, camera.height_px)
    seen_by = warp.camera(camera)
    uv, _ = seen_by.project(corners(BOXES))
    boxes2d = np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)
    image = np.zeros((warp.input_px[1], warp.input_px[0], 3), np.uint8)
    known = np.array([True, True])
    return LabelledView(image, seen_by, boxes2d, np.array([0, 2]), BOXES, np.ones(2), known, np.zeros((0, 4))), warp


def heads_of(number: int) -> tuple[dict[str, torch.Tensor], InputWarp]:
    """The maps of a perfect network, made of the targets."""
    view, warp = labelled(number)
    width, height = (side // 4 for side in warp.input_px)
    targets = encode([view], height, width, CLASSES)
    heads = {name: torch.zeros(1, channels, height, width, dtype=torch.float64) for name, channels in HEADS.items()}
    heads["hm"] -= 9.0
    scale = np.sqrt(view.camera.K[0, 0] * view.camera.K[1, 1]) / 633.0
    for row, (x, y) in enumerate(targets.cells.tolist()):
        share = 1 / (1 + float(targets.depth_m[row]) / scale) - 1e-6
        alpha = float(targets.alpha_rad[row])
        first = np.sin(alpha) < 0
        angle = alpha + np.pi / 2 if first else alpha - np.pi / 2
        says = [-9.0, 9.0, np.sin(angle), np.cos(angle)]
        wrong = [9.0, -9.0, 0.0, 1.0]
        heads["hm"][0, (0, 1)[row], y, x] = 3.0 - row
        for name, values in {
            "reg": targets.centre2d[row] - targets.cells[row],
            "wh": targets.wh[row],
            "amodel_offset": targets.centre3d[row] - targets.centre2d[row],
            "dep": np.log(share / (1 - share)),
            "dim": targets.boxes3d[row, [5, 4, 3]],
            "rot": [*says, *wrong] if first else [*wrong, *says],
        }.items():
            heads[name][0, :, y, x] = torch.as_tensor(values, dtype=torch.float64)
    return heads, warp


@pytest.mark.parametrize("decode", ["plane", "depth"])
@pytest.mark.parametrize("number", range(3))
def test_inference_decodes_what_is_taught_and_the_loss_is_then_small(number: int, decode: str) -> None:
    heads, warp = heads_of(number)
    found = decode_vehicles(heads, warp, CAMERAS[number], CLASSES, min_score=0.3, decode=decode)
    np.testing.assert_allclose(found.boxes, BOXES, atol=1e-6)
    view, _ = labelled(number)
    targets = encode([view], *heads["hm"].shape[2:], CLASSES)
    parts = lifted_parts(read_heads(heads, targets.image, targets.cells), targets, decode)
    for name in ("amodel_offset", "dep", "dim", "corners"):
        assert float(parts[name]) == pytest.approx(0, abs=1e-6), name


@pytest.mark.parametrize("decode", ["plane", "depth"])
@pytest.mark.parametrize("number", range(3))
def test_boxes_in_the_loss_are_those_of_inference(number: int, decode: str) -> None:
    torch.manual_seed(number)
    heads, warp = heads_of(number)
    heads = {name: values + 0.1 * torch.randn_like(values) * (name != "hm") for name, values in heads.items()}
    inferred = decode_vehicles(heads, warp, CAMERAS[number], CLASSES, min_score=0.3, decode=decode)
    view, _ = labelled(number)
    targets = encode([view], *heads["hm"].shape[2:], CLASSES)
    cameras = CameraTensors.from_cameras([warp.camera(CAMERAS[number])], torch.float64)
    lossy = boxes3d(read_heads(heads, targets.image, targets.cells), cameras, decode)
    np.testing.assert_allclose(lossy.numpy(), inferred.boxes, atol=1e-9)


def test_unknown_fronts_may_be_either_and_vehicles_without_a_label_teach_no_3d() -> None:
    heads, _ = heads_of(0)
    view, _ = labelled(0)

    def rot(**changes: object) -> float:
        targets = encode([replace(view, **changes)], *heads["hm"].shape[2:], CLASSES)
        return float(lifted_parts(read_heads(heads, targets.image, targets.cells), targets, "plane")["rot"])

    turned = BOXES + [0, 0, 0, 0, 0, 0, np.pi]
    right = rot()
    assert rot(boxes3d=turned) > right + 1
    assert rot(boxes3d=turned, front_known=np.zeros(2, bool)) == pytest.approx(right, abs=1e-6)
    assert rot(boxes3d=np.full((2, 7), np.nan)) == 0
    assert rot(boxes3d=turned, confidence=np.zeros(2)) == 0


def test_peaks_are_one_at_the_centre_and_ignored_regions_are_not_judged() -> None:
    view, warp = labelled(0)
    width, height = (side // 4 for side in warp.input_px)
    ignored = np.array([[0.0, 0.0, 80.0, 40.0]])
    targets = encode([replace(view, ignored=ignored)], height, width, CLASSES)
    assert targets.judged[0, 0, :10, :20].sum() == 0
    assert targets.judged.sum() == height * width - 200
    (x, y), _ = targets.cells.tolist()
    assert targets.heat[0, 0, y, x] == 1.0
    assert (targets.heat == 1.0).sum() == 2
    assert 0 < targets.heat[0, 0, y, x + 1] < 1
    assert targets.heat[0, 1].max() == 1.0  # the van of our classes is a truck's row away: classes 0 and 2


def test_the_input_is_that_of_inference_and_labels_follow_it(site: TinySite) -> None:
    source = next(view for view in views_of(site) if view.camera_id == "east")
    view = input_view(source, site.frames, 800)
    warp = InputWarp.of(640, 160)
    np.testing.assert_array_equal(view.image, warp.image(site.frames.image("east", source.time_ns)))
    uv, _ = view.camera.project(corners(source.pseudo_labels.boxes3d))
    tight = np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)
    np.testing.assert_allclose(view.boxes2d, tight, atol=0.5)


def test_images_of_several_sizes_are_padded_to_one() -> None:
    batch = stacked([np.full((32, 64, 3), 7, np.uint8), np.full((64, 32, 3), 9, np.uint8)])
    assert batch.shape == (2, 64, 64, 3)
    assert batch[0].sum() == 7 * 32 * 64 * 3
    assert batch[1].sum() == 9 * 32 * 64 * 3


def test_heat_of_road_users_that_nobody_looked_for_is_not_judged() -> None:
    """A detector of vehicles says nothing of pedestrians: a network that knows them must not learn to see none."""
    view, warp = labelled(0)
    width, height = (side // 4 for side in warp.input_px)
    heads = {"hm": torch.randn(1, 10, height, width, generator=torch.Generator().manual_seed(0), requires_grad=True)}
    blind = replace(view, not_looked_for=frozenset({RoadUserClass.PEDESTRIAN}))
    heat_part(heads, encode([blind], height, width, CLASSES), CLASSES.channels).backward()
    learned = heads["hm"].grad[0].abs().amax(dim=(1, 2)) > 0
    names = {name for name, moved in zip(NUSCENES_CLASSES, learned.tolist(), strict=True) if moved}
    assert names == {"car", "truck", "bus", "motorcycle", "bicycle", "construction_vehicle"}
