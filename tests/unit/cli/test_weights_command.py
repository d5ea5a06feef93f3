from __future__ import annotations

from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from wibam_core.cli.app import app
from wibam_core.errors import InvalidWeights
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.registry import load_network


def run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, ["weights", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0
    return " ".join(result.output.split())


def test_a_checkpoint_is_converted_and_its_licence_told(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = DLA34({"hm": 10, "reg": 2, "wh": 2, "dep": 1, "rot": 8, "dim": 3, "amodel_offset": 2, "velocity": 3})
    state = {f"module.{name}": value for name, value in network.state_dict().items()}
    torch.save({"epoch": 140, "state_dict": state}, tmp_path / "nuScenes_3Ddetection_e140.pth")
    out = tmp_path / "centertrack.safetensors"
    said = run("convert", tmp_path / "nuScenes_3Ddetection_e140.pth", out)
    assert "414 tensors, 20.3 million numbers; the prefix module. taken off" in said
    assert "left out: velocity" in said
    assert "non-commercial use only" in said
    assert "SHA-256 of nuScenes_3Ddetection_e140.pth:" in said
    loaded = load_network(out).module.state_dict()
    assert all(torch.equal(loaded[name], network.state_dict()[name]) for name in loaded)


def test_what_does_not_fit_is_an_error_with_a_hint(tmp_path: Path) -> None:
    torch.save({"state_dict": {"hm.0.bias": torch.zeros(3)}}, tmp_path / "w.pth")
    with pytest.raises(InvalidWeights, match=r"w\.pth lacks the tensor") as caught:
        run("convert", tmp_path / "w.pth", tmp_path / "out.safetensors")
    assert caught.value.hint
    assert not (tmp_path / "out.safetensors").exists()


def test_the_group_shows_its_commands() -> None:
    assert "convert" in CliRunner().invoke(app, ["weights", "--help"]).output
