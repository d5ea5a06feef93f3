"""Recordings and signal regions to a clock map per camera."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wibam_core.artifacts.catalogue import CALIBRATED_RIG, CHANGES, CLOCKS, PROBE
from wibam_core.clocks import ClockMap, SignalChange
from wibam_core.config import SyncConfig
from wibam_core.documents.recordings import VideoInfo
from wibam_core.documents.synchronisation import Synchronisation
from wibam_core.errors import MissingCamera, NoSignalChange, UnknownClock
from wibam_core.formats.clocks import Clocks
from wibam_core.progress import Progress, part
from wibam_core.site import SiteCamera
from wibam_core.stages.base import StageContext, Summary
from wibam_core.stages.passing import Passing
from wibam_core.sync.changes import detect_changes
from wibam_core.sync.document import LEAST_SHARE, ambiguities, doubts, sync_document
from wibam_core.sync.segments import InSegments, Span, synchronise_segments
from wibam_core.video.decode import decode

Frame = tuple[int, NDArray[np.uint8]]

#: What places a segment no better than to a second.
_UNSURE = ("assumed", "creation_time", "name")
_DECODERS = 2
_FRAMES_PER_REPORT = 50


def run(context: StageContext, config: SyncConfig) -> Summary:
    """Write `CLOCKS` and `CHANGES`.

    Raises:
        NoSignalChange: the traffic is not asked, and a camera has no signal region, sees no change or none in common
            with others, or its changes mostly meet none under any offset.
        UnknownClock: neither lights nor traffic connect a camera with the others.
        MissingCamera: if a camera has no recording.
    """
    if config.method == "none":
        reference = context.site.camera_ids[0]
        context.write(CLOCKS, Clocks({camera_id: ClockMap() for camera_id in context.site.camera_ids}))
        context.write(CHANGES, Synchronisation(method="none", reference=reference, changes={}, groups=[], cameras={}))
        return {"method": "none"}

    for camera_id in context.site.camera_ids:
        if camera_id not in context.recordings:
            raise MissingCamera(f"there is no recording for camera {camera_id}", camera=camera_id)
    infos = {camera_id: context.read(PROBE).cameras[camera_id] for camera_id in context.site.camera_ids}
    changes: dict[str, list[SignalChange]] = {}
    if config.method != "traffic":
        whole = config.method == "signals"
        changes = _detect_all(context, config, whole, part(context.progress, 0.0, 1.0 if whole else 0.3))
    found = None if config.method in ("traffic", "both") else _by_lights(context, config, infos, changes)
    if found is None or not (config.method == "signals" or _is_sure(found)):
        decides = found is not None and found.found.is_ambiguous and _is_sound(found)
        found = _by_traffic(context, config, infos, changes, decides)
    context.progress(1.0)
    by_camera = found.found
    result = by_camera.result
    document = sync_document(changes, result, by_camera.traffic, by_camera.disagreeing, found.placed, found.assumed)
    cautions = [*ambiguities(document), *doubts(document, config.max_offset_s)]
    context.write(CLOCKS, Clocks(result.clocks, result.errors))
    context.write(CHANGES, document)
    context.warn(*cautions)
    cameras = {camera_id: clock.model_dump() for camera_id, clock in document.cameras.items()}
    return {"method": document.method, "matched_changes": len(result.groups), "cameras": cameras}


def _by_lights(
    context: StageContext,
    config: SyncConfig,
    infos: Mapping[str, VideoInfo],
    changes: Mapping[str, Sequence[SignalChange]],
) -> InSegments | None:
    """The lights' answer; None where they have none, and the traffic may be asked."""
    reference = context.site.camera_ids[0]
    confident = _confident(changes, config)
    alone = config.method == "signals"
    if not alone and any(not confident.get(camera_id) for camera_id in infos):
        return None
    try:
        return synchronise_segments(_segments_s(infos), reference, changes=confident, max_offset_s=config.max_offset_s)
    except NoSignalChange:
        if alone:
            raise
        return None


def _by_traffic(
    context: StageContext,
    config: SyncConfig,
    infos: Mapping[str, VideoInfo],
    changes: Mapping[str, Sequence[SignalChange]],
    decides: bool,
) -> InSegments:
    """What the traffic and the lights say together.

    Where it only ``decides`` between offsets that sound lights leave open, and the lights measure, every other frame is
    looked at first, and the others if that does not decide.
    """
    passing = Passing(context, context.read(CALIBRATED_RIG), infos)

    def asked(rate_hz: float, first: float, last: float) -> InSegments:
        return synchronise_segments(
            _segments_s(infos),
            context.site.camera_ids[0],
            changes=_confident(changes, config),
            paths=passing.paths(rate_hz, part(context.progress, first, last)),
            max_offset_s=config.max_offset_s,
        )

    if decides:
        with suppress(NoSignalChange, UnknownClock):
            found = asked(config.traffic_rate_hz / 2, 0.3, 0.65)
            if _is_sure(found) and not found.found.disagreeing:
                return found
    return asked(config.traffic_rate_hz, 0.65 if decides else 0.3, 1.0)


def _is_sure(found: InSegments) -> bool:
    return _is_sound(found) and not found.found.is_ambiguous


def _is_sound(found: InSegments) -> bool:
    """Whether most changes that could meet do, and no segment lies where it was only assumed to."""
    shares = [one.taken.share for one in found.found.result.alignments.values()]
    return min(shares, default=1.0) >= LEAST_SHARE and not any(found.assumed.values())


def _confident(changes: Mapping[str, Sequence[SignalChange]], config: SyncConfig) -> dict[str, list[SignalChange]]:
    return {
        camera_id: [c for c in seen if c.confidence >= config.min_confidence] for camera_id, seen in changes.items()
    }


def _segments_s(infos: Mapping[str, VideoInfo]) -> dict[str, list[Span]]:
    """Camera id -> stretches of its recording between which the time that passed is not known to a frame."""
    found: dict[str, list[Span]] = {}
    for camera_id, info in infos.items():
        begins = [info.first_ns, *(one.first_ns for one in info.segments[1:] if one.placed_by in _UNSURE)]
        ends = [*(one.last_ns for one, then in pairwise(info.segments) if then.placed_by in _UNSURE), info.last_ns]
        found[camera_id] = [(begin / 1e9, end / 1e9) for begin, end in zip(begins, ends, strict=True)]
    return found


def _detect_all(
    context: StageContext, config: SyncConfig, whole: bool, listener: Progress
) -> dict[str, list[SignalChange]]:
    """Changes by camera; with ``whole`` every camera must have a signal region, else those without are left out."""
    cameras = [camera for camera in context.site.cameras if whole or camera.signals]
    for camera in cameras:
        if not camera.signals:
            raise NoSignalChange(
                f"camera {camera.id} has no signal region",
                hint="Draw a region around a signal head in this camera, or set sync.method to 'auto' or 'traffic'.",
                camera=camera.id,
            )
    if not cameras:
        return {}
    recorded = context.read(PROBE).cameras
    ends_ns = {camera.id: (recorded[camera.id].first_ns, recorded[camera.id].last_ns) for camera in cameras}
    progress = _SharedProgress(listener, ends_ns)

    def detect(camera: SiteCamera) -> list[SignalChange]:
        size_px = (recorded[camera.id].width_px, recorded[camera.id].height_px)
        frames = progress.watch(camera.id, decode(context.recordings[camera.id], size_px=size_px))
        return detect_changes(frames, camera.id, camera.signals, config.min_lit_share)

    with ThreadPoolExecutor(_DECODERS) as pool:
        return dict(zip(ends_ns, pool.map(detect, cameras), strict=True))


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
