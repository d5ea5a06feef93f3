"""Read the frames of all cameras at common instants, once."""

from __future__ import annotations

import json
import os
import threading
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.config import FramesConfig
from wibam_core.errors import NoOverlap
from wibam_core.formats.clocks import read_clocks
from wibam_core.formats.framestore import FrameStoreWriter
from wibam_core.scene import ClockMap
from wibam_core.stages.base import StageContext, Summary
from wibam_core.video.decode import DecodeCount, frames_nearest
from wibam_core.video.probe import VideoInfo
from wibam_core.video.sampling import Span, common_instants, period_ns

_SECONDS_BETWEEN_REPORTS = 0.5


@dataclass
class _Camera:
    """One camera's work: its recording, its clock, the instants it covers, and how far it is."""

    id: str
    recording: Path
    clock: ClockMap
    info: VideoInfo
    instants_ns: NDArray[np.int64]
    tolerance_ns: int
    count: DecodeCount = field(default_factory=DecodeCount)
    stored: int = 0
    seen: int = 0


def run(context: StageContext, config: FramesConfig) -> Summary:
    """Write a frame store: for each instant that two cameras span, the nearest frame of every camera.

    Raises:
        NoOverlap: no two recordings show the same instant.
    """
    probed = json.loads((context.upstream["preflight"] / "probe.json").read_text(encoding="utf-8"))
    infos = {camera_id: VideoInfo(**values) for camera_id, values in probed.items()}
    clocks = read_clocks(context.upstream["sync"] / "clocks.json")
    spans = {camera_id: _span(info, clocks[camera_id]) for camera_id, info in infos.items()}
    instants = common_instants(spans, config.rate_hz)
    if not len(instants):
        seen = "; ".join(f"{id_} {s.first_ns / 1e9:.1f} to {s.last_ns / 1e9:.1f} s" for id_, s in spans.items())
        raise NoOverlap(
            f"no two recordings show the same instant: on the reference camera's clock they span {seen}",
            spans_ns={camera_id: [span.first_ns, span.last_ns] for camera_id, span in spans.items()},
        )
    cameras = [
        _camera(camera_id, context.recordings[camera_id], clocks[camera_id], info, instants, config.rate_hz)
        for camera_id, info in infos.items()
    ]
    with FrameStoreWriter(context.output, config.jpeg_quality) as writer:
        _read_all(cameras, writer, config.width_px, context)
        writer.close({camera.id: (camera.info.width_px, camera.info.height_px) for camera in cameras})
    return {
        "instants": len(instants),
        "seconds": round(float(instants[-1] - instants[0]) / 1e9, 3),
        "frames": {camera.id: camera.stored for camera in cameras},
        "without_frame": {camera.id: len(camera.instants_ns) - camera.stored for camera in cameras},
        "damaged": {camera.id: camera.count.damaged for camera in cameras},
    }


def _span(info: VideoInfo, clock: ClockMap) -> Span:
    return Span(int(clock.to_reference_ns(info.first_ns)), int(clock.to_reference_ns(info.last_ns)))


def _camera(
    camera_id: str, recording: Path, clock: ClockMap, info: VideoInfo, instants: NDArray[np.int64], rate_hz: float
) -> _Camera:
    tolerance_ns = int(max(1e9 / info.fps, float(period_ns(rate_hz))) / 2)
    span = _span(info, clock)
    near = instants[(instants >= span.first_ns - tolerance_ns) & (instants <= span.last_ns + tolerance_ns)]
    return _Camera(camera_id, recording, clock, info, near, tolerance_ns)


def _read_all(cameras: list[_Camera], writer: FrameStoreWriter, width_px: int, context: StageContext) -> None:
    """Read cameras side by side (decoding and JPEG run outside the interpreter's lock), reporting from this thread."""
    stop = threading.Event()
    total = max(sum(len(camera.instants_ns) for camera in cameras), 1)
    with ThreadPoolExecutor(max_workers=max(2, len(os.sched_getaffinity(0)))) as pool:
        pending: set[Future[None]] = {pool.submit(_read, camera, writer, width_px, stop) for camera in cameras}
        try:
            while pending:
                done, pending = wait(pending, timeout=_SECONDS_BETWEEN_REPORTS)
                for future in done:
                    future.result()
                stored = sum(camera.stored for camera in cameras)
                context.progress(sum(camera.seen for camera in cameras) / total, f"{stored} frames")
        finally:
            stop.set()


def _read(camera: _Camera, writer: FrameStoreWriter, width_px: int, stop: threading.Event) -> None:
    local = camera.clock.to_local_ns(camera.instants_ns)
    number_of = {int(target): number for number, target in enumerate(local)}
    nearest = frames_nearest(
        camera.recording, local.tolist(), tolerance_ns=camera.tolerance_ns, width_px=width_px, count=camera.count
    )
    for frame in nearest:
        if stop.is_set():
            return
        number = number_of[frame.target_ns]
        frame_time_ns = int(camera.clock.to_reference_ns(frame.time_ns))
        writer.add(camera.id, int(camera.instants_ns[number]), frame_time_ns, frame.image_bgr)
        camera.stored += 1
        camera.seen = number + 1
    camera.seen = len(camera.instants_ns)
