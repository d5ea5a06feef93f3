"""Ways of road users as each camera sees them on its own clock, before any clock is known."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from wibam_core.detection.detector import BUNDLED, load_detector
from wibam_core.detection.family import Detector
from wibam_core.documents.recordings import VideoInfo
from wibam_core.geometry.pixels import resized_px, scale_of, shrunk_image
from wibam_core.progress import Progress
from wibam_core.scene import CameraRig, Detections2D, FrameKey
from wibam_core.stages.base import StageContext
from wibam_core.sync.paths import GroundPath, ground_paths
from wibam_core.video.decode import OnePass

Image = NDArray[np.uint8]

#: Frames wider than this are shrunk before vehicles are looked for.
_WIDTH_PX = 960
_MIN_SCORE = 0.3
_NMS_IOU = 0.6


class Passing:
    """Ways of road users that pass the cameras; what was seen in a frame is kept, however often it is asked for.

    Args:
        context: whose recordings are opened.
        rig: where the cameras are.
        infos: camera id -> its recording.
    """

    def __init__(self, context: StageContext, rig: CameraRig, infos: Mapping[str, VideoInfo]) -> None:
        self._recordings, self._rig, self._infos = context.recordings, rig, infos
        self._seen: dict[FrameKey, Detections2D] = {}

    def paths(self, rate_hz: float, progress: Progress) -> dict[str, list[GroundPath]]:
        """Camera id -> ways of road users, from frames looked at ``rate_hz`` times a second of its own clock.

        ``progress`` is told how far all cameras are.
        """
        done = dict.fromkeys(self._infos, 0.0)
        lock = threading.Lock()

        def watch(camera_id: str) -> list[GroundPath]:
            seen: dict[str, list[Detections2D]] = {}
            for share, found in self._looked(camera_id, rate_hz):
                seen.setdefault(found.camera_id, []).append(found)
                with lock:
                    done[camera_id] = share
                    progress(sum(done.values()) / len(done), f"watching the traffic in {camera_id}")
            return [path for view_id, frames in seen.items() for path in ground_paths(frames, self._rig[view_id])]

        with ThreadPoolExecutor(2) as pool:
            return dict(zip(self._infos, pool.map(watch, self._infos), strict=True))

    def _looked(self, camera_id: str, rate_hz: float) -> Iterator[tuple[float, Detections2D]]:
        """How far the recording is, and what is seen in the next frame, or in the next view that is cut from it."""
        info, detector = self._infos[camera_id], load_detector(BUNDLED, min_score=_MIN_SCORE, nms_iou=_NMS_IOU)
        views = self._rig.views.get(camera_id, ())
        cutters = [view.cutter(self._rig.mounted[camera_id]) for view in views]
        one_pass = OnePass(self._recordings[camera_id], width_px=None if views else _WIDTH_PX)
        step_ns = max(round(1e9 / rate_hz), 1)
        last_ns: int | None = None
        for target_ns in range(info.first_ns, info.last_ns + 1, step_ns):
            frame = one_pass.nearest(target_ns, step_ns // 2)
            if frame is None or frame.time_ns == last_ns:
                continue
            last_ns = frame.time_ns
            share = (target_ns - info.first_ns) / max(info.last_ns - info.first_ns, 1)
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


def _detected(detector: Detector, key: FrameKey, image: Image, size_px: tuple[int, int]) -> Detections2D:
    found = detector.detect(image)
    scale = scale_of((image.shape[1], image.shape[0]), size_px, 4)
    return Detections2D(key.camera_id, key.local_ns, resized_px(found.boxes, scale), found.scores, found.classes)
