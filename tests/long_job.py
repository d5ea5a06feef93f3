"""A finished job of ten minutes with dense traffic, as large as jobs are: sixty road users at once, four cameras."""

from __future__ import annotations

from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from tests.builders import corner_rig, site_of
from tests.finished import CONFLICT, METRICS, publish
from tests.service import LiveApi
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.documents.conflicts import ConflictRow, Conflicts
from wibam_core.documents.split import Split
from wibam_core.formats.framestore import FrameStoreWriter
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, Track, Vehicles3D

#: Rates of a job that leaves all options as they are.
FRAMES_NS, TRACKED_NS, TAUGHT_NS = 80_000_000, 160_000_000, 400_000_000
SECONDS, AT_ONCE, STAY = 600, 60, 180
CONFLICTS = 100


def long_job(api: LiveApi) -> str:
    """Create the job; returns its id."""
    rig = corner_rig()
    site = str(api.http.post("/v1/sites", json=site_of(rig).model_dump(mode="json")).json()["id"])
    for camera_id in rig:
        api.upload(site, b"ten minutes" + camera_id.encode(), camera_id)
    job_id = str(api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"])
    with TemporaryDirectory() as made:  # beforehand: on a busy machine it takes longer than a stage may be silent
        for stage in api.services.jobs.job(job_id).stages:
            (Path(made) / stage.name).mkdir()
            _write(stage.name, Path(made) / stage.name)
        publish(api, job_id, lambda stage, folder: _take(Path(made) / stage, folder))
    return job_id


def _take(made: Path, folder: Path) -> None:
    copytree(made, folder, dirs_exist_ok=True)


def tracks() -> list[Track]:
    """Each is there for 28.8 s, on lanes of its own; the n-th begins 0.48 s after the one before."""
    found, along = [], np.arange(STAY) * 0.4
    for number in range(SECONDS * 10**9 // TRACKED_NS * AT_ONCE // STAY - AT_ONCE):
        heading = number * 0.7 % (2 * np.pi) - np.pi
        forward = np.array([np.cos(heading), np.sin(heading)])
        wavering = 0.05 * np.sin(along / 3 + number)  # numbers that no rounding makes equal
        boxes = np.zeros((STAY, 7))
        boxes[:, :2] = (along - 36)[:, None] * forward + (2 + wavering)[:, None] * forward[::-1] * [-1, 1]
        boxes[:, 2:] = 0.75, 4.5, 1.8, 1.5, heading
        boxes[:, 6] += 0.01 * np.cos(along / 3 + number)
        times = (number * STAY // AT_ONCE + np.arange(STAY)) * TRACKED_NS
        speeds = 2.5 + wavering
        found.append(
            Track(
                number,
                RoadUserClass.CAR,
                times,
                boxes,
                np.full((STAY, 7), 0.1),
                speeds[:, None] * forward,
                np.zeros(STAY),
            )
        )
    return found


def _write(stage: str, folder: Path) -> None:
    writer, rig = ArtifactWriter(stage, folder, made_by(stage)), corner_rig()
    taught = tuple(range(0, SECONDS * 10**9, TAUGHT_NS))
    if stage == catalogue.RIG.stage:
        writer.write(catalogue.RIG, rig)
    if stage == catalogue.FRAMES.stage:
        jpeg = cv2.imencode(".jpg", np.full((36, 64, 3), 110, np.uint8))[1].tobytes()
        with FrameStoreWriter(writer.new_file(catalogue.FRAMES), 90) as store:
            for later, camera_id in enumerate(rig):
                for time_ns in range(0, SECONDS * 10**9, FRAMES_NS):
                    store.add_jpeg(camera_id, time_ns, jpeg, (64, 36))
                    store.add_to_instant(time_ns, camera_id, time_ns, time_ns + 3_456_789 * later)
            store.close({camera_id: (camera.width_px, camera.height_px) for camera_id, camera in rig.items()})
    if stage == catalogue.ANNOTATIONS.stage:
        writer.write(catalogue.ANNOTATIONS, [AnnotatedInstant(time_ns, {}) for time_ns in taught])
    if stage == catalogue.SPLIT.stage:
        parts = {"train": taught[:900], "val": taught[900:1200], "test": taught[1200:]}
        writer.write(catalogue.SPLIT, Split(times_ns=parts, left_out_tracks=dict.fromkeys(parts, frozenset[int]())))
    if stage == catalogue.FITS.stage:
        box, one = np.array([[0.0, 0.0, 0.75, 4.5, 1.8, 1.5, 0.0]]), np.array([0])
        writer.write(catalogue.FITS, [Vehicles3D.of(time_ns, box, one, one) for time_ns in taught])
    if stage == catalogue.METRICS.stage:
        writer.write(catalogue.METRICS, METRICS)
    if stage == catalogue.TRACKS.stage:
        writer.write(catalogue.TRACKS, tracks())
    if stage == catalogue.CONFLICTS.stage:
        rows = [_conflict(number) for number in range(CONFLICTS)]
        writer.write(catalogue.CONFLICTS, Conflicts(thresholds={"ttc_s": 3.0}, conflicts=rows))


def _conflict(number: int) -> ConflictRow:
    return CONFLICT.model_copy(
        update={
            "conflict_id": number,
            "track_ids": (number * 10, number * 10 + 1),
            "time_ns": (number * 30 + 12) * TRACKED_NS,
            "x_m": 0.1234567890123 * number,
            "probability": 0.123456789012345,
        }
    )
