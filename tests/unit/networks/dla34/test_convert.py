"""Users' checkpoints: what fits becomes a file of the same tensors, what does not is named, nothing runs."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
import safetensors
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from wibam_core.errors import InvalidWeights
from wibam_core.formats.model_card import metadata_of
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.convert import LICENCE_NOTE, convert_checkpoint, read_checkpoint
from wibam_core.networks.dla34.network import CARD
from wibam_core.networks.registry import load_network, read_card

Shapes = dict[str, tuple[int, ...]]


@pytest.fixture(scope="session")
def own_shapes() -> Shapes:
    return {name: tuple(value.shape) for name, value in DLA34().state_dict().items()}


@pytest.fixture(params=["own", "published"])
def shapes(request: pytest.FixtureRequest, own_shapes: Shapes) -> Shapes:
    """Names and shapes: our network's, and those of the published checkpoint."""
    if request.param == "own":
        return own_shapes
    assets: Path = request.getfixturevalue("assets")
    manifest = json.loads((assets / "reference" / "centertrack_dla34_ddd_state_dict.json").read_text())
    return {name: tuple(shape) for name, shape in manifest.items()}


def filled(name: str, shape: tuple[int, ...]) -> Tensor:
    """A tensor that tells its name; all its numbers are equal, so that it takes no room in a checkpoint."""
    if name.endswith("num_batches_tracked"):
        return torch.tensor(zlib.crc32(name.encode()))
    return torch.tensor(zlib.crc32(name.encode()) / 2**32).expand(shape)


def state_of(shapes: Shapes, prefix: str = "") -> dict[str, Tensor]:
    return {prefix + name: filled(name, shape) for name, shape in shapes.items()}


def centertrack(path: Path, state: dict[str, Tensor]) -> Path:
    torch.save({"epoch": 140, "state_dict": state}, path)
    return path


def lightning(path: Path, state: dict[str, Tensor]) -> Path:
    content = {
        "epoch": 12,
        "global_step": 3400,
        "pytorch-lightning_version": "1.2.0",
        "state_dict": state,
        "callbacks": {"ModelCheckpoint": {"best_model_score": torch.tensor(0.5), "dirpath": "out"}},
        "optimizer_states": [{"state": {0: {"step": 3, "exp_avg": torch.zeros(2)}}, "param_groups": [{"lr": 3.1e-5}]}],
        "lr_schedulers": [],
        "hyper_parameters": {"lr": 3.125e-5},
    }
    torch.save(content, path)
    return path


@pytest.mark.parametrize(
    ("write", "prefix"),
    [(centertrack, ""), (centertrack, "module."), (lightning, "model."), (lightning, "model.module.")],
)
def test_every_tensor_finds_its_place(
    write: Callable[[Path, dict[str, Tensor]], Path], prefix: str, shapes: Shapes, tmp_path: Path
) -> None:
    found = read_checkpoint(write(tmp_path / "weights.pth", state_of(shapes, prefix)))
    assert found.state.keys() == shapes.keys()
    assert len(found.state) == 414
    assert all(torch.equal(found.state[name], filled(name, shape)) for name, shape in shapes.items())
    assert found.prefix == prefix
    assert found.dropped == ()


def test_the_file_loads_and_says_where_it_comes_from(own_shapes: Shapes, tmp_path: Path) -> None:
    source = centertrack(tmp_path / "nuScenes_é.pth", state_of(own_shapes, "module."))
    convert_checkpoint(source, tmp_path / "new folder" / "out.safetensors")
    out = tmp_path / "new folder" / "out.safetensors"
    with safetensors.safe_open(str(out), framework="pt") as file:
        metadata = file.metadata()
    assert metadata == metadata_of(CARD) | {
        "source_name": "nuScenes_é.pth",
        "source_sha256": hashlib.sha256(source.read_bytes()).hexdigest(),
        "licence": LICENCE_NOTE,
    }
    assert "non-commercial" in LICENCE_NOTE
    assert metadata["classes"].startswith("car,truck,bus,trailer,construction_vehicle,pedestrian")
    network = load_network(out).module
    assert isinstance(network, DLA34)
    assert not network.training
    for name, value in network.state_dict().items():
        assert torch.equal(value, filled(name, own_shapes[name])), name
    assert list(out.parent.iterdir()) == [out]
    first = out.read_bytes()
    convert_checkpoint(source, out)
    assert out.read_bytes() == first
    assert read_card(out).licence == LICENCE_NOTE
    save_file(load_file(str(out)), str(out), metadata=metadata | {"classes": "car"})
    with pytest.raises(InvalidWeights, match=r"tensor hm.2.weight has shape \(10, 256, 1, 1\), not \(1, 256, 1, 1\)"):
        load_network(out)


def test_heads_that_nothing_reads_are_dropped_and_told(own_shapes: Shapes, tmp_path: Path) -> None:
    extra = {
        f"{head}.{layer}": torch.zeros(shape)
        for head, channels in (("velocity", 3), ("nuscenes_att", 8))
        for layer, shape in (
            ("0.weight", (256, 64, 3, 3)),
            ("0.bias", (256,)),
            ("2.weight", (channels, 256, 1, 1)),
            ("2.bias", (channels,)),
        )
    }
    state = state_of(own_shapes) | extra
    found = read_checkpoint(centertrack(tmp_path / "w.pth", {f"module.{name}": v for name, v in state.items()}))
    assert found.dropped == ("nuscenes_att", "velocity")
    assert found.state.keys() == own_shapes.keys()


def test_half_and_double_precision_become_float32(own_shapes: Shapes, tmp_path: Path) -> None:
    state = state_of(own_shapes)
    state["dep.2.bias"] = torch.tensor([0.5], dtype=torch.float16)
    state["reg.2.bias"] = torch.tensor([0.25, 0.5], dtype=torch.float64)
    found = read_checkpoint(centertrack(tmp_path / "w.pth", state)).state
    assert found["dep.2.bias"].dtype == found["reg.2.bias"].dtype == torch.float32
    assert found["reg.2.bias"].tolist() == [0.25, 0.5]


def one_in_many(value: float) -> Tensor:
    weights = torch.zeros(10, 256, 1, 1)
    weights[3, 100] = value
    return weights


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"hm.2.weight": one_in_many(float("nan"))}, "hm.2.weight has values that are not finite"),
        ({"hm.2.weight": one_in_many(-float("inf"))}, "hm.2.weight has values that are not finite"),
        ({"dep.2.bias": None}, "w.pth lacks the tensor dep.2.bias"),
        ({"dep.2.bias": torch.zeros(2)}, r"dep.2.bias has shape \(2,\), not \(1,\)"),
        ({"hm.2.weight": torch.zeros(80, 256, 1, 1)}, r"hm.2.weight has shape \(80, 256, 1, 1\)"),
        ({"dep.2.bias": torch.full((1,), float("nan"))}, "dep.2.bias has values that are not finite"),
        ({"dep.2.bias": torch.full((1,), 1e300, dtype=torch.float64)}, "dep.2.bias has values that are not finite"),
        ({"dep.2.bias": torch.zeros(1, dtype=torch.int64)}, "dep.2.bias is torch.int64, not torch.float32"),
        ({"base.pre_img_layer.0.weight": torch.zeros(16, 3, 7, 7)}, "a tensor base.pre_img_layer.0.weight that the"),
        ({"model.dep.2.bias": torch.zeros(1)}, "the tensor dep.2.bias twice"),
        ({"dep.2.bias": 3.0}, "dep.2.bias in its state_dict is not a plain tensor"),
        ({"dep.2.bias": torch.zeros(1).to_sparse()}, "dep.2.bias in its state_dict is not a plain tensor"),
        ({"dep.2.bias": torch.zeros(1, device="meta")}, "dep.2.bias in its state_dict is not a plain tensor"),
    ],
)
def test_the_first_mismatch_is_named(
    changes: dict[str, Tensor | None], said: str, own_shapes: Shapes, tmp_path: Path
) -> None:
    state = {name: value for name, value in (state_of(own_shapes) | changes).items() if value is not None}
    source = centertrack(tmp_path / "w.pth", state)
    with pytest.raises(InvalidWeights, match=said) as caught:
        convert_checkpoint(source, tmp_path / "out.safetensors")
    assert caught.value.code == "invalid_weights"
    assert "3D detection on nuScenes with DLA-34" in caught.value.hint
    assert list(tmp_path.iterdir()) == [source]


class Code:
    """A pickle that makes a folder when it is read."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return os.mkdir, (str(self.folder),)


@pytest.mark.parametrize("zipped", [True, False])
def test_a_pickle_that_needs_code_is_refused_and_runs_nothing(zipped: bool, own_shapes: Shapes, tmp_path: Path) -> None:
    made, source = tmp_path / "made", tmp_path / "w.ckpt"
    content = {"state_dict": state_of(own_shapes), "hyper_parameters": Code(made)}
    torch.save(content, source, _use_new_zipfile_serialization=zipped)
    with pytest.raises(InvalidWeights, match=r"w\.ckpt needs code to be read \(posix\.mkdir\)") as caught:
        read_checkpoint(source)
    assert "state_dict" in caught.value.hint
    assert not made.exists()
    source.write_bytes(pickle.dumps(Code(made)))
    with pytest.raises(InvalidWeights):
        read_checkpoint(source)
    assert not made.exists()


def test_what_is_no_checkpoint_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    with pytest.raises(InvalidWeights, match="does not exist"):
        read_checkpoint(path)
    torch.save(torch.zeros(1000), path)
    whole = path.read_bytes()
    for content in (b"", b"hello world", whole[: len(whole) // 2], b"PK\x03\x04" + bytes(100), b"\x80\x02}."):
        path.write_bytes(content)
        with pytest.raises(InvalidWeights, match=r"w\.pth is not a checkpoint"):
            read_checkpoint(path)
    for nothing in (torch.zeros(3), {}, {"state_dict": {}}, {"state_dict": [torch.zeros(1)]}, {"model": 3}):
        torch.save(nothing, path)
        with pytest.raises(InvalidWeights, match="it has no state_dict"):
            read_checkpoint(path)
    with pytest.raises(InvalidWeights, match="not a checkpoint"):
        read_checkpoint(tmp_path)


def test_the_output_never_takes_the_checkpoints_place(own_shapes: Shapes, tmp_path: Path) -> None:
    source = centertrack(tmp_path / "w.pth", state_of(own_shapes))
    with pytest.raises(InvalidWeights, match=r"does not end in \.safetensors"):
        convert_checkpoint(source, source)
    with pytest.raises(InvalidWeights, match="not a safetensors file") as caught:
        load_network(source)
    assert "wibam weights convert" in caught.value.hint
