"""The ways to learn from multi-view boxes: what each option adds, which heads it teaches, and what it survives."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from tests.site_dataset import TinySite, tiny_rig, tiny_site
from tests.unit.training.test_multiview import loop_loss
from wibam_core.config import FinetuneConfig, PipelineConfig
from wibam_core.errors import InvalidOption
from wibam_core.models.frames import prepare_camera
from wibam_core.networks.small.architecture import MEAN_SIZES_M, SmallOutputs
from wibam_core.networks.small.decode import boxes3d, gather
from wibam_core.networks.small.losses import LossWeights, lifted_loss
from wibam_core.networks.small.objectives import CombinedObjective, LiftedObjective, PaperObjective, objective_of
from wibam_core.networks.small.onnx_network import DECODES
from wibam_core.networks.small.targets import Targets, encode
from wibam_core.training.augment import mirror, mirror_camera
from wibam_core.training.dataset import ImageCache, SiteView, site_views
from wibam_core.training.multiview import DEFAULT_MULTIVIEW_WEIGHT, OtherCameras, OtherViews, multiview_loss
from wibam_core.training.views import LabelledView

SIZES = torch.tensor(MEAN_SIZES_M)
OBJECTIVES = [
    LiftedObjective("plane"),
    PaperObjective("plane"),
    PaperObjective("depth", box_heads=True),
    CombinedObjective("plane", 0.1),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> TinySite:
    return tiny_site(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def views(site: TinySite) -> list[SiteView]:
    return site_views(site.instants, site.frames, site.lifts, site.rig)


@pytest.fixture(scope="module")
def labelled(site: TinySite, views: list[SiteView], tmp_path_factory: pytest.TempPathFactory) -> list[LabelledView]:
    cache = ImageCache(tmp_path_factory.mktemp("cache") / "images.npy", views, site.frames)
    return [cache.view(number) for number in range(len(views))]


def random_outputs(targets: Targets, seed: int = 0) -> SmallOutputs:
    """Maps near those of an untrained network, all with gradients."""
    generator = torch.Generator().manual_seed(seed)
    batch, _, height, width = targets.heat.shape
    channels = {"heat": 4, "box2d": 4, "centre3d": 2, "depth": 1, "size": 3, "yaw": 2, "footprint": 2, "log_scale": 5}
    shift = {"heat": -3.0, "depth": 3.0}
    return SmallOutputs(
        **{
            name: (0.3 * torch.randn(batch, count, height, width, generator=generator) + shift.get(name, 0.0))
            .requires_grad_()
            for name, count in channels.items()
        }
    )  # fmt: skip


def taught_heads(outputs: SmallOutputs) -> set[str]:
    """The heads that a backward pass has reached."""
    grads = {field.name: getattr(outputs, field.name).grad for field in fields(outputs)}
    return {name for name, grad in grads.items() if grad is not None and bool((grad != 0).any())}


def as_pairs(views: OtherViews) -> set[tuple[int, int, tuple[float, ...]]]:
    listed = zip(views.vehicle.tolist(), views.camera.tolist(), views.boxes.tolist(), strict=True)
    return {(vehicle, camera, tuple(box)) for vehicle, camera, box in listed}


# --- the own view -------------------------------------------------------------------------------
def test_all_ways_to_place_boxes_by_their_footprints_are_trained_alike(labelled: list[LabelledView]) -> None:
    targets = encode(labelled[:4])
    outputs = random_outputs(targets)
    loss = {decode: LiftedObjective(decode)(outputs, targets, SIZES, None) for decode in DECODES}
    alike = {decode for decode, parts in loss.items() if all(torch.equal(parts[k], loss["refined"][k]) for k in parts)}
    assert alike == {"ground", "fitted", "refined"}


def test_own_view_adds_the_own_views_pairs_and_no_others(site: TinySite, views: list[SiteView]) -> None:
    chosen = views[:3]
    without = as_pairs(OtherCameras(site.rig).of(chosen, [False] * 3))
    withal = as_pairs(OtherCameras(site.rig, own_view=True).of(chosen, [False] * 3))
    assert without < withal
    own = {
        (2 * place + row, list(site.rig).index(view.camera_id), tuple(box))
        for place, view in enumerate(chosen)
        for row, box in enumerate(view.pseudo_labels.boxes2d.tolist())
    }
    assert withal - without == own


def test_vehicles_that_no_other_view_sees_do_not_count_with_their_own(site: TinySite, views: list[SiteView]) -> None:
    first = views[0]
    seen = first.other_vehicle == 1
    partly = replace(
        first,
        other_vehicle=first.other_vehicle[seen],
        other_camera=first.other_camera[seen],
        other_boxes=first.other_boxes[seen],
    )
    pairs = OtherCameras(site.rig, own_view=True).of([partly, first.alone(first.pseudo_labels)], [False, False])
    assert set(pairs.vehicle.tolist()) == {1}


@pytest.mark.parametrize("own_view", [False, True])
def test_equals_a_loop_over_the_vehicles_of_a_batch(
    site: TinySite, views: list[SiteView], labelled: list[LabelledView], own_view: bool
) -> None:
    """From the heads' maps to the loss, mirrored views among them."""
    mirrored = [False, True, True, False]
    batch = [mirror(view) if turn else view for view, turn in zip(labelled, mirrored, strict=False)]
    targets = encode(batch)
    outputs = random_outputs(targets)
    others = OtherCameras(site.rig, own_view).of(views[:4], mirrored)
    loss = PaperObjective("plane")(outputs, targets, SIZES, others)["multiview"]

    centre = targets.centre.nonzero()[:, 0]
    values = gather(outputs, targets.image[centre], targets.cells[centre], targets.classes[centre])
    boxes = boxes3d(values, targets.cameras, SIZES, "plane").detach().numpy()
    pairs = []
    for place, view in enumerate(views[:4]):
        seen = zip(view.other_vehicle.tolist(), view.other_camera.tolist(), view.other_boxes, strict=True)
        listed = [(row, list(site.rig.values())[camera], box) for row, camera, box in seen]
        if own_view:
            listed += [(row, site.rig[view.camera_id], box) for row, box in enumerate(view.pseudo_labels.boxes2d)]
        for row, camera, box in listed:
            prepared = prepare_camera(camera)
            if mirrored[place]:
                width = prepared.width_px
                prepared = mirror_camera(prepared)
                box = np.array([width - 1 - box[2], box[1], width - 1 - box[0], box[3]])
            pairs.append((2 * place + row, prepared, box))
    assert targets.vehicle[centre].tolist() == list(range(8))
    assert loss.item() == pytest.approx(loop_loss(boxes, pairs), abs=1e-6)


# --- which heads learn --------------------------------------------------------------------------
def test_headings_and_sizes_weigh_more_than_the_other_heads(
    site: TinySite, views: list[SiteView], labelled: list[LabelledView]
) -> None:
    targets = encode(labelled[:2])
    outputs = random_outputs(targets)
    ours = LiftedObjective("plane")(outputs, targets, SIZES, OtherCameras(site.rig).of(views[:2], [False, False]))
    alike = lifted_loss(outputs, targets, SIZES, LossWeights(), "plane")
    weighs = {name: (ours[name] / alike[name]).item() for name in ("centre3d", "depth", "footprint", "size", "yaw")}
    assert weighs == pytest.approx({"centre3d": 1, "depth": 1, "footprint": 1, "size": 3, "yaw": 4})


@pytest.mark.parametrize(
    ("options", "heads"),
    [
        ({"method": "paper"}, {"heat", "centre3d", "size", "yaw"}),
        ({"method": "paper", "decode": "depth"}, {"heat", "centre3d", "size", "yaw", "depth"}),
        ({"method": "paper", "own_view": True}, {"heat", "centre3d", "size", "yaw"}),
        ({"method": "paper", "box_heads": True}, {"heat", "centre3d", "size", "yaw", "box2d"}),
        ({"method": "lifted"}, {"heat", "box2d", "centre3d", "depth", "size", "yaw", "footprint", "log_scale"}),
        ({"method": "combined"}, {"heat", "box2d", "centre3d", "depth", "size", "yaw", "footprint", "log_scale"}),
    ],
)
def test_each_method_teaches_its_heads(
    site: TinySite, views: list[SiteView], labelled: list[LabelledView], options: dict[str, object], heads: set[str]
) -> None:
    config = FinetuneConfig.model_validate(options)
    targets = encode(labelled[:3])
    outputs = random_outputs(targets)
    others = OtherCameras(site.rig, config.own_view).of(views[:3], [False] * 3)
    objective_of(config)(outputs, targets, SIZES, others)["total"].backward()
    assert taught_heads(outputs) == heads


def test_paper_is_the_focal_and_the_multi_view_loss_and_nothing_else(
    site: TinySite, views: list[SiteView], labelled: list[LabelledView]
) -> None:
    targets = encode(labelled[:3])
    outputs = random_outputs(targets)
    others = OtherCameras(site.rig).of(views[:3], [False] * 3)
    plain = PaperObjective("plane")(outputs, targets, SIZES, others)
    assert plain.keys() == {"heat", "multiview", "total"}
    assert plain["total"].item() == pytest.approx((plain["heat"] + plain["multiview"]).item(), rel=1e-12)
    extra = PaperObjective("plane", box_heads=True)(outputs, targets, SIZES, others)
    lifted = LiftedObjective("plane")(outputs, targets, SIZES, others)
    assert extra["box2d"].item() == pytest.approx(lifted["box2d"].item(), rel=1e-12)
    assert extra["total"].item() == pytest.approx((plain["total"] + lifted["box2d"]).item(), rel=1e-12)


def test_combined_is_the_lifted_loss_and_a_share_of_the_multi_view_loss(
    site: TinySite, views: list[SiteView], labelled: list[LabelledView]
) -> None:
    targets = encode(labelled[:3])
    outputs = random_outputs(targets)
    others = OtherCameras(site.rig).of(views[:3], [False] * 3)
    lifted = LiftedObjective("plane")(outputs, targets, SIZES, others)
    paper = PaperObjective("plane")(outputs, targets, SIZES, others)
    for config, weight in (
        (FinetuneConfig(method="combined", decode="plane"), DEFAULT_MULTIVIEW_WEIGHT),
        (FinetuneConfig(method="combined", decode="plane", multiview_weight=0.5), 0.5),
    ):
        parts = objective_of(config)(outputs, targets, SIZES, others)
        assert parts.keys() == lifted.keys() | {"multiview"}
        assert parts["multiview"].item() == pytest.approx(weight * paper["multiview"].item(), rel=1e-12)
        assert parts["total"].item() == pytest.approx((lifted["total"] + parts["multiview"]).item(), rel=1e-12)


# --- what must not happen -----------------------------------------------------------------------
@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("own_view", [False, True])
def test_batches_without_vehicles_have_a_finite_loss_and_gradient(
    site: TinySite, views: list[SiteView], labelled: list[LabelledView], objective: PaperObjective, own_view: bool
) -> None:
    bare = replace(
        labelled[0],
        boxes2d=np.zeros((0, 4)),
        classes=np.zeros(0, np.int64),
        boxes3d=np.zeros((0, 7)),
        confidence=np.zeros(0),
        front_known=np.zeros(0, bool),
    )
    targets = encode([bare, bare])
    outputs = random_outputs(targets)
    others = OtherCameras(site.rig, own_view).of([views[0].alone(bare)] * 2, [False, True])
    loss = objective(outputs, targets, SIZES, others)["total"]
    loss.backward()
    assert torch.isfinite(loss)
    for name in ("heat", "centre3d", "size", "yaw", "depth"):
        grad = getattr(outputs, name).grad
        assert grad is None or bool(torch.isfinite(grad).all()), name


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("name", ["centre3d", "size", "yaw"])
def test_a_head_that_is_not_finite_makes_the_loss_so(
    site: TinySite, views: list[SiteView], labelled: list[LabelledView], objective: PaperObjective, name: str
) -> None:
    targets = encode(labelled[:3])
    outputs = random_outputs(targets)
    broken = replace(outputs, **{name: getattr(outputs, name) * torch.nan})
    others = OtherCameras(site.rig).of(views[:3], [False] * 3)
    assert not torch.isfinite(objective(broken, targets, SIZES, others)["total"])


def test_predictions_behind_and_beside_the_cameras_have_finite_gradients(
    site: TinySite, views: list[SiteView], labelled: list[LabelledView]
) -> None:
    targets = encode(labelled)
    others = OtherCameras(site.rig, own_view=True).of(views, [False] * len(views))
    for seed in range(4):
        outputs = random_outputs(targets, seed)
        leaves = {"centre3d": (40 * outputs.centre3d.detach()).requires_grad_()}
        loss = PaperObjective("plane")(replace(outputs, **leaves), targets, SIZES, others)["total"]
        loss.backward()
        assert torch.isfinite(loss)
        assert torch.isfinite(leaves["centre3d"].grad).all()


def test_a_box_that_is_not_finite_is_not_passed_over() -> None:
    nothing = torch.zeros(0, dtype=torch.int64)
    cameras = OtherCameras(tiny_rig()).of([], []).cameras
    empty = OtherViews(nothing, nothing, torch.zeros(0, 4, dtype=torch.float64), cameras)
    boxes = torch.tensor([[0.0, 0.0, 0.8, 4.0, 2.0, 1.5, torch.nan]], dtype=torch.float64)
    assert torch.isnan(multiview_loss(boxes, empty))


# --- options ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"own_view": True}, r"finetune\.own_view: it does nothing with method 'lifted', only with 'paper' and"),
        ({"box_heads": True}, r"finetune\.box_heads: it does nothing with method 'lifted', only with 'paper'"),
        ({"method": "combined", "box_heads": True}, r"finetune\.box_heads: it does nothing with method 'combined'"),
        ({"method": "paper", "decode": "fused"}, r"finetune\.decode: method 'paper' teaches no uncertainties"),
        ({"method": "paper", "decode": "ground"}, r"finetune\.decode: method 'paper' teaches no footprints"),
        ({"method": "paper", "decode": "refined"}, r"finetune\.decode: method 'paper' teaches no footprints"),
        ({"method": "paper", "decode": "fitted"}, r"finetune\.decode: method 'paper' teaches no footprints"),
        ({"input_width_px": 650}, r"finetune\.input_width_px"),
        ({"multiview_weight": 0.2}, r"finetune\.multiview_weight: it does nothing with method 'lifted'"),
        ({"method": "paper", "multiview_weight": 0.2}, r"finetune\.multiview_weight: .* only with 'combined'"),
    ],
)
def test_options_that_do_nothing_are_refused(options: dict[str, object], said: str) -> None:
    with pytest.raises(InvalidOption, match=said) as caught:
        PipelineConfig.parse({"finetune": options})
    assert caught.value.details["option"].startswith("finetune.")


def test_boxes_are_placed_by_what_the_method_teaches_unless_options_say() -> None:
    for options, decode in (
        ({}, "refined"),
        ({"method": "combined"}, "refined"),
        ({"method": "paper"}, "plane"),
        ({"network": "custom"}, "plane"),
        ({"decode": "depth"}, "depth"),
    ):
        assert PipelineConfig.parse({"finetune": options}).finetune.decode == decode


def test_options_survive_being_stored() -> None:
    for options in ({}, {"method": "paper", "own_view": True, "box_heads": True}, {"method": "combined"}):
        config = PipelineConfig.parse({"finetune": options})
        assert PipelineConfig.model_validate_json(config.model_dump_json()) == config
