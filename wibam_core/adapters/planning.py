"""From a site, its files and options to the stages of a job."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from wibam_core.config import PipelineConfig
from wibam_core.errors import MissingCamera
from wibam_core.job_kind import JobKind
from wibam_core.jobs.records import StoredFile, recordings_of
from wibam_core.site import Site
from wibam_core.stages.graph import InputDigests, PlannedStage, downstream, plan
from wibam_core.stages.recording_files import digest_of_recording


def plan_stages(site: Site, options: Mapping[str, Any], files: Sequence[StoredFile]) -> tuple[PlannedStage, ...]:
    """All stages of a job, with the addresses of their outputs.

    Raises:
        UnknownOption: naming the first option that does not exist.
        InvalidOption: naming the first option that has a wrong value.
        MissingCamera: a camera has no recording, or not all files that the site lists.
        InputError: the options ask for a file that was not uploaded.
    """
    config = PipelineConfig.parse(options)
    recordings = recordings_of(files)
    assets = {file.purpose.value: file.sha256 for file in files if not file.purpose.is_of_camera}
    missing = [camera for camera in site.camera_ids if camera not in recordings]
    if missing:
        raise MissingCamera(f"there is no recording of {_names(missing)}", cameras=missing)
    for camera in site.cameras:
        there = {file.filename for file in recordings[camera.id]}
        awaited = [name for name in camera.recordings if name not in there]
        if awaited:
            raise MissingCamera(
                f"camera {camera.id}: {', '.join(awaited)} was not uploaded",
                hint="Upload all files that the site lists for the camera, or correct the list.",
                camera=camera.id,
                files=awaited,
            )
    return plan(site, config, InputDigests(recording_digests({c: recordings[c] for c in site.camera_ids}), assets))


def plan_run(
    site: Site, options: Mapping[str, Any], files: Sequence[StoredFile], assets: Mapping[str, str]
) -> tuple[PlannedStage, ...]:
    """All stages of a run, with the addresses of their outputs.

    Args:
        site: with just the cameras that there is footage of.
        options: as given.
        files: the footage.
        assets: SHA-256 of the network and of what goes along with it, by name (`wibam_core.stages.assets`).

    Raises:
        UnknownOption: naming the first option that does not exist.
        InvalidOption: naming the first option that has a wrong value.
    """
    inputs = InputDigests(recording_digests(recordings_of(files)), assets)
    return plan(site, PipelineConfig.parse(options), inputs, JobKind.RUN)


def recording_digests(recordings: Mapping[str, Sequence[StoredFile]]) -> dict[str, str]:
    """What each camera's recording is known by. When it began counts where that is known of all cameras."""
    dated = are_dated(file for files in recordings.values() for file in files)
    return {
        camera: digest_of_recording((f.filename, f.sha256, f.started_ns if dated else None) for f in files)
        for camera, files in recordings.items()
    }


def are_dated(files: Iterable[StoredFile]) -> bool:
    """Whether it is known of all recordings when they began; only then it counts: clocks are one, or each its own."""
    return all(file.started_ns is not None for file in files if file.purpose.is_of_camera)


def made_anew(plan: Sequence[PlannedStage], from_stage: str | None, still_wanted: Mapping[str, str]) -> set[str]:
    """The stages that a restart makes anew even if their outputs are there.

    Args:
        plan: of the job.
        from_stage: this one and all that follow from it; None for none.
        still_wanted: what an earlier restart asked to be made anew and was not, name by hash. Where the hash is another
            now, the outputs will be, too.

    Raises:
        UnknownOption: there is no stage ``from_stage``.
    """
    left = {planned.name for planned in plan if still_wanted.get(planned.name) == planned.hash}
    return left if from_stage is None else left.union(downstream(from_stage, plan))


def _names(cameras: Sequence[str]) -> str:
    return f"camera {cameras[0]}" if len(cameras) == 1 else f"cameras {', '.join(cameras)}"
