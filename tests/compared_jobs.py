"""Finished jobs of one site whose networks err by a known amount, to be compared."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tests.builders import site_of
from tests.finished import METRICS, publish, tracks
from tests.labelled_job import TIMES_NS
from tests.service import LiveApi
from tests.site_dataset import tiny_rig, tiny_site
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.documents.split import Split
from wibam_core.models.weights import bundled
from wibam_core.scene import Vehicles3D

WEIGHTS = bundled("mono_small.safetensors").read_bytes()


def tiny_site_with_recordings(api: LiveApi, recording: bytes = b"") -> str:
    """A site with a recording of each camera; returns its id."""
    site = str(api.http.post("/v1/sites", json=site_of(tiny_rig()).model_dump(mode="json")).json()["id"])
    for camera in tiny_rig():
        api.upload(site, recording + camera.encode(), camera)
    return site


def made_job(api: LiveApi, site: str, error_m: float, test: tuple[int, ...], steps: int) -> dict[str, Any]:
    """A finished job whose network errs by so much along X; returns the network."""
    rig = tiny_rig()

    def write(stage: str, folder: Path) -> None:
        writer = ArtifactWriter(stage, folder, made_by(stage))
        content = tiny_site(folder.with_name(folder.name + "-frames"))
        if stage == "refine":
            writer.write(catalogue.RIG, rig)
        if stage == "frames":
            tiny_site(writer.new_file(catalogue.FRAMES))
        if stage == "associate":
            writer.write(catalogue.ANNOTATIONS, content.instants)
        if stage == "dataset":
            parts = {"train": tuple(t for t in TIMES_NS if t not in test), "val": (), "test": test}
            writer.write(catalogue.SPLIT, Split(times_ns=parts, left_out_tracks=dict.fromkeys(parts, frozenset[int]())))
        if stage == "finetune":
            writer.new_file(catalogue.WEIGHTS).write_bytes(WEIGHTS)
        if stage == "evaluate":
            writer.write(catalogue.METRICS, METRICS)
            off = np.array([error_m, 0, 0, 0, 0, 0, 0])
            found = [
                Vehicles3D.of(one.time_ns, one.boxes + off, one.classes, camera_id=camera, scores=np.ones(len(one)))
                for one in content.lifts
                for camera in rig
            ]
            writer.write(catalogue.PREDICTIONS_FINETUNED, [one for one in found if one.time_ns in test])
        if stage == "track":
            writer.write(catalogue.TRACKS, tracks())

    options = {"finetune": {"steps": steps}}
    job = api.http.post(f"/v1/sites/{site}/jobs", json={"name": f"{steps} steps", "options": options}).json()["id"]
    publish(api, job, write)
    [model] = api.http.get("/v1/models", params={"job": job}).json()
    return dict(model)
