"""Recordings and signal regions to a clock map per camera."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from wibam_core.artifacts.catalogue import CHANGES, CLOCKS, PROBE
from wibam_core.config import SyncConfig
from wibam_core.documents.synchronisation import Synchronisation
from wibam_core.errors import MissingCamera, NoSignalChange
from wibam_core.formats.clocks import Clocks
from wibam_core.progress import Progress
from wibam_core.scene import ClockMap, SignalChange
from wibam_core.site import SiteCamera
from wibam_core.stages.base import StageContext, Summary
from wibam_core.sync.changes import detect_changes
from wibam_core.sync.document import ambiguities, doubts, sync_document
from wibam_core.sync.offsets import estimate_clocks
from wibam_core.video.decode import decode

Frame = tuple[int, NDArray[np.uint8]]

_DECODERS = 2
_FRAMES_PER_REPORT = 50


def run(context: StageContext, config: SyncConfig) -> Summary:
    """Write `CLOCKS` and `CHANGES`.

    Raises:
        NoSignalChange: naming a camera without a signal region, without a change in view, without one in common, or
            whose changes mostly meet none under any offset.
        MissingCamera: if a camera has no recording.
    """
    if config.method == "none":
        reference = context.site.camera_ids[0]
        context.write(CLOCKS, Clocks({camera_id: ClockMap() for camera_id in context.site.camera_ids}))
        context.write(CHANGES, Synchronisation(method="none", reference=reference, changes={}, groups=[], cameras={}))
        return {"method": "none"}

    changes = _detect_all(context, config)
    confident = {
        camera_id: [c for c in seen if c.confidence >= config.min_confidence] for camera_id, seen in changes.items()
    }
    spans_s = {c: (info.first_ns / 1e9, info.last_ns / 1e9) for c, info in context.read(PROBE).cameras.items()}
    result = estimate_clocks(confident, context.site.camera_ids[0], config.max_offset_s, spans_s)
    document = sync_document(changes, result)
    cautions = [*ambiguities(document), *doubts(document, config.max_offset_s)]
    context.write(CLOCKS, Clocks(result.clocks, result.errors))
    context.write(CHANGES, document)
    context.warn(*cautions)
    cameras = {camera_id: clock.model_dump() for camera_id, clock in document.cameras.items()}
    return {"method": "signals", "matched_changes": len(result.groups), "cameras": cameras}


def _detect_all(context: StageContext, config: SyncConfig) -> dict[str, list[SignalChange]]:
    cameras = context.site.cameras
    for camera in cameras:
        if not camera.signals:
            raise NoSignalChange(
                f"camera {camera.id} has no signal region",
                hint="Draw a region around a signal head in this camera, or set sync.method to 'none'.",
                camera=camera.id,
            )
        if camera.id not in context.recordings:
            raise MissingCamera(f"there is no recording for camera {camera.id}", camera=camera.id)
    recorded = context.read(PROBE).cameras
    ends_ns = {camera.id: (recorded[camera.id].first_ns, recorded[camera.id].last_ns) for camera in cameras}
    progress = _SharedProgress(context.progress, ends_ns)

    def detect(camera: SiteCamera) -> list[SignalChange]:
        size_px = (recorded[camera.id].width_px, recorded[camera.id].height_px)
        frames = progress.watch(camera.id, decode(context.recordings[camera.id], size_px=size_px))
        return detect_changes(frames, camera.id, camera.signals, config.min_lit_share)

    with ThreadPoolExecutor(_DECODERS) as pool:
        return dict(zip(context.site.camera_ids, pool.map(detect, cameras), strict=True))


class _SharedProgress:
    """How far all cameras are, told from several threads."""

    def __init__(self, listener: Progress, ends_ns: Mapping[str, tuple[int, int]]) -> None:
        self._listener, self._ends_ns = listener, ends_ns
        self._done = dict.fromkeys(ends_ns, 0.0)
        self._lock = threading.Lock()

    def watch(self, camera_id: str, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Pass ``frames`` on, telling how far they are."""
        first_ns, last_ns = self._ends_ns[camera_id]
        for number, frame in enumerate(frames):
            if number % _FRAMES_PER_REPORT == 0:
                self._tell(camera_id, (frame[0] - first_ns) / max(last_ns - first_ns, 1))
            yield frame
        self._tell(camera_id, 1.0)

    def _tell(self, camera_id: str, share: float) -> None:
        with self._lock:
            self._done[camera_id] = min(max(share, 0.0), 1.0)
            self._listener(sum(self._done.values()) / len(self._done), f"watching the signals in {camera_id}")
