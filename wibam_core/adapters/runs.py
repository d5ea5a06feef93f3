"""Runs of a network that is kept on new footage: what they work with, and how they are begun."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.job_store import JobStore, RunOf
from wibam_core.adapters.model_keeping import TRACK_ERRORS_FILE, USUAL_FILE, WEIGHTS_FILE
from wibam_core.adapters.model_store import ModelStore
from wibam_core.adapters.planning import plan_run
from wibam_core.adapters.site_store import SiteStore
from wibam_core.artifacts.catalogue import OPEN_TRACKS
from wibam_core.errors import Conflict, InputError, NotFound, StageError
from wibam_core.job_kind import JobKind
from wibam_core.jobs.records import Job, SiteRecord, StoredFile, recordings_of
from wibam_core.stages.graph import PlannedStage
from wibam_core.stages.store import StageStore, sha256_of


@dataclass(frozen=True)
class RunRequest:
    """What is to be run.

    Attributes:
        files: ids of footage, or of recordings, of one camera or several.
        site_id: None: that of the network.
        options: of the stages of a run.
        continues: the run before, of the same cameras: who is in view at the joint keeps their id.
        name, tags: of the job.
    """

    files: Sequence[str]
    options: Mapping[str, Any]
    site_id: str | None = None
    continues: str | None = None
    name: str = ""
    tags: Sequence[str] = ()


class Runs:
    """Begins runs.

    Args:
        models, jobs, sites, folder, stages: of the service.
    """

    def __init__(
        self, models: ModelStore, jobs: JobStore, sites: SiteStore, folder: DataFolder, stages: StageStore
    ) -> None:
        self._models = models
        self._jobs = jobs
        self._sites = sites
        self._folder = folder
        self._stages = stages

    def create(
        self, model_id: str, request: RunRequest, idempotency_key: str | None = None
    ) -> tuple[Job, list[StageKey]]:
        """A new run, and the stages to dispatch; with a key that was used before, the run it made, and nothing.

        Raises:
            NotFound: there is no such network, site, file or run.
            InputError: the files are no footage, or say of some only when they began.
            Conflict: the run to go on with has not ended well, or was of other cameras.
            UnknownOption, InvalidOption: naming the first option that is wrong.
        """
        model = self._models.model(model_id)
        record = self._sites.site(request.site_id or model.site_id)
        files = self._footage(record, request.files)
        cameras = recordings_of(files)
        chosen = tuple(camera for camera in record.site.cameras if camera.id in cameras)
        # the files are the run's own; those that the site lists are of the camera's recording
        chosen = tuple(camera.model_copy(update={"recordings": ()}) for camera in chosen)
        site = record.site.model_copy(update={"cameras": chosen})
        digests = {"model": model.sha256}
        digests |= {name: sha256_of(path) for name, path in _beside(self._folder, model.id).items()}
        if request.continues is not None:
            digests["open_tracks"] = sha256_of(self._to_go_on(request.continues, record.id, site.camera_ids))
        planned = plan_run(site, request.options, files, digests)
        of_run = SiteRecord(record.id, site, record.created_at)
        name = request.name or f"{model.name}, version {model.version}"
        return self._jobs.create(
            of_run,
            request.options,
            files,
            planned,
            idempotency_key,
            name[:200],
            RunOf(model.id, request.continues),
            request.tags,
        )

    def plan_again(self, run: Job, options: Mapping[str, Any]) -> tuple[PlannedStage, ...]:
        """The stages of a run that is to be restarted.

        Raises:
            NotFound: its network is gone.
        """
        assets = run_assets(run, self._folder, self._jobs, self._stages)
        return plan_run(run.site, options, run.files, {name: sha256_of(path) for name, path in assets.items()})

    def _footage(self, record: SiteRecord, ids: Sequence[str]) -> list[StoredFile]:
        there = {file.id: file for file in self._sites.footage(record.id)}
        missing = [file_id for file_id in ids if file_id not in there]
        if missing:
            raise NotFound(
                f"site {record.id} has no footage {missing[0]}",
                hint="List the footage of its cameras.",
                file=missing[0],
            )
        files = [there[file_id] for file_id in dict.fromkeys(ids)]
        dated = [file for file in files if file.started_ns is not None]
        if dated and len(dated) < len(files):
            undated = next(file for file in files if file.started_ns is None)
            raise InputError(
                f"it is known of {len(dated)} of {len(files)} files when they began, but not of {undated.filename}",
                hint="Say it of all files of a run, or of none.",
                file=undated.id,
            )
        return files

    def _to_go_on(self, run_id: str, site_id: str, cameras: Sequence[str]) -> Path:
        before = self._jobs.job(run_id)
        if before.kind is not JobKind.RUN or before.site_id != site_id or set(before.site.camera_ids) != set(cameras):
            raise Conflict(
                f"{run_id} is no run of the same cameras", hint="Go on with a run of the same site and cameras."
            )
        return _open_tracks(before, self._stages)


def run_assets(run: Job, folder: DataFolder, jobs: JobStore, stages: StageStore) -> dict[str, Path]:
    """The files that a run works with beside its footage, by name.

    Raises:
        StageError: the network is gone.
        Conflict: the run that it goes on with has no outputs any more.
    """
    assert run.model_id is not None, "a run has a network"
    weights = folder.model(run.model_id) / WEIGHTS_FILE
    if not weights.is_file():
        raise StageError(f"model {run.model_id} is gone", hint="Start another run, with a model that is there.")
    assets = {"model": weights} | _beside(folder, run.model_id)
    if run.continues is not None:
        assets["open_tracks"] = _open_tracks(jobs.job(run.continues), stages)
    return assets


def _beside(folder: DataFolder, model_id: str) -> dict[str, Path]:
    """What is kept of the place where a network was made, by the names of a run's assets."""
    known = {"usual": USUAL_FILE, "track_errors": TRACK_ERRORS_FILE}
    files = {name: folder.model(model_id) / file for name, file in known.items()}
    return {name: path for name, path in files.items() if path.is_file()}


def _open_tracks(run: Job, stages: StageStore) -> Path:
    stage = run.stage(OPEN_TRACKS.stage)
    folder = stages.find(stage.name, stage.hash) if stage is not None and stage.state.has_outputs else None
    if folder is None:
        raise Conflict(
            f"run {run.id} has not ended its tracking",
            hint="Wait until it has, or start the run without going on with it.",
            run=run.id,
        )
    return folder / OPEN_TRACKS.file
