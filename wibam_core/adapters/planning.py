"""From a site, its files and options to the stages of a job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from wibam_core.config import PipelineConfig
from wibam_core.errors import MissingCamera
from wibam_core.jobs.records import Purpose, StoredFile
from wibam_core.site import Site
from wibam_core.stages.graph import InputDigests, PlannedStage, plan


def plan_stages(site: Site, options: Mapping[str, Any], files: Sequence[StoredFile]) -> tuple[PlannedStage, ...]:
    """All stages of a job, with the addresses of their outputs.

    Raises:
        UnknownOption: naming the first option that does not exist.
        InvalidOption: naming the first option that has a wrong value.
        MissingCamera: a camera has no recording.
        InputError: the options ask for a file that was not uploaded.
    """
    config = PipelineConfig.parse(options)
    recordings = {file.camera_id: file.sha256 for file in files if file.purpose is Purpose.RECORDING}
    assets = {file.purpose.value: file.sha256 for file in files if file.purpose is not Purpose.RECORDING}
    missing = [camera for camera in site.camera_ids if camera not in recordings]
    if missing:
        raise MissingCamera(f"there is no recording of {_names(missing)}", cameras=missing)
    return plan(site, config, InputDigests({c: recordings[c] for c in site.camera_ids}, assets))


def _names(cameras: Sequence[str]) -> str:
    return f"camera {cameras[0]}" if len(cameras) == 1 else f"cameras {', '.join(cameras)}"
