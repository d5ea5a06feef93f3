"""Small recordings of a world whose grey level tells the time, and the stages that read them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.clocks import ClockMap
from wibam_core.config import FramesConfig, PreflightConfig
from wibam_core.formats.clocks import Clocks
from wibam_core.formats.framestore import FrameStore
from wibam_core.progress import Progress, silent
from wibam_core.site import HomographyCalibration, Site, SiteCamera
from wibam_core.stages import frames, preflight
from wibam_core.stages.base import StageContext
from wibam_core.video.encode import VideoWriter

S = 10**9
WIDTH, HEIGHT = 128, 72
#: The picture tells the true time: its grey level is 20 and 2 more for every 40 ms.
STEP_NS = 40_000_000


def picture(true_ns: int) -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), 20 + 2 * round(true_ns / STEP_NS), np.uint8)


def true_time_ns(image: np.ndarray) -> float:
    return (float(image.mean()) - 20) / 2 * STEP_NS


def record(path: Path, clock: ClockMap, first_ns: int, last_ns: int, dropped: frozenset[int] = frozenset()) -> Path:
    """25 fps of the world from ``first_ns`` to ``last_ns`` (reference clock), stamped with the camera's own clock."""
    with VideoWriter(path, WIDTH, HEIGHT, 25.0, 10) as writer:
        for number, true_ns in enumerate(range(first_ns, last_ns + 1, STEP_NS)):
            if number not in dropped:
                writer.write(picture(true_ns), int(clock.to_local_ns(true_ns)))
    return path


def site(camera_ids: tuple[str, ...], width_px: int = WIDTH, height_px: int = HEIGHT) -> Site:
    calibration = HomographyCalibration(correspondences=())
    return Site(
        name="test",
        cameras=tuple(
            SiteCamera(id=id_, width_px=width_px, height_px=height_px, calibration=calibration) for id_ in camera_ids
        ),
    )


class Run(StageFolders):
    """Runs stages one after the other in a folder."""

    def __init__(self, folder: Path, recordings: Mapping[str, Path], camera_ids: tuple[str, ...] = ()) -> None:
        super().__init__(folder)
        self.recordings = recordings
        self.site = site(camera_ids or tuple(recordings))

    def of(self, stage: str, assets: Mapping[str, Path] | None = None, progress: Progress = silent) -> StageContext:
        return self.context(stage, self.site, self.recordings, assets, progress)

    def preflight(self, **options: float) -> dict:
        return preflight.run(self.of("preflight"), PreflightConfig(**options))

    def frames(self, clocks: Mapping[str, ClockMap], **options: float) -> tuple[dict, FrameStore]:
        self.give(catalogue.CLOCKS, Clocks(clocks))
        summary = frames.run(self.of("frames"), FramesConfig(**options))
        return summary, self.read(catalogue.FRAMES)
