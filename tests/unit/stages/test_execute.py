"""How a stage is run, whatever it does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from tests.builders import site_of
from wibam_core.config import PipelineConfig
from wibam_core.stages import calibrate
from wibam_core.stages.execute import StageRequest, run_stage


def threads() -> set[int]:
    """Of each library of linear algebra that is loaded."""
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_linear_algebra_keeps_to_one_thread_while_a_stage_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[set[int]] = []

    def run(*_: Any) -> dict[str, Any]:
        np.linalg.inv(np.eye(3))
        seen.append(threads())
        return {}

    monkeypatch.setattr(calibrate, "run", run)
    request = StageRequest(
        stage="calibrate",
        site=site_of(),
        config=PipelineConfig(),
        recordings={},
        upstream={},
        output=tmp_path / "output",
        scratch=tmp_path / "scratch",
    )
    with threadpool_limits(2, user_api="blas"):
        run_stage(request, lambda *_, **__: None, lambda _: None)
        assert threads() == {2}
    assert seen == [{1}]
