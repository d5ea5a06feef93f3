"""The small network's ONNX file computes what the network does, and other files are refused."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from wibam_core.documents.model_card import ModelCard
from wibam_core.errors import InvalidWeights
from wibam_core.models.frames import INPUT_WIDTH_PX, Frame, prepare_image, to_input
from wibam_core.models.network import Network, predict
from wibam_core.models.trunk import STRIDE, TrunkShape
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import load_network, load_to_detect
from wibam_core.networks.small.architecture import MEAN_SIZES_M, REFERENCE_FOCAL_PX, SmallNetwork, SmallOutputs
from wibam_core.networks.small.export import channels, small_onnx
from wibam_core.networks.small.network import CARD, SmallMonocular
from wibam_core.networks.small.onnx_network import OnnxNetwork
from wibam_core.synthetic.sampling import sample_views

TINY = TrunkShape(channels=(8, 8, 16, 16, 16), blocks=(1, 0, 1, 0), neck=8)

pytestmark = pytest.mark.filterwarnings("error::DeprecationWarning")


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


#: Of the bundled weights' classes.
CHANNELS = channels(len(CARD.classes))


def export_small(network: SmallNetwork, path: Path, card: ModelCard = CARD) -> None:
    path.write_bytes(small_onnx(network, card))


def exported_of(network: SmallNetwork, threads: int | None = None) -> OnnxNetwork:
    return OnnxNetwork.of(small_onnx(network, CARD), threads)


def random_network() -> SmallNetwork:
    """Weights and statistics of the normalisations that leave nothing at 0 or 1; the same each time."""
    torch.manual_seed(0)
    network = SmallNetwork(TINY).eval()
    for name, values in network.state_dict().items():
        if values.is_floating_point() and name not in ("trunk.std", "mean_sizes_m"):
            values.add_(torch.randn_like(values) * 0.1)
            if name.endswith("running_var"):
                values.abs_().add_(0.5)
    return network


@pytest.fixture(scope="module")
def trained() -> SmallNetwork:
    network = load_network(bundled("mono_small.safetensors")).module
    assert isinstance(network, SmallNetwork)
    return network


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    views = sample_views(31, "site", 3, (960, 540))
    return [Frame(view.image, view.camera, "camera", number) for number, view in enumerate(views)]


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "weights.onnx"
    export_small(random_network(), path)
    return path


def assert_same_maps(network: SmallNetwork, exported: OnnxNetwork, images: torch.Tensor) -> None:
    with torch.inference_mode():
        want = network(images)
    found = exported(images)
    for name, count in CHANNELS.items():
        expected, values = getattr(want, name), getattr(found, name)
        assert values.dtype == torch.float32
        assert values.shape[1] == count
        np.testing.assert_allclose(values.numpy(), expected.numpy(), atol=1e-3, rtol=0, err_msg=name)


def test_convention_outputs_are_the_fields_of_the_networks_outputs() -> None:
    assert list(CHANNELS) == [field.name for field in fields(SmallOutputs)]


@pytest.mark.parametrize("shape", [(1, 64, 96), (3, 288, 512), (2, 32, 32), (1, 384, 512), (5, 160, 224)])
def test_maps_agree_at_any_size_and_batch(exported: Path, shape: tuple[int, int, int]) -> None:
    images = np.random.default_rng(1).integers(0, 256, (*shape, 3), dtype=np.uint8)
    assert_same_maps(random_network(), OnnxNetwork.load(exported), to_input(images))


def test_maps_of_the_bundled_weights_agree_on_rendered_views(trained: SmallNetwork, frames: list[Frame]) -> None:
    network = exported_of(trained)
    prepared = np.stack([prepare_image(frame.image) for frame in frames])
    assert_same_maps(trained, network, to_input(prepared))
    assert_same_maps(trained, network, to_input(prepared[:1]))
    assert torch.equal(network.mean_sizes_m, trained.mean_sizes_m)


@pytest.mark.parametrize("decode", ["plane", "depth"])
def test_the_same_vehicles_are_found(trained: SmallNetwork, frames: list[Frame], decode: str) -> None:
    found = predict(exported_of(trained), frames, decode=decode, min_score=0.2)  # type: ignore[arg-type]
    want = predict(SmallMonocular(trained), frames, decode=decode, min_score=0.2)  # type: ignore[arg-type]
    total = 0
    for ours, theirs in zip(found, want, strict=True):
        total += len(theirs)
        assert ours.time_ns == theirs.time_ns
        assert ours.classes.tolist() == theirs.classes.tolist()
        np.testing.assert_allclose(ours.boxes, theirs.boxes, atol=1e-3)
        np.testing.assert_allclose(ours.sd, theirs.sd, atol=1e-3)
        np.testing.assert_allclose(ours.scores, theirs.scores, atol=1e-4)
    assert total > 5


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU that torch can use")
def test_a_network_on_a_gpu_finds_the_same_and_can_be_exported(trained: SmallNetwork, frames: list[Frame]) -> None:
    network = load_network(bundled("mono_small.safetensors"))
    network.module.cuda()
    want = list(predict(SmallMonocular(trained), frames, decode="plane", min_score=0.2))
    detectors: tuple[Network, ...] = (network, network.runnable(torch.device("cuda")))
    for runnable in detectors:
        for ours, theirs in zip(predict(runnable, frames, decode="plane", min_score=0.2), want, strict=True):
            np.testing.assert_allclose(ours.boxes, theirs.boxes, atol=0.05)
    assert next(network.module.parameters()).is_cuda


def test_the_same_file_gives_the_same_boxes_each_time(
    trained: SmallNetwork, frames: list[Frame], tmp_path: Path
) -> None:
    export_small(trained, tmp_path / "weights.onnx")
    one, two = (
        list(predict(OnnxNetwork.load(tmp_path / "weights.onnx"), frames, decode="plane", min_score=0.2))
        for _ in range(2)
    )
    for first, second in zip(one, two, strict=True):
        assert np.array_equal(first.boxes, second.boxes)
        assert np.array_equal(first.scores, second.scores)


def test_more_threads_find_the_same() -> None:
    images = to_input(np.random.default_rng(2).integers(0, 256, (2, 96, 128, 3), dtype=np.uint8))
    one, two = (exported_of(random_network(), threads)(images) for threads in (1, 2))
    for name in CHANNELS:
        torch.testing.assert_close(getattr(one, name), getattr(two, name), atol=1e-5, rtol=0)


def test_the_file_says_what_one_needs_to_know(exported: Path) -> None:
    assert [file.name for file in exported.parent.iterdir()] == ["weights.onnx"]
    model = onnx.load(str(exported))
    said = {entry.key: entry.value for entry in model.metadata_props}
    assert said["family"] == "wibam-small"
    assert said["classes"] == "car,van,truck,bus"
    assert int(said["stride"]) == STRIDE
    assert int(said["input_width_px"]) == INPUT_WIDTH_PX
    assert float(said["reference_focal_px"]) == REFERENCE_FOCAL_PX
    assert json.loads(said["uncertainty_groups"]) == ["centre3d", "depth", "size", "yaw", "footprint"]
    np.testing.assert_allclose(json.loads(said["mean_sizes_m"]), MEAN_SIZES_M, rtol=1e-6)
    assert [entry.version for entry in model.opset_import] == [18]


def test_the_file_says_what_its_network_is(tmp_path: Path) -> None:
    card = CARD.model_copy(update={"decode": "fused", "sd_factors": {"position": 1.7, "yaw": 0.8}, "licence": "gratis"})
    export_small(random_network(), tmp_path / "weights.onnx", card)
    assert OnnxNetwork.load(tmp_path / "weights.onnx").card == card
    assert load_to_detect(tmp_path / "weights.onnx").card == card


@pytest.mark.parametrize("width_px", ["0", "1000", "4096", "-640", "٦٤٠", "wide", ""])
def test_a_width_that_cannot_be_is_refused(exported: Path, tmp_path: Path, width_px: str) -> None:
    model = onnx.load(str(exported))
    (entry,) = (entry for entry in model.metadata_props if entry.key == "input_width_px")
    entry.value = width_px
    onnx.save(model, str(tmp_path / "changed.onnx"))
    with pytest.raises(InvalidWeights, match="not a multiple of 32 from 320 to 1920"):
        OnnxNetwork.load(tmp_path / "changed.onnx")


def test_a_file_sees_images_as_wide_as_its_network(tmp_path: Path, trained: SmallNetwork, frames: list[Frame]) -> None:
    """The same frame at another width: other boxes, the same from torch and from the file."""
    found = {}
    for width_px in (640, 960):
        card = CARD.model_copy(update={"input_width_px": width_px})
        export_small(trained, tmp_path / "weights.onnx", card)
        exported = OnnxNetwork.load(tmp_path / "weights.onnx")
        assert exported.card.input_width_px == width_px
        both: tuple[Network, ...] = (SmallMonocular(trained, card), exported)
        (ours,), (theirs,) = (list(predict(network, frames[:1], decode="plane", min_score=0.2)) for network in both)
        assert len(ours) > 0
        np.testing.assert_allclose(ours.boxes, theirs.boxes, atol=1e-2)
        found[width_px] = ours
    assert len(found[640]) != len(found[960]) or not np.allclose(found[640].boxes, found[960].boxes, atol=1e-2)


def test_a_network_in_training_stays_in_training_and_is_written_for_evaluation(tmp_path: Path) -> None:
    network = random_network().train()
    before = {name: values.clone() for name, values in network.state_dict().items()}
    export_small(network, tmp_path / "weights.onnx")
    assert all(module.training for module in network.modules())
    assert all(torch.equal(values, before[name]) for name, values in network.state_dict().items())
    images = to_input(np.random.default_rng(3).integers(0, 256, (1, 64, 64, 3), dtype=np.uint8))
    assert_same_maps(network.eval(), OnnxNetwork.load(tmp_path / "weights.onnx"), images)


def test_an_export_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(model: object) -> None:
        raise ValueError("not a model")

    monkeypatch.setattr(onnx.checker, "check_model", refuse)
    with pytest.raises(ValueError, match="not a model"):
        export_small(random_network(), tmp_path / "weights.onnx")
    assert list(tmp_path.iterdir()) == []


def refused(path: Path) -> str:
    with pytest.raises(InvalidWeights) as caught:
        OnnxNetwork.load(path)
    assert "ONNX file of a fine-tuned model" in caught.value.hint
    return caught.value.message


def test_files_of_another_kind_are_refused(tmp_path: Path) -> None:
    assert "does not exist" in refused(tmp_path / "absent.onnx")
    (tmp_path / "text.onnx").write_text("no network")
    assert "text.onnx is no ONNX network" in refused(tmp_path / "text.onnx")
    (tmp_path / "empty.onnx").write_bytes(b"")
    assert "empty.onnx is no ONNX network" in refused(tmp_path / "empty.onnx")
    assert "no ONNX network" in refused(bundled("mono_small.safetensors"))
    assert "family is 'wibam-centre', not 'wibam-small'" in refused(bundled("detector2d.onnx"))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("stride", "8"),
        ("reference_focal_px", "1.0"),
        ("uncertainty_groups", "[]"),
        ("mean_sizes_m", "[[4.5, 1.8, 1.5]]"),
        ("mean_sizes_m", "[[4.5, 1.8, NaN], [5, 2, 2], [8, 2, 3], [10, 2, 3]]"),
        ("mean_sizes_m", '{"car": 4.5}'),
        ("mean_sizes_m", "none"),
    ],
)
def test_a_file_that_says_something_else_is_refused(exported: Path, tmp_path: Path, key: str, value: str) -> None:
    model = onnx.load(str(exported))
    (entry,) = (entry for entry in model.metadata_props if entry.key == key)
    entry.value = value
    onnx.save(model, str(tmp_path / "changed.onnx"))
    assert f"changed.onnx: {key} is" in refused(tmp_path / "changed.onnx")


def test_a_file_that_lacks_an_output_or_has_one_of_another_shape_is_refused(exported: Path, tmp_path: Path) -> None:
    network = random_network()
    network.heads["yaw"] = torch.nn.Conv2d(64, 3, 1)
    export_small(network, tmp_path / "three.onnx")
    assert "yaw of float32 with 2 channels" in refused(tmp_path / "three.onnx")
    model = onnx.load(str(exported))
    (yaw,) = (output for output in model.graph.output if output.name == "yaw")
    model.graph.output.remove(yaw)
    onnx.save(model, str(tmp_path / "lacks.onnx"))
    assert "yaw of float32 with 2 channels" in refused(tmp_path / "lacks.onnx")
