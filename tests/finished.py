"""A job whose stages have published something, without running them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests.builders import AMBIGUOUS, corner_rig
from tests.service import LiveApi
from wibam_core.adapters.job_rows import StageKey
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.documents.base import MeanSd
from wibam_core.documents.conflicts import ConflictRow, Conflicts
from wibam_core.documents.manifest import FileFacts
from wibam_core.documents.metrics import Consistency, LabelledInstants, Metrics
from wibam_core.documents.recordings import Probe, VideoInfo
from wibam_core.jobs.states import StageState
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track

CONFLICT = ConflictRow(
    conflict_id=0,
    track_ids=(1, 2),
    classes=("car", "bus"),
    type="crossing",
    time_ns=2_000_000_000,
    x_m=20.0,
    y_m=2.5,
    speeds_mps=(10.0, 0.0),
    ttc_s=1.25,
    ttc_interval_s=(1.0, None),
    probability=0.9,
    pet_s=None,
    pet_interval_s=(None, None),
    deceleration_mps2=4.0,
    duration_s=0.6,
    heading_difference_deg=90.0,
    measures={"delta_speed_mps": 10.0, "stopping_share": 0.85},
)
METRICS = Metrics(
    not_asked_for=["motorcycle", "bicycle", "pedestrian"],
    options={"min_score": 0.25},
    labels="none",
    labelled_instants=LabelledInstants(given=0, in_test_part=0, test_from_s=40.0, test_to_s=50.0),
    instants=20,
    frames=20,
    self_consistency={
        name: Consistency(other_views=MeanSd(mean=iou, sd=0.1), own_view=MeanSd(mean=0.8, sd=0.1), pairs=90, found=0.9)
        for name, iou in (("baseline", 0.4), ("finetuned", 0.7))
    },
)
VIDEO = VideoInfo(
    codec="h264",
    container="mov",
    width_px=64,
    height_px=36,
    rotation_deg=0,
    fps=25.0,
    frames=250,
    missing_frames=0,
    first_ns=0,
    last_ns=9_960_000_000,
    duration_s=10.0,
    largest_gap_s=0.04,
    variable_rate=False,
)


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


def finished_job(
    api: LiveApi,
    recording: bytes = b"not looked at",
    *,
    onnx: bool = True,
    weights: bytes = bytes(range(256)) * 4,
    tracked: Sequence[Track] | None = None,
    conflicts: Sequence[ConflictRow] = (CONFLICT,),
) -> str:
    """Create a job and publish small outputs for each of its stages; returns its id.

    Jobs with the same recording share their outputs. Without ``onnx`` there is no ``weights.onnx``, as in old jobs.
    ``weights`` are no network unless others are given. ``tracked`` are in place of `tracks`.
    Jobs that share a recording need the same ``conflicts``.
    """
    site = api.site(cameras=1)
    api.upload(site, recording)
    job_id = str(api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"])
    there = tracks() if tracked is None else tracked
    publish(api, job_id, lambda stage, folder: _write(stage, folder, onnx, weights, there, conflicts))
    return job_id


def publish(api: LiveApi, job_id: str, write: Callable[[str, Path], None]) -> None:
    """Let all stages of a job succeed; ``write`` puts what a stage makes into a folder."""
    leases, store = api.services.leases, api.services.stages
    for stage in api.services.jobs.job(job_id).stages:
        if stage.state is StageState.SUCCEEDED:  # before the job was restarted
            continue
        claim = leases.claim(StageKey(job_id, stage.name), "tests")
        if claim is None:  # another job with the same inputs has made it, which may have been settled just now
            assert api.services.jobs.job(job_id).stage(stage.name).state is StageState.REUSED, stage.name
            _assert_same(store.manifest(stage.name, stage.hash).files, stage.name, write)
            continue
        attempt = store.begin(stage.name, stage.hash)
        write(stage.name, attempt.output)
        warnings = [AMBIGUOUS] if stage.name == "sync" else []
        store.seal(attempt, {"stage": stage.name}, 0.1, warnings)
        leases.succeed(claim, {"stage": stage.name}, lambda attempt=attempt: store.reveal(attempt), warnings)  # type: ignore[misc]


def track_anew(api: LiveApi, job_id: str, tracked: Sequence[Track]) -> None:
    """Finish a job of `finished_job` that was restarted: its stages from `track` on publish other outputs."""
    publish(api, job_id, lambda stage, folder: _write(stage, folder, True, bytes(range(256)) * 4, tracked))


def _assert_same(there: Mapping[str, FileFacts], stage: str, write: Callable[[str, Path], None]) -> None:
    """What a job with the same inputs has published is what this one would: else one would see the other's."""
    with TemporaryDirectory() as folder:
        output = Path(folder) / "output"
        output.mkdir()
        write(stage, output)
        made = {str(file.relative_to(output)): file.read_bytes() for file in output.rglob("*") if file.is_file()}
    found = {name: sha256(data).hexdigest() for name, data in made.items()}
    assert found == {name: facts.sha256 for name, facts in there.items()}, (
        f"another test has published other outputs of {stage} for the same inputs: give this one a rig of its own"
    )


def _write(
    stage: str,
    folder: Path,
    onnx: bool,
    weights: bytes,
    tracked: Sequence[Track],
    conflicts: Sequence[ConflictRow] = (CONFLICT,),
) -> None:
    writer = ArtifactWriter(stage, folder, made_by(stage))
    if stage == "preflight":
        writer.write(catalogue.PROBE, Probe(cameras={"cam1": VIDEO}))
    if stage == "refine":
        writer.write(catalogue.RIG, corner_rig(1))
    if stage == "finetune":
        writer.new_file(catalogue.WEIGHTS).write_bytes(weights)
        if onnx:
            writer.new_file(catalogue.WEIGHTS_ONNX).write_bytes(bytes(range(255, -1, -1)) * 3)
    if stage == "evaluate":
        writer.write(catalogue.METRICS, METRICS)
    if stage == "track":
        writer.write(catalogue.TRACKS, tracked)
    if stage == "safety":
        writer.write(catalogue.CONFLICTS, Conflicts(thresholds={"ttc_s": 3.0}, conflicts=list(conflicts)))
    if stage == "report":
        writer.write(catalogue.REPORT, "<h1>report</h1>")
