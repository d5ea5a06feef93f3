from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from wibam_core.errors import InvalidWeights
from wibam_core.models.small import SmallNetwork
from wibam_core.models.weights import bundled, load_network, metadata, save_network


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "network.safetensors"
    save_network(SmallNetwork(), path)
    return path


def test_what_is_saved_is_loaded(saved: Path) -> None:
    torch.manual_seed(0)
    original, loaded = SmallNetwork().state_dict(), load_network(saved).state_dict()
    assert original.keys() == loaded.keys()
    assert all(torch.equal(original[name], loaded[name]) for name in original)
    assert not list(saved.parent.glob("*.tmp"))


def test_weights_fit_into_eight_megabytes(saved: Path) -> None:
    assert saved.stat().st_size < 8_000_000


def rewritten(saved: Path, folder: Path, **changes: torch.Tensor | None) -> Path:
    state = load_file(str(saved))
    for name, value in changes.items():
        key = name.replace("__", ".")
        if value is None:
            del state[key]
        else:
            state[key] = value
    save_file(state, str(folder / "changed.safetensors"), metadata=metadata())
    return folder / "changed.safetensors"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"heads__depth__bias": None}, "lacks the tensor heads.depth.bias"),
        ({"heads__depth__bias": torch.zeros(2)}, r"heads.depth.bias has shape \(2,\)"),
        ({"heads__depth__bias": torch.zeros(1, dtype=torch.float16)}, "heads.depth.bias is torch.float16"),
        ({"heads__depth__bias": torch.full((1,), float("nan"))}, "not finite"),
        ({"extra": torch.zeros(1)}, "a tensor extra"),
    ],
)
def test_the_first_mismatch_is_named(
    saved: Path, tmp_path: Path, changes: dict[str, torch.Tensor | None], said: str
) -> None:
    with pytest.raises(InvalidWeights, match=said):
        load_network(rewritten(saved, tmp_path, **changes))


def test_files_of_another_kind_are_refused(saved: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidWeights, match="does not exist"):
        load_network(tmp_path / "absent.safetensors")
    (tmp_path / "text.safetensors").write_bytes(b"hello")
    with pytest.raises(InvalidWeights, match="not a safetensors file"):
        load_network(tmp_path / "text.safetensors")
    torch.save(SmallNetwork().state_dict(), tmp_path / "pickle.pt")
    with pytest.raises(InvalidWeights, match="not a safetensors file"):
        load_network(tmp_path / "pickle.pt")
    save_file(load_file(str(saved)), str(tmp_path / "other.safetensors"), metadata={"family": "another"})
    with pytest.raises(InvalidWeights, match="family is 'another'"):
        load_network(tmp_path / "other.safetensors")


def test_bundled_files_are_there_and_load() -> None:
    load_network(bundled("mono_small.safetensors"))
    assert bundled("detector2d.onnx").stat().st_size < 8_000_000
    with pytest.raises(InvalidWeights, match="nothing"):
        bundled("nothing.safetensors")
