"""The whole pipeline in this process: `wibam run` without any service."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from wibam_core.artifacts.access import ArtifactReader
from wibam_core.config import PipelineConfig
from wibam_core.costs import Pace
from wibam_core.documents.warnings import StageWarning
from wibam_core.errors import MissingCamera, NotFound, WibamError
from wibam_core.job_kind import JobKind
from wibam_core.progress import Progress
from wibam_core.site import Site
from wibam_core.stages import recording_files
from wibam_core.stages.assets import ASSETS
from wibam_core.stages.base import Summary
from wibam_core.stages.execute import StageRequest, run_stage
from wibam_core.stages.given import digest_of, given_stages
from wibam_core.stages.graph import STAGES, InputDigests, PlannedStage, plan
from wibam_core.stages.store import StageStore, sha256_of
from wibam_core.video.recording import Recording


@dataclass(frozen=True)
class SiteFolder:
    """A site on disk: its description and files, and the folders of stages that are given, by stage.

    Attributes:
        unclaimed: names of files and folders beside the recordings that are no camera's.
    """

    site: Site
    recordings: Mapping[str, Recording]
    assets: Mapping[str, Path]
    given: Mapping[str, Path] = field(default_factory=lambda: MappingProxyType({}))
    unclaimed: tuple[str, ...] = ()

    @classmethod
    def load(cls, folder: Path) -> SiteFolder:
        """Read ``site.json`` and find the recordings, the assets and what is given beside it.

        Recordings may be absent where every stage that reads them is given.

        Raises:
            SiteFileError: if the description is wrong, a camera has several recordings that nothing says belong
                together, or what is given for a stage is not what it makes.
            MissingCamera: if a camera has no recording, or not all files that the site lists.
        """
        site = Site.load(folder / "site.json")
        given = given_stages(folder)
        needed = any(spec.reads_recordings and spec.name not in given for spec in STAGES.values())
        recordings = {}
        for camera in site.cameras:
            recording = recording_files.find_recording(folder / "recordings", camera.id, camera.recordings)
            if recording is not None:
                recordings[camera.id] = recording
            elif needed:
                recording_files.check_elsewhere(folder / "recordings", camera.id)
                raise MissingCamera(f"there is no recording of camera {camera.id}", camera=camera.id)
        assets = {
            asset.name: folder / file
            for asset in ASSETS.values()
            for file in reversed(asset.files)
            if (folder / file).is_file()
        }
        return cls(site, recordings, assets, given, recording_files.unclaimed(folder / "recordings", site.cameras))

    def made(self, planned: PlannedStage, store: StageStore) -> Path | None:
        """The outputs of a stage, where they are given or the store holds them."""
        return self.given.get(planned.name) or store.find(planned.name, planned.hash)

    def digests(self) -> InputDigests:
        """SHA-256 of every file."""
        return InputDigests(
            {camera: _digest_of(recording) for camera, recording in self.recordings.items()},
            {name: sha256_of(path) for name, path in self.assets.items()},
            {stage: digest_of(path) for stage, path in self.given.items()},
        )


def _digest_of(recording: Recording) -> str:
    files = ((file.name, sha256_of(file.path), file.started_ns) for file in recording.files)
    return recording_files.digest_of_recording(files)


@dataclass(frozen=True)
class StageUpdate:
    """How a stage is doing. ``state`` is "running", "given", "reused", "succeeded" or "failed".

    The last update of a stage has its warnings, those of one that failed, too. ``remaining_s`` is how long
    a running stage will still take, and ``job_remaining_s`` how long that and all after it, where enough is known.
    """

    stage: str
    state: str
    fraction: float = 0.0
    message: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    warnings: Sequence[StageWarning] = ()
    remaining_s: float | None = None
    job_remaining_s: float | None = None


@dataclass(frozen=True)
class PipelineResult:
    """What the stages made, and their summaries and running times (s) by stage, in order."""

    outputs: ArtifactReader
    summaries: Mapping[str, Summary]
    seconds: Mapping[str, float]


def _progress_of(
    stage: str,
    pace: Pace,
    following: Sequence[str],
    listener: Callable[[StageUpdate], None],
    clock: Callable[[], float],
) -> Progress:
    """What a stage reports to; ``following`` are those that are to be made after it."""
    started = clock()

    def report(fraction: float, message: str = "", **figures: float) -> None:
        nonlocal started
        if fraction <= 0.0:  # what it has waited for others before says nothing of its pace
            started = clock()
        left_s = pace.stage_left_s(stage, clock() - started, fraction)
        parts = [left_s, *map(pace.stage_left_s, following)]
        job_s = None if any(part is None for part in parts) else sum(part for part in parts if part is not None)
        listener(StageUpdate(stage, "running", fraction, message, figures, remaining_s=left_s, job_remaining_s=job_s))

    return report


def run_pipeline(
    folder: SiteFolder,
    store: StageStore,
    config: PipelineConfig,
    listener: Callable[[StageUpdate], None] = lambda update: None,
    *,
    until: str | None = None,
    expected_s: Mapping[str, float] = MappingProxyType({}),
    clock: Callable[[], float] = time.monotonic,
    kind: JobKind = JobKind.TRAINING,
) -> PipelineResult:
    """Run every stage that the store does not hold yet, in order, up to and with ``until``.

    Args:
        folder: the site.
        store: where outputs are, and go.
        config: all options.
        listener: told how it goes.
        until: the last stage to run; None: all.
        expected_s: stage -> how long it is expected to take, see `wibam_core.costs`; says how long all will
            still take.
        clock: seconds, from any beginning.
        kind: of the job; a run needs the asset "model" in its folder.

    Raises:
        InputError: the options ask for a file that the folder lacks.
        InvalidOption: they ask for a device that this machine lacks.
        WibamError: of the stage that failed; finished stages stay in the store.
    """
    folders: dict[str, Path] = {}
    summaries: dict[str, Summary] = {}
    seconds: dict[str, float] = {}
    stages = plan(folder.site, config, folder.digests(), kind)
    store.remember({planned.name: planned.hash for planned in stages})
    if kind is JobKind.TRAINING and "finetune" not in folder.given:
        _check_device(stages, store, config, until)
    wanted = stages if until is None else stages[: 1 + [planned.name for planned in stages].index(until)]
    to_make = [planned.name for planned in wanted if folder.made(planned, store) is None]
    expected = {name: expected_s[name] for name in to_make if name in expected_s}
    for planned in wanted:
        name = planned.name
        pace = Pace(expected, {made: seconds[made] for made in to_make if made in seconds})
        following = to_make[to_make.index(name) + 1 :] if name in to_make else []
        report = _progress_of(name, pace, following, listener, clock)
        found = folder.made(planned, store)
        state = "given" if name in folder.given else "reused"
        if found is None:
            with store.turn(planned.hash, partial(report, 0.0, "another process runs this stage: waiting for it")):
                found = store.find(name, planned.hash)
                if found is None:
                    found = _made(folder, store, config, planned, folders, report, listener, clock, kind)
                    state = "succeeded"
        manifest = ArtifactReader({name: found}).manifest(name)
        folders[name], summaries[name], seconds[name] = found, manifest.summary, manifest.seconds
        listener(
            StageUpdate(
                name, state, 1.0, summary=manifest.summary, seconds=manifest.seconds, warnings=manifest.warnings
            )
        )
    return PipelineResult(ArtifactReader(folders), summaries, seconds)


def latest(folder: SiteFolder, store: StageStore) -> ArtifactReader:
    """What the latest `run_pipeline` has made so far.

    Raises:
        NotFound: there was none.
    """
    hashes = store.remembered()
    if not hashes:
        raise NotFound(f"nothing was run in {store.root} yet", hint="Run the site first: `wibam run SITE_DIR`.")
    folders = {name: folder.given.get(name) or store.find(name, hash) for name, hash in hashes.items()}
    return ArtifactReader({name: made for name, made in folders.items() if made is not None})


def _made(
    folder: SiteFolder,
    store: StageStore,
    config: PipelineConfig,
    planned: PlannedStage,
    folders: Mapping[str, Path],
    report: Progress,
    listener: Callable[[StageUpdate], None],
    clock: Callable[[], float],
    kind: JobKind,
) -> Path:
    """The published folder of a stage, run on those of the stages before."""
    name = planned.name
    attempt = store.begin(name, planned.hash, planned.frame_hash)
    request = StageRequest.of(attempt, folder.site, config, folder.recordings, folder.assets, folders, kind)
    warnings: list[StageWarning] = []
    report(0.0)
    started = clock()
    try:
        summary = run_stage(request, report, warnings.append)
        return store.publish(attempt, summary, clock() - started, warnings)
    except WibamError as error:
        listener(StageUpdate(name, "failed", message=error.message, warnings=warnings))
        raise
    finally:
        store.discard(attempt)


def _check_device(stages: Sequence[PlannedStage], store: StageStore, config: PipelineConfig, until: str | None) -> None:
    """Ask now, not after an hour of other stages, whether this machine can train where it is told to."""
    names = [stage.name for stage in stages]
    last = len(names) - 1 if until is None else names.index(until)
    training = names.index("finetune")
    if last >= training and store.find("finetune", stages[training].hash) is None:
        from wibam_core.training.device import choose_device  # torch takes seconds to import

        choose_device(config.finetune.device)
