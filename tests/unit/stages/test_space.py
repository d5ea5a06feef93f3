"""Whether what is being written will fit."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from wibam_core.errors import DiskFull
from wibam_core.stages.space import check_space


def free(monkeypatch: pytest.MonkeyPatch, free_bytes: float) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=int(free_bytes)))


def test_a_tenth_of_the_work_tells_ten_times_its_bytes(tmp_path: Path) -> None:
    assert check_space(tmp_path, 1000, 0.1) == 10_000


def test_what_will_not_fit_is_refused_with_both_figures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    free(monkeypatch, 17.9e9 + 0.2e9)
    with pytest.raises(DiskFull) as refused:
        check_space(tmp_path, 2_000_000_000, 0.1)  # 20 GB in all: 18 GB to come
    assert refused.value.details["expected_bytes"] == 20_000_000_000
    assert "20.00 GB" in refused.value.message and "18.10 GB left" in refused.value.message
    assert "Free 0.10 GB" in refused.value.hint
    free(monkeypatch, 18.0e9 + 0.2e9)
    assert check_space(tmp_path, 2_000_000_000, 0.1) == 20_000_000_000


def test_what_is_all_written_already_fits(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    free(monkeypatch, 0)
    assert check_space(tmp_path, 5, 1.0) == 5
