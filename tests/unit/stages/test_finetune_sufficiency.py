"""Fine-tuning on few vehicles warns, and on none it says how much longer to record."""

import json
from pathlib import Path

import pytest
import torch

from tests.unit.stages.test_finetune_stage import context_of
from wibam_core.config import FinetuneConfig
from wibam_core.errors import NoMultiViewVehicles
from wibam_core.formats.vehicles3d import write_vehicles3d
from wibam_core.stages import finetune


def test_few_vehicles_are_warned_of(tmp_path: Path) -> None:
    torch.set_num_threads(1)
    context = context_of(tmp_path)
    summary = finetune.run(context, FinetuneConfig(method="combined", steps=1, batch_size=1))
    curves = json.loads((context.output / "curves.json").read_text())
    assert curves["method"] == "combined"
    assert "multiview" in curves["epochs"][0]["train"]
    assert summary["vehicles"] == 1
    assert summary["warnings"] == curves["warnings"]
    assert "1 vehicle to learn from" in summary["warnings"][0]


def test_no_vehicle_says_how_many_minutes_are_missing(tmp_path: Path) -> None:
    context = context_of(tmp_path)
    write_vehicles3d(context.upstream["lift"] / "lifts.parquet", [])
    with pytest.raises(NoMultiViewVehicles) as caught:
        finetune.run(context, FinetuneConfig())
    assert "minute" in caught.value.hint
    assert caught.value.details["more_minutes"] >= 1
