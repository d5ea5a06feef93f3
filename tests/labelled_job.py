"""A finished job with frames in which painted vehicles can be labelled, and fits that are a little wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.builders import site_of
from tests.finished import publish
from tests.service import LiveApi
from tests.site_dataset import PERIOD_NS, TinySite, tiny_rig, tiny_site
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.documents.split import Split
from wibam_core.scene import Vehicles3D

TIMES_NS = tuple(index * PERIOD_NS for index in range(4))
#: What a fit is off: m along X and Y, m of length, rad of yaw.
FIT_ERROR = np.array([0.5, -0.4, 0.0, 0.4, 0.0, 0.0, 0.15])


def labelled_job(api: LiveApi, recording: bytes = b"north") -> str:
    """Create the job; returns its id. Its vehicles 7 and 8 are those of `tests.site_dataset.boxes_at`."""
    response = api.http.post("/v1/sites", json=site_of(tiny_rig()).model_dump(mode="json"))
    site = str(response.json()["id"])
    for camera_id in tiny_rig():
        api.upload(site, recording + camera_id.encode(), camera_id)
    job_id = str(api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"])
    publish(api, job_id, _write)
    return job_id


def label_anew(api: LiveApi, job_id: str) -> None:
    """Finish a job of `labelled_job` that was restarted: stages that are made anew publish the same once more."""
    publish(api, job_id, _write)


def later_job(api: LiveApi, earlier: str, instants: int) -> str:
    """A finished job on the footage of an earlier one that looks at its first instants alone; returns its id."""
    site = api.http.get(f"/v1/jobs/{earlier}").json()["site_id"]
    options = {"frames": {"rate_hz": 1.0 + instants}}  # other frames have another address
    job_id = str(api.http.post(f"/v1/sites/{site}/jobs", json={"options": options}).json()["id"])
    publish(api, job_id, lambda stage, folder: _write(stage, folder, instants))
    return job_id


def _write(stage: str, folder: Path, instants: int = len(TIMES_NS)) -> None:
    writer = ArtifactWriter(stage, folder, made_by(stage))
    if stage == "refine":
        writer.write(catalogue.RIG, tiny_rig())
    if stage == catalogue.FRAMES.stage:
        tiny_site(writer.new_file(catalogue.FRAMES), instants)
    if stage == catalogue.ANNOTATIONS.stage:
        writer.write(catalogue.ANNOTATIONS, _site(folder, instants).instants)
    if stage == catalogue.SPLIT.stage:
        subsets = {"train": (), "val": (), "test": TIMES_NS[:instants]}
        nobody = dict.fromkeys(subsets, frozenset[int]())
        writer.write(catalogue.SPLIT, Split(times_ns=subsets, left_out_tracks=nobody))
    if stage == catalogue.FITS.stage:
        fits = [Vehicles3D.of(f.time_ns, f.boxes + FIT_ERROR, f.classes, f.ids) for f in _site(folder, instants).lifts]
        writer.write(catalogue.FITS, fits)


def _site(folder: Path, instants: int) -> TinySite:
    """What the frames show; they are written beside the stage's output."""
    return tiny_site(folder.with_name(folder.name + "-frames"), instants)
