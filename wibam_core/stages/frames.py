"""Read the frames of all cameras at common instants, each frame once."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wibam_core.artifacts.catalogue import CALIBRATED_RIG, CLOCKS, FRAMES, LIMITS, PROBE, TIMESTAMPS
from wibam_core.clocks import ClockMap
from wibam_core.config import FramesConfig
from wibam_core.detection.background import BackgroundFrames
from wibam_core.documents.recordings import VideoInfo
from wibam_core.documents.warnings import Caution
from wibam_core.errors import InputError, NoOverlap
from wibam_core.formats.framestore import FrameStore, FrameStoreWriter, Size
from wibam_core.geometry.cut_view import Cutter, Image
from wibam_core.geometry.pixels import shrunk_image
from wibam_core.scene import CameraRig
from wibam_core.stages.base import StageContext, Summary
from wibam_core.stages.space import check_space
from wibam_core.video.decode import OnePass
from wibam_core.video.recording import Recording
from wibam_core.video.sampling import Span, common_instants, nearer_times, nearest_times, overlap_s, period_ns

_SECONDS_BETWEEN_REPORTS = 0.5
#: So many frames say how large all will be.
_FEWEST_TO_JUDGE = 32
#: More than this share of the wanted frames damaged is worth a word.
_DAMAGED_SHARE = 0.02
_HINT_ALONE = "Check that camera's recording and clock, or remove it from the site."


class _Target(NamedTuple):
    """A time on a camera's own clock whose nearest frame is looked for.

    Attributes:
        local_ns: the time.
        tolerance_ns: how far from it the frame may lie.
        instant_ns: the instant, reference clock, that the frame then belongs to. None: it may show the background.
    """

    local_ns: int
    tolerance_ns: int
    instant_ns: int | None


@dataclass
class _Camera:
    """One camera's work: its recording, its clock, all its frames, what is looked for, and how far it is.

    Attributes:
        pictures: id in the frame store -> what of a frame is stored by that id: a view, or, where there is None, all.
        sizes: the same ids -> size of these pictures before they are shrunk, px.
    """

    id: str
    recording: Recording
    clock: ClockMap
    info: VideoInfo
    times_ns: NDArray[np.int64]
    targets: list[_Target]
    pictures: Mapping[str, Cutter | None]
    sizes: Mapping[str, Size]
    damaged: set[int] = field(default_factory=set)
    stored: int = 0
    copied: int = 0
    seen: int = 0

    @property
    def instants(self) -> int:
        return sum(target.instant_ns is not None for target in self.targets)


def run(context: StageContext, config: FramesConfig) -> Summary:
    """Write a frame store: for each instant that two cameras span, the nearest frame of every camera.

    Of a camera with a wide lens it holds the views that are cut from its frames, each as if it were a camera.

    Beside these it holds the frames that may show a camera's background, which no clock and no rate changes. What
    earlier outputs hold is copied from there: a recording of which they hold all that is needed is not opened.

    Raises:
        NoOverlap: no two recordings show the same instant, or a camera shares too little time with every other one,
            or has no frame at any common instant.
        DiskFull: the first frames show that the disk will not hold all of them.
    """
    infos = context.read(PROBE).cameras
    clocks = context.read(CLOCKS)
    spans = {camera_id: _span(info, clocks[camera_id]) for camera_id, info in infos.items()}
    instants = common_instants(spans, config.rate_hz)
    if not len(instants):
        raise NoOverlap(
            f"no two recordings show the same instant: on the reference camera's clock they span {_seen(spans)}",
            spans_ns=_spans_ns(spans),
        )
    _check_shared(spans, infos, context.read(LIMITS).min_overlap_s)
    times = context.read(TIMESTAMPS)
    rig = context.read(CALIBRATED_RIG) if any(camera.is_wide for camera in context.site.cameras) else None
    cameras = [
        _camera(
            camera_id, context.recordings[camera_id], clocks[camera_id], info, times[camera_id], instants, config, rig
        )
        for camera_id, info in infos.items()
    ]
    earlier = _earlier(context)
    with FrameStoreWriter(context.new_file(FRAMES), config.jpeg_quality) as writer:
        _read_all(cameras, writer, earlier, config.width_px, context)
        _check_stored(cameras, len(instants))
        writer.close({picture: size for camera in cameras for picture, size in camera.sizes.items()})
    context.warn(*(caution for camera in cameras for caution in _cautions(camera)))
    return {
        "instants": len(instants),
        "seconds": round(float(instants[-1] - instants[0]) / 1e9, 3),
        "frames": {camera.id: camera.stored for camera in cameras},
        "without_frame": {camera.id: camera.instants - camera.stored for camera in cameras},
        "damaged": {camera.id: len(camera.damaged) for camera in cameras},
    }


def _span(info: VideoInfo, clock: ClockMap) -> Span:
    return Span(int(clock.to_reference_ns(info.first_ns)), int(clock.to_reference_ns(info.last_ns)))


def _check_shared(spans: Mapping[str, Span], infos: Mapping[str, VideoInfo], min_overlap_s: float) -> None:
    """Every camera shares time with another one, and enough of it: the last frame is shown for a period, too."""
    if len(spans) < 2:
        return
    shared_s = {
        camera_id: max(overlap_s({camera_id: span, other: spans[other]}) for other in spans if other != camera_id)
        for camera_id, span in spans.items()
    }
    alone = [camera_id for camera_id, seconds in shared_s.items() if seconds <= 0]
    if alone:
        raise NoOverlap(
            f"camera {', '.join(alone)} shares no time with any other: on the reference camera's clock the recordings "
            f"span {_seen(spans)}",
            hint=_HINT_ALONE,
            cameras=alone,
            spans_ns=_spans_ns(spans),
        )
    for camera_id, seconds in shared_s.items():
        if seconds + 1.0 / infos[camera_id].fps < min_overlap_s:
            raise NoOverlap(
                f"camera {camera_id} shares only {seconds:.1f} s with any other, of at least {min_overlap_s:g} s: on "
                f"the reference camera's clock the recordings span {_seen(spans)}",
                hint="Check that camera's recording and clock, record for longer, or lower preflight.min_overlap_s.",
                camera=camera_id,
                shared_s=seconds,
                spans_ns=_spans_ns(spans),
            )


def _check_stored(cameras: list[_Camera], instants: int) -> None:
    empty = [camera.id for camera in cameras if not camera.stored]
    if empty:
        raise NoOverlap(
            f"camera {', '.join(empty)} has no frame at any of the {instants} common instants",
            hint=_HINT_ALONE,
            cameras=empty,
        )


def _cautions(camera: _Camera) -> list[Caution]:
    share = len(camera.damaged) / max(len(camera.damaged) + camera.stored, 1)
    if share <= _DAMAGED_SHARE:
        return []
    caution = Caution(
        code="frames_damaged",
        message=f"{len(camera.damaged)} frames, {share:.0%} of those looked for, do not decode; the nearest sound ones "
        "are used where there are any",
        hint="Copy the file from the camera again; what is damaged there shows nothing.",
        details={"frames": len(camera.damaged), "share": share},
    )
    return [caution.of_camera(camera.id)]


def _seen(spans: Mapping[str, Span]) -> str:
    return "; ".join(f"{id_} {span.first_ns / 1e9:.1f} to {span.last_ns / 1e9:.1f} s" for id_, span in spans.items())


def _spans_ns(spans: Mapping[str, Span]) -> dict[str, list[int]]:
    return {camera_id: [span.first_ns, span.last_ns] for camera_id, span in spans.items()}


def _camera(
    camera_id: str,
    recording: Recording,
    clock: ClockMap,
    info: VideoInfo,
    times_ns: NDArray[np.int64],
    instants: NDArray[np.int64],
    config: FramesConfig,
    rig: CameraRig | None,
) -> _Camera:
    tolerance_ns = int(max(1e9 / info.fps, float(period_ns(config.rate_hz))) / 2)
    span = _span(info, clock)
    near = instants[(instants >= span.first_ns - tolerance_ns) & (instants <= span.last_ns + tolerance_ns)]
    local = clock.to_local_ns(near)
    tolerances_ns = _within_pieces(clock, local, tolerance_ns)
    of_background, background_tolerance_ns = BackgroundFrames.targets_ns(times_ns)
    targets = [
        _Target(time, tolerance, instant)
        for time, tolerance, instant in zip(local.tolist(), tolerances_ns.tolist(), near.tolist(), strict=True)
    ]
    targets += [_Target(time, background_tolerance_ns, None) for time in of_background.tolist()]
    targets.sort(key=lambda target: target.local_ns)
    pictures: dict[str, Cutter | None] = {camera_id: None}
    sizes = {camera_id: (info.width_px, info.height_px)}
    if rig is not None and camera_id in rig.views:
        views = rig.views[camera_id]
        pictures = {view.id: view.cutter(rig.mounted[camera_id]) for view in views}
        sizes = {view.id: (view.width_px, view.height_px) for view in views}
    return _Camera(camera_id, recording, clock, info, times_ns, targets, pictures, sizes)


def _within_pieces(clock: ClockMap, local_ns: NDArray[np.int64], tolerance_ns: int) -> NDArray[np.int64]:
    """How far from each time (N,) a frame may lie: not in another piece of the clock, where it may be hours away."""
    tolerances = np.full(local_ns.shape, tolerance_ns, dtype=np.int64)
    for piece in clock.pieces:
        room = np.where(local_ns < piece.from_ns, piece.from_ns - 1 - local_ns, local_ns - piece.from_ns)
        tolerances = np.minimum(tolerances, room)
    return tolerances


def _earlier(context: StageContext) -> list[FrameStore]:
    stores = []
    for outputs in context.earlier:
        with suppress(InputError):  # it was removed meanwhile
            stores.append(outputs.read(FRAMES))
    return stores


def _read_all(
    cameras: list[_Camera],
    writer: FrameStoreWriter,
    earlier: Sequence[FrameStore],
    width_px: int,
    context: StageContext,
) -> None:
    """Read cameras side by side (decoding and JPEG run outside the interpreter's lock), reporting from this thread."""
    stop = threading.Event()
    total = max(sum(len(camera.targets) for camera in cameras), 1)
    with ThreadPoolExecutor(max_workers=max(2, len(os.sched_getaffinity(0)))) as pool:
        pending: set[Future[None]] = {pool.submit(_read, camera, writer, earlier, width_px, stop) for camera in cameras}
        try:
            while pending:
                done, pending = wait(pending, timeout=_SECONDS_BETWEEN_REPORTS)
                for future in done:
                    future.result()
                stored, copied = (sum(counts) for counts in zip(*((c.stored, c.copied) for c in cameras), strict=True))
                message = f"{stored} frames, {copied} of them were there" if copied else f"{stored} frames"
                seen = sum(camera.seen for camera in cameras)
                if seen >= _FEWEST_TO_JUDGE:
                    written = writer.bytes_written
                    expected = check_space(context.new_file(FRAMES), written, _share_of_pixels(cameras, width_px))
                    message += f", {written / 1e9:.2f} of about {expected / 1e9:.2f} GB"
                context.progress(seen / total, message)
        finally:
            stop.set()


def _share_of_pixels(cameras: Sequence[_Camera], width_px: int) -> float:
    """How much of all pixels is dealt with: cameras of different sizes come one after another."""
    done, total = 0.0, 0.0
    for camera in cameras:
        pixels = sum(height * min(width, width_px) ** 2 / width for width, height in camera.sizes.values())
        done += camera.seen * pixels
        total += len(camera.targets) * pixels
    return done / total


def _read(
    camera: _Camera, writer: FrameStoreWriter, earlier: Sequence[FrameStore], width_px: int, stop: threading.Event
) -> None:
    cut = any(cutter is not None for cutter in camera.pictures.values())
    decoded_px = camera.info.width_px if cut else width_px
    native_px = (camera.info.width_px, camera.info.height_px)
    one_pass = OnePass(camera.recording, among=set(camera.times_ns.tolist()), size_px=native_px, width_px=decoded_px)
    for target, expected_ns in zip(camera.targets, _expected(camera, earlier), strict=True):
        if stop.is_set():
            return
        found_ns = expected_ns
        copied = expected_ns is not None and all(_copy(id_, expected_ns, earlier, writer) for id_ in camera.pictures)
        if expected_ns is not None and not copied:
            frame = one_pass.nearest(target.local_ns, target.tolerance_ns)
            found_ns = None if frame is None else frame.time_ns
            if frame is not None:
                for id_, cutter in camera.pictures.items():
                    writer.add_frame(id_, frame.time_ns, _picture(frame.image_bgr, cutter, width_px))
        camera.damaged.update(nearer_times(camera.times_ns, target.local_ns, found_ns, target.tolerance_ns))
        if found_ns is not None and target.instant_ns is not None:
            frame_time_ns = int(camera.clock.to_reference_ns(found_ns))
            for id_ in camera.pictures:
                writer.add_to_instant(target.instant_ns, id_, found_ns, frame_time_ns)
            camera.stored += 1
            camera.copied += copied
        camera.seen += 1
    for id_ in camera.pictures:
        writer.add_damaged(id_, camera.damaged)


def _picture(image: Image, cutter: Cutter | None, width_px: int) -> Image:
    return image if cutter is None else shrunk_image(cutter.cut(image), width_px)


def _expected(camera: _Camera, earlier: Sequence[FrameStore]) -> list[int | None]:
    """The frame nearest to each target, of all that are not known to be damaged; None where there is none."""
    damaged = [store.damaged_ns(id_) for store in earlier for id_ in camera.pictures]
    times_ns = np.setdiff1d(camera.times_ns, np.concatenate([np.empty(0, np.int64), *damaged]))
    targets_ns = np.array([target.local_ns for target in camera.targets], dtype=np.int64)
    return nearest_times(times_ns, targets_ns, np.array([target.tolerance_ns for target in camera.targets], np.int64))


def _copy(camera_id: str, local_ns: int, earlier: Sequence[FrameStore], writer: FrameStoreWriter) -> bool:
    """Copy a frame from where it is; returns whether it is anywhere."""
    for store in earlier:
        try:
            jpeg = store.jpeg_at(camera_id, local_ns)
        except (KeyError, InputError):  # not there, damaged, or removed meanwhile
            continue
        writer.add_jpeg(camera_id, local_ns, jpeg, store.size(camera_id))
        return True
    return False
