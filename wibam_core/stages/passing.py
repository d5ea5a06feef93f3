"""What recordings show on their own clocks, before any clock is known: lights that change, road users that pass."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wibam_core.artifacts.catalogue import CALIBRATED_RIG
from wibam_core.detection.detector import BUNDLED, load_detector
from wibam_core.detection.family import Detector
from wibam_core.documents.recordings import VideoInfo
from wibam_core.geometry.pixels import resized_px, scale_of, shrunk_image
from wibam_core.progress import Progress
from wibam_core.scene import Detections2D, FrameKey
from wibam_core.stages.base import StageContext
from wibam_core.sync.changes import SignalWatch
from wibam_core.sync.paths import GroundPath, ground_paths
from wibam_core.video.decode import OnePass, Watcher

Image = NDArray[np.uint8]
Made = TypeVar("Made")

#: Frames wider than this are shrunk before vehicles are looked for.
_WIDTH_PX = 960
_MIN_SCORE = 0.3
_NMS_IOU = 0.6
#: How often it is told how far a recording is of which no frame is searched, ns.
_STEP_NS = 1_000_000_000


class Passing:
    """Looks at the recordings; what was seen in a frame is kept, however often it is asked for.

    Args:
        context: whose recordings are opened, and whose calibration places road users.
        infos: camera id -> its recording.
    """

    def __init__(self, context: StageContext, infos: Mapping[str, VideoInfo]) -> None:
        self._context, self._infos = context, infos
        self._seen: dict[FrameKey, Detections2D] = {}

    def lights(self, lights: Mapping[str, SignalWatch], progress: Progress) -> None:
        """Show every frame of the cameras that have ``lights`` to these, and search none."""
        told = _Told(progress, lights, "the signals")

        def watch(camera_id: str) -> None:
            info = self._infos[camera_id]
            one_pass = self._one_pass(camera_id, lights, None)
            for target_ns in range(info.first_ns, info.last_ns + 1, _STEP_NS):
                one_pass.pass_to(target_ns)
                told.of(camera_id, _share(info, target_ns))
            one_pass.finish()

        _each(watch, lights)

    def paths(
        self, rate_hz: float, progress: Progress, lights: Mapping[str, SignalWatch] | None = None
    ) -> dict[str, list[GroundPath]]:
        """Camera id -> ways of road users, from frames looked at ``rate_hz`` times a second of its own clock.

        ``progress`` is told how far all cameras are. Cameras that have ``lights`` show every frame to these on the way.
        """
        told = _Told(progress, self._infos, "the signals and the traffic" if lights else "the traffic")
        rig = self._context.read(CALIBRATED_RIG)

        def watch(camera_id: str) -> list[GroundPath]:
            seen: dict[str, list[Detections2D]] = {}
            for share, found in self._looked(camera_id, rate_hz, lights or {}):
                seen.setdefault(found.camera_id, []).append(found)
                told.of(camera_id, share)
            return [path for view_id, frames in seen.items() for path in ground_paths(frames, rig[view_id])]

        return _each(watch, self._infos)

    def _one_pass(self, camera_id: str, lights: Mapping[str, SignalWatch], width_px: int | None) -> OnePass:
        info, watch = self._infos[camera_id], lights.get(camera_id)
        watcher = None if watch is None else Watcher(watch.windows, (info.width_px, info.height_px), watch.add)
        return OnePass(self._context.recordings[camera_id], width_px=width_px, watcher=watcher)

    def _looked(
        self, camera_id: str, rate_hz: float, lights: Mapping[str, SignalWatch]
    ) -> Iterator[tuple[float, Detections2D]]:
        """How far the recording is, and what is seen in the next frame, or in the next view that is cut from it."""
        info, detector = self._infos[camera_id], load_detector(BUNDLED, min_score=_MIN_SCORE, nms_iou=_NMS_IOU)
        rig = self._context.read(CALIBRATED_RIG)
        views = rig.views.get(camera_id, ())
        cutters = [view.cutter(rig.mounted[camera_id]) for view in views]
        one_pass = self._one_pass(camera_id, lights, None if views else _WIDTH_PX)
        step_ns = max(round(1e9 / rate_hz), 1)
        last_ns: int | None = None
        for target_ns in range(info.first_ns, info.last_ns + 1, step_ns):
            frame = one_pass.nearest(target_ns, step_ns // 2)
            if frame is None or frame.time_ns == last_ns:
                continue
            last_ns = frame.time_ns
            share = _share(info, target_ns)
            if not views:
                key, size = FrameKey(camera_id, frame.time_ns), (info.width_px, info.height_px)
                if key not in self._seen:
                    self._seen[key] = _detected(detector, key, frame.image_bgr, size)
                yield share, self._seen[key]
            for view, cutter in zip(views, cutters, strict=True):
                key = FrameKey(view.id, frame.time_ns)
                if key not in self._seen:
                    image = shrunk_image(cutter.cut(frame.image_bgr), _WIDTH_PX)
                    self._seen[key] = _detected(detector, key, image, (view.width_px, view.height_px))
                yield share, self._seen[key]
        one_pass.finish()


class _Told:
    """How far all cameras are, told from several threads."""

    def __init__(self, progress: Progress, camera_ids: Iterable[str], what: str) -> None:
        self._progress, self._what = progress, what
        self._done = dict.fromkeys(camera_ids, 0.0)
        self._lock = threading.Lock()

    def of(self, camera_id: str, share: float) -> None:
        with self._lock:
            self._done[camera_id] = share
            self._progress(sum(self._done.values()) / len(self._done), f"watching {self._what} in {camera_id}")


def _each(watch: Callable[[str], Made], camera_ids: Iterable[str]) -> dict[str, Made]:
    """Camera id -> what watching it gives; as many at a time as there are cores."""
    ids = list(camera_ids)
    with ThreadPoolExecutor(max(2, len(os.sched_getaffinity(0)))) as pool:
        return dict(zip(ids, pool.map(watch, ids), strict=True))


def _share(info: VideoInfo, at_ns: int) -> float:
    return (at_ns - info.first_ns) / max(info.last_ns - info.first_ns, 1)


def _detected(detector: Detector, key: FrameKey, image: Image, size_px: tuple[int, int]) -> Detections2D:
    found = detector.detect(image)
    scale = scale_of((image.shape[1], image.shape[0]), size_px, 4)
    return Detections2D(key.camera_id, key.local_ns, resized_px(found.boxes, scale), found.scores, found.classes)
