from pathlib import Path

import pytest
import torch
from pydantic import ValidationError
from safetensors.torch import load_file, save_file

from wibam_core.config import FinetuneConfig
from wibam_core.documents.model_card import ModelCard
from wibam_core.errors import InvalidWeights
from wibam_core.formats.model_card import INPUT_WIDTHS_PX, card_of, metadata_of
from wibam_core.models.frames import INPUT_WIDTH_PX
from wibam_core.models.weights import bundled
from wibam_core.networks.dla34.network import CARD as CENTERTRACK
from wibam_core.networks.registry import load_network, read_card, save_network
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.small.network import CARD, SmallMonocular
from wibam_core.networks.small.onnx_network import DECODES


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "network.safetensors"
    save_network(SmallMonocular(SmallNetwork()), path)
    return path


def test_what_is_saved_is_loaded(saved: Path) -> None:
    torch.manual_seed(0)
    original, loaded = SmallNetwork().state_dict(), load_network(saved).module.state_dict()
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
    save_file(state, str(folder / "changed.safetensors"), metadata=metadata_of(CARD))
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


@pytest.mark.parametrize(
    "card",
    [
        CARD.model_copy(update={"decode": "fused", "sd_factors": {"position": 1.7, "yaw": 0.8}, "licence": "gratis"}),
        CARD.model_copy(update={"decode": "depth", "input_width_px": 960, "classes": ("bus", "car"), "version": "2"}),
        CARD.model_copy(update={"start": "custom", "method": "paper", "device": "cuda", "source_sha256": "ab"}),
    ],
)
def test_a_file_says_what_its_network_is(tmp_path: Path, card: ModelCard) -> None:
    module = SmallNetwork(mean_sizes_m=[(4.0, 2.0, 1.5)] * len(card.classes))
    save_network(SmallMonocular(module, card), tmp_path / "network.safetensors")
    assert read_card(tmp_path / "network.safetensors") == card
    assert load_network(tmp_path / "network.safetensors").card == card


def test_the_same_network_gives_the_same_bytes(tmp_path: Path) -> None:
    card = CARD.model_copy(update={"licence": "gratis", "method": "paper", "device": "cpu", "source_name": "ours.pth"})
    module = SmallNetwork()
    files = []
    for number in range(5):
        save_network(SmallMonocular(module, card), tmp_path / f"{number}.safetensors")
        files.append((tmp_path / f"{number}.safetensors").read_bytes())
    assert len(set(files)) == 1


def test_a_file_says_how_wide_its_network_sees_images(saved: Path, tmp_path: Path) -> None:
    assert load_network(saved, 960).card.input_width_px == 960
    assert read_card(bundled("mono_small.safetensors")).input_width_px is None  # it does not say
    assert load_network(bundled("mono_small.safetensors")).card.input_width_px == INPUT_WIDTH_PX
    said = metadata_of(CARD) | {"input_width_px": "650"}
    save_file(load_file(str(saved)), str(tmp_path / "odd.safetensors"), metadata=said)
    with pytest.raises(InvalidWeights, match="input_width_px is '650', not a multiple of 32"):
        load_network(tmp_path / "odd.safetensors")


def test_files_and_options_know_the_same_widths() -> None:
    def read(width_px: int) -> int | None:
        return card_of("file", {"family": "any", "input_width_px": str(width_px)}, DECODES).input_width_px

    for width_px in (INPUT_WIDTHS_PX[0], INPUT_WIDTHS_PX[-1]):
        assert FinetuneConfig(input_width_px=width_px).input_width_px == read(width_px) == width_px
    for width_px in (INPUT_WIDTHS_PX[0] - 32, INPUT_WIDTHS_PX[-1] + 32, 650):
        with pytest.raises(ValidationError):
            FinetuneConfig(input_width_px=width_px)
        with pytest.raises(InvalidWeights):
            read(width_px)


def test_what_a_file_does_not_say_is_its_familys_usual_way(saved: Path, tmp_path: Path) -> None:
    assert read_card(bundled("mono_small.safetensors")) == CARD.model_copy(update={"input_width_px": None})
    said = {key: value for key, value in metadata_of(CENTERTRACK).items() if key != "decode"}
    save_file({"any": torch.zeros(1)}, str(tmp_path / "network.safetensors"), metadata=said)
    assert read_card(tmp_path / "network.safetensors").decode == "depth"


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"decode": "guess"}, "network: decode is 'guess', not one of plane, depth, fused, ground"),
        ({"sd_factors": "[1]"}, "network: sd_factors is .* not a JSON object of positive numbers"),
        ({"sd_factors": "{"}, "sd_factors is"),
        ({"sd_factors": '{"yaw": "2"}'}, "sd_factors is"),
        ({"sd_factors": '{"yaw": 0}'}, "sd_factors is"),
        ({"sd_factors": '{"yaw": NaN}'}, "sd_factors is"),
        ({"sd_factors": '{"width": 2.0}'}, "sd_factors names width, but there are only position, z, size, yaw"),
        ({"device": "tpu"}, "device is 'tpu', not one of auto, cpu, cuda"),
        ({"start": "scratch"}, "start is 'scratch', not one of small, custom"),
    ],
)
def test_a_card_that_cannot_be_is_refused(tmp_path: Path, said: dict[str, str], why: str) -> None:
    save_file({"any": torch.zeros(1)}, str(tmp_path / "network"), metadata=metadata_of(CARD) | said)
    with pytest.raises(InvalidWeights, match=why):
        read_card(tmp_path / "network")


def test_a_dla34_has_no_uncertainties_to_fuse_by(tmp_path: Path) -> None:
    said = metadata_of(CENTERTRACK) | {"decode": "fused"}
    save_file({"any": torch.zeros(1)}, str(tmp_path / "network"), metadata=said)
    with pytest.raises(InvalidWeights, match="not one of depth, plane"):
        read_card(tmp_path / "network")


@pytest.mark.parametrize(
    ("classes", "why"),
    [("car,hovercraft", "knows a class 'hovercraft', which we do not"), ("car,car", "names a class twice"), ("", "''")],
)
def test_classes_that_cannot_be_are_refused(saved: Path, tmp_path: Path, classes: str, why: str) -> None:
    save_file(load_file(str(saved)), str(tmp_path / "network"), metadata=metadata_of(CARD) | {"classes": classes})
    with pytest.raises(InvalidWeights, match=why):
        load_network(tmp_path / "network")
