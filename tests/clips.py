"""What a clip is made of: the outputs of a job on grey frames, with a car that drives and a bus that stands."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.builders import corner_rig, site_of
from tests.finished import CONFLICT, publish, tracks
from tests.service import LiveApi
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader, ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.documents.conflicts import Conflicts
from wibam_core.formats.framestore import FrameStoreWriter

CAMERAS = 2
#: Frames of cam2 are exposed so much later than the instants.
LATER_NS = 40_000_000
_STAGES = tuple(a.stage for a in (catalogue.RIG, catalogue.FRAMES, catalogue.TRACKS, catalogue.CONFLICTS))


def outputs(root: Path) -> ArtifactReader:
    """Of those stages that a clip is made of, in a folder of one's own."""
    for stage in _STAGES:
        (root / stage).mkdir(parents=True)
        write(stage, root / stage)
    return ArtifactReader({stage: root / stage for stage in _STAGES})


def clip_job(api: LiveApi, recording: bytes = b"of clips") -> str:
    """A finished job that clips can be made of; returns its id."""
    response = api.http.post("/v1/sites", json=site_of(corner_rig(CAMERAS)).model_dump(mode="json"))
    site = str(response.json()["id"])
    for camera_id in corner_rig(CAMERAS):
        api.upload(site, recording + camera_id.encode(), camera_id)
    job_id = str(api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"])
    publish(api, job_id, write)
    return job_id


def write(stage: str, folder: Path) -> None:
    """What a stage makes, into a folder."""
    writer = ArtifactWriter(stage, folder, made_by(stage))
    if stage == catalogue.RIG.stage:
        writer.write(catalogue.RIG, corner_rig(CAMERAS))
    if stage == catalogue.TRACKS.stage:
        writer.write(catalogue.TRACKS, tracks())
    if stage == catalogue.CONFLICTS.stage:
        writer.write(catalogue.CONFLICTS, Conflicts(thresholds={"ttc_s": 3.0}, conflicts=[CONFLICT]))
    if stage == catalogue.FRAMES.stage:
        grey = np.full((180, 320, 3), 110, np.uint8)
        with FrameStoreWriter(writer.new_file(catalogue.FRAMES), 90) as store:
            for time_ns in tracks()[0].times_ns.tolist():
                for camera_id, later in (("cam1", 0), ("cam2", LATER_NS)):
                    store.add(camera_id, time_ns, time_ns + later, grey)
            store.close(dict.fromkeys(corner_rig(CAMERAS), (640, 360)))
