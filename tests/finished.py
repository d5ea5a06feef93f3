"""A job whose stages have published something, without running them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from tests.service import LiveApi
from wibam_core.adapters.job_rows import StageKey
from wibam_core.formats.tracks import write_tracks
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track

CONFLICT = {"conflict_id": 0, "track_ids": [1, 2], "classes": ["car", "bus"], "type": "crossing", "ttc_s": 1.25,
            "ttc_interval_s": [1.0, None], "pet_s": None}  # fmt: skip


def tracks() -> list[Track]:
    """Track 1: a car, 50 states, 10 Hz, along +X at 10 m/s from x = 0. Track 2: a bus that stands at (20, 5)."""
    times = np.arange(50, dtype=np.int64) * 100_000_000
    moving, standing = np.zeros((50, 7)), np.zeros((50, 7))
    moving[:, 0] = np.arange(50.0)
    standing[:, :2] = 20.0, 5.0
    for boxes, size in ((moving, (4.5, 1.8, 1.5)), (standing, (12.0, 2.5, 3.2))):
        boxes[:, 3:6], boxes[:, 2] = size, size[2] / 2
    sd, rates = np.full((50, 7), 0.1), np.zeros(50)
    return [
        Track(1, RoadUserClass.CAR, times, moving, sd, np.tile([10.0, 0.0], (50, 1)), rates),
        Track(2, RoadUserClass.BUS, times, standing, sd, np.zeros((50, 2)), rates),
    ]


def finished_job(api: LiveApi, recording: bytes = b"not looked at", *, onnx: bool = True) -> str:
    """Create a job and publish small outputs for each of its stages; returns its id.

    Jobs with the same recording share their outputs. Without ``onnx`` there is no ``weights.onnx``, as in old jobs.
    """
    site = api.site(cameras=1)
    api.upload(site, recording)
    job_id = str(api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"])
    leases, store = api.services.leases, api.services.stages
    for stage in api.services.jobs.job(job_id).stages:
        claim = leases.claim(StageKey(job_id, stage.name), "tests")
        assert claim is not None, stage.name
        attempt = store.begin(stage.name, stage.hash)
        _write(stage.name, attempt.output, onnx)
        store.seal(attempt, {"stage": stage.name}, 0.1)
        leases.succeed(claim, {"stage": stage.name}, lambda attempt=attempt: store.reveal(attempt))  # type: ignore[misc]
    return job_id


def _write(stage: str, folder: Path, onnx: bool) -> None:
    if stage == "track":
        write_tracks(folder / "tracks.parquet", tracks())
    if stage == "finetune":
        (folder / "weights.safetensors").write_bytes(bytes(range(256)) * 4)
        if onnx:
            (folder / "weights.onnx").write_bytes(bytes(range(255, -1, -1)) * 3)
    if stage == "report":
        (folder / "report.html").write_text("<h1>report</h1>")
    documents: dict[str, tuple[str, Any]] = {
        "preflight": ("probe.json", {"cam1": {"codec": "h264", "fps": 25.0}}),
        "evaluate": ("metrics.json", {"baseline": {"recall": 0.5}}),
        "safety": ("conflicts.json", {"conflicts": [CONFLICT], "thresholds": {"ttc_s": 3.0}}),
    }
    if stage in documents:
        name, document = documents[stage]
        (folder / name).write_text(json.dumps(document))
