from pathlib import Path

import pytest
import torch
from pydantic import ValidationError
from safetensors.torch import load_file, save_file

from wibam_core.config import FinetuneConfig
from wibam_core.errors import InvalidWeights
from wibam_core.models.frames import INPUT_WIDTH_PX
from wibam_core.models.usage import INPUT_WIDTHS_PX, Usage, input_width_metadata, read_input_width
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.weights import bundled, centertrack_metadata, load_network, metadata, save_network, usage_of


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


@pytest.mark.parametrize("usage", [Usage("fused", {"position": 1.7, "yaw": 0.8}), Usage("depth")])
def test_a_file_says_how_it_is_to_be_used(tmp_path: Path, usage: Usage) -> None:
    save_network(SmallNetwork(), tmp_path / "network.safetensors", usage.metadata())
    assert usage_of(tmp_path / "network.safetensors") == usage
    load_network(tmp_path / "network.safetensors")


def test_a_file_says_how_wide_its_network_sees_images(saved: Path, tmp_path: Path) -> None:
    network = SmallNetwork()
    network.input_width_px = 960
    save_network(network, tmp_path / "network.safetensors", {"input_width_px": "320"})
    assert load_network(tmp_path / "network.safetensors").input_width_px == 960
    assert load_network(bundled("mono_small.safetensors")).input_width_px == INPUT_WIDTH_PX  # it does not say
    save_file(load_file(str(saved)), str(tmp_path / "odd.safetensors"), metadata=metadata() | {"input_width_px": "650"})
    with pytest.raises(InvalidWeights, match="input_width_px is '650', not a multiple of 32"):
        load_network(tmp_path / "odd.safetensors")


def test_files_and_options_know_the_same_widths() -> None:
    for width_px in (INPUT_WIDTHS_PX[0], INPUT_WIDTHS_PX[-1]):
        said = input_width_metadata(width_px)
        assert FinetuneConfig(input_width_px=width_px).input_width_px == read_input_width("file", said) == width_px
    for width_px in (INPUT_WIDTHS_PX[0] - 32, INPUT_WIDTHS_PX[-1] + 32, 650):
        with pytest.raises(ValidationError):
            FinetuneConfig(input_width_px=width_px)
        with pytest.raises(InvalidWeights):
            read_input_width("file", input_width_metadata(width_px))


def test_what_a_file_does_not_say_is_its_familys_usual_way(saved: Path, tmp_path: Path) -> None:
    assert usage_of(saved) == usage_of(bundled("mono_small.safetensors")) == Usage("plane")
    save_network(DLA34(), tmp_path / "network.safetensors")
    assert usage_of(tmp_path / "network.safetensors") == Usage("depth")


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"decode": "guess"}, "network: decode is 'guess', not one of plane, depth, fused, ground"),
        ({"sd_factors": "[1]"}, "network: sd_factors is .* not a JSON object of positive numbers"),
        ({"sd_factors": "{"}, "sd_factors is"),
        ({"sd_factors": '{"yaw": "2"}'}, "sd_factors is"),
        ({"sd_factors": '{"yaw": 0}'}, "sd_factors is"),
        ({"sd_factors": '{"yaw": NaN}'}, "sd_factors is"),
    ],
)
def test_a_usage_that_cannot_be_is_refused(tmp_path: Path, said: dict[str, str], why: str) -> None:
    save_file({"any": torch.zeros(1)}, str(tmp_path / "network"), metadata=metadata() | said)
    with pytest.raises(InvalidWeights, match=why):
        usage_of(tmp_path / "network")


def test_a_dla34_has_no_uncertainties_to_fuse_by(tmp_path: Path) -> None:
    said = centertrack_metadata() | Usage("fused").metadata()
    save_file({"any": torch.zeros(1)}, str(tmp_path / "network"), metadata=said)
    with pytest.raises(InvalidWeights, match="not one of depth, plane"):
        usage_of(tmp_path / "network")
