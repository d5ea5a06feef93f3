"""Frames of all cameras at common instants, straight from the recordings: nothing is stored.

Unlike in the stage `frames`, an instant counts that one camera alone shows: a camera that was off for a while does not
make the others blind. Each camera is decoded in a thread of its own, a few frames ahead.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.clocks import ClockMap
from wibam_core.documents.recordings import VideoInfo
from wibam_core.documents.watching import Stretch
from wibam_core.geometry.cut_view import Cutter
from wibam_core.scene import CameraRig
from wibam_core.video.decode import OnePass
from wibam_core.video.recording import Recording
from wibam_core.video.sampling import Span, multiples_within, period_ns

IntArray = NDArray[np.int64]
Image = NDArray[np.uint8]

#: Frames that may wait decoded, of each camera.
_AHEAD = 8
#: A shorter pause is no gap.
GAP_S = 2.0


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """A camera's frame at an instant. ``exposed_ns`` is its own time; both are on the reference clock."""

    camera_id: str
    instant_ns: int
    exposed_ns: int
    image: Image


@dataclass(frozen=True, eq=False)
class CameraFootage:
    """One camera's footage: its recording, what is known of it, and its clock."""

    id: str
    recording: Recording
    info: VideoInfo
    clock: ClockMap

    @property
    def stretches(self) -> list[Stretch]:
        """When it recorded, reference clock; pauses of less than two seconds aside."""
        pieces = [(piece.first_ns, piece.last_ns) for piece in self.info.segments]
        found: list[Stretch] = []
        for first_ns, last_ns in pieces or [(self.info.first_ns, self.info.last_ns)]:
            start, end = int(self.clock.to_reference_ns(first_ns)), int(self.clock.to_reference_ns(last_ns))
            if found and start - found[-1].to_ns < GAP_S * 1e9:
                start = found.pop().from_ns
            found.append(Stretch(from_ns=start, to_ns=end))
        return found


class Footage:
    """All cameras' frames in the order of time.

    Args:
        cameras: the footage.
        rate_hz: how many instants a second.
        rig: of its wide cameras the views are cut.
        after_ns: only instants after this time; None: all.
    """

    def __init__(
        self, cameras: Mapping[str, CameraFootage], rate_hz: float, rig: CameraRig, after_ns: int | None = None
    ) -> None:
        self._cameras = cameras
        self._rate_hz = rate_hz
        self._rig = rig
        spans = [
            multiples_within(Span(stretch.from_ns, stretch.to_ns), rate_hz)
            for camera in cameras.values()
            for stretch in camera.stretches
        ]
        instants = np.unique(np.concatenate(spans))
        done = 0 if after_ns is None else int(np.searchsorted(instants, after_ns, side="right"))
        #: (N,) when something may be seen.
        self.instants: IntArray = instants[done:]
        #: The last instant before these, if any: a slow camera's frame of then may be the nearest to the next one, too.
        self._before: IntArray = instants[max(done - 1, 0) : done]

    def frames(self) -> Iterator[SeenFrame]:
        """All frames in order of the instants, then of the cameras and views. Close it if it is not read to its end."""
        if not len(self.instants):
            return
        stop = threading.Event()
        sources = [_Ahead(self._of_camera(camera), stop) for camera in self._cameras.values()]
        try:
            waiting = [source.next() for source in sources]
            while any(frames is not None for frames in waiting):
                now = min(frames[0].instant_ns for frames in waiting if frames is not None)
                for number, frames in enumerate(waiting):
                    if frames is not None and frames[0].instant_ns == now:
                        yield from frames
                        waiting[number] = sources[number].next()
        finally:
            stop.set()
            for source in sources:
                source.join()

    def _of_camera(self, camera: CameraFootage) -> Iterator[list[SeenFrame]]:
        info, clock = camera.info, camera.clock
        tolerance_ns = int(max(1e9 / info.fps, float(period_ns(self._rate_hz))) / 2)
        cutters: dict[str, Cutter] = {
            view.id: view.cutter(self._rig.mounted[camera.id]) for view in self._rig.views.get(camera.id, ())
        }
        one_pass = OnePass(camera.recording, size_px=(info.width_px, info.height_px))
        local = clock.to_local_ns(self.instants)
        last_ns = None
        for local_ns in clock.to_local_ns(self._before).tolist():
            shown = one_pass.nearest(local_ns, tolerance_ns)
            last_ns = None if shown is None else shown.time_ns
        for instant_ns, local_ns in zip(self.instants.tolist(), local.tolist(), strict=True):
            found = one_pass.nearest(local_ns, tolerance_ns)
            if found is None or found.time_ns == last_ns:  # each frame once
                continue
            last_ns = found.time_ns
            exposed_ns = int(clock.to_reference_ns(found.time_ns))
            if not cutters:
                yield [SeenFrame(camera.id, instant_ns, exposed_ns, found.image_bgr)]
            else:
                yield [
                    SeenFrame(view_id, instant_ns, exposed_ns, cutter.cut(found.image_bgr))
                    for view_id, cutter in cutters.items()
                ]


class _Ahead:
    """An iterator that a thread runs ahead of whoever reads it."""

    def __init__(self, frames: Iterator[list[SeenFrame]], stop: threading.Event) -> None:
        self._frames = frames
        self._stop = stop
        self._ready: queue.Queue[list[SeenFrame] | BaseException | None] = queue.Queue(_AHEAD)
        self._thread = threading.Thread(target=self._run, name="footage", daemon=True)
        self._thread.start()

    def next(self) -> list[SeenFrame] | None:
        """The next frames, None at the end. Raises what the iterator raises."""
        found = self._ready.get()
        if isinstance(found, BaseException):
            raise found
        return found

    def join(self) -> None:
        self._thread.join()

    def _run(self) -> None:
        try:
            for frames in self._frames:
                if not self._put(frames):
                    return
            self._put(None)
        except BaseException as error:  # it is the reader's to deal with
            self._put(error)

    def _put(self, item: list[SeenFrame] | BaseException | None) -> bool:
        while not self._stop.is_set():
            try:
                self._ready.put(item, timeout=0.1)
            except queue.Full:
                continue
            return True
        return False
