"""Fine-tuning on few vehicles warns, and on none it says how much longer to record."""

from pathlib import Path

import pytest
import torch

from tests.unit.stages.test_finetune_stage import folders_of, run
from wibam_core.artifacts.catalogue import CURVES, FITS
from wibam_core.config import FinetuneConfig
from wibam_core.errors import NoMultiViewVehicles


def test_few_vehicles_are_warned_of(tmp_path: Path) -> None:
    torch.set_num_threads(1)
    folders = folders_of(tmp_path)
    summary = run(folders, FinetuneConfig(method="combined", steps=1, batch_size=1))
    curves = folders.read(CURVES)
    assert "multiview" in curves.epochs[0].train
    assert summary["vehicles"] == 1
    [warning] = folders.warnings
    assert (warning.stage, warning.code) == ("finetune", "few_vehicles")
    assert "1 vehicle to learn from" in warning.message
    assert "more" in warning.hint


def test_no_vehicle_says_how_many_minutes_are_missing(tmp_path: Path) -> None:
    folders = folders_of(tmp_path)
    folders.give(FITS, [])
    with pytest.raises(NoMultiViewVehicles) as caught:
        run(folders, FinetuneConfig())
    assert "minute" in caught.value.hint
    assert caught.value.details["more_minutes"] >= 1
