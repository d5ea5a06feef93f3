"""OpenTrafficCam's tracks in the image of a camera: one ``.ottrk`` file a camera, JSON compressed with bzip2.

The layout is that of OTVision 2 (``ottrk_version`` 1.1, ``otdet_version`` 1.2), which OTAnalytics reads: ``metadata``
of the video, of the detector and of the tracker, and ``data.detections``, a list of boxes ``x``, ``y``, ``w``, ``h`` in
px from the top left corner of the image, each with the number of its frame (from 1), the POSIX time of its
``occurrence`` and the ``track-id``. ``first`` and ``finished`` mark the ends of a track.
"""

from __future__ import annotations

import bz2
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wibam_core.exchange import motion
from wibam_core.exchange.base import Content, Part, require_parts
from wibam_core.exchange.boxes import corner_xywh
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import Detections2D

_OTTRK_VERSION = "1.1"
_OTDET_VERSION = "1.2"
#: The container that a recording is taken to have; a site does not say it.
_FILETYPE = ".mp4"
#: OTAnalytics tells the tracks of different runs apart by these.
_RUN_ID = "wibam"
_FRAME_GROUP = 0


class Ottrk:
    """The format, for the registry."""

    name = "ottrk"
    title = "OpenTrafficCam tracks (.ottrk)"
    writes = frozenset({Part.BOXES_2D})
    needs = frozenset({Part.BOXES_2D})
    loses = (
        "Everything but the boxes, in each camera's image, that were linked over time, with their classes and scores. "
        "Frames are those that were analysed; recordings are said to begin at 1970-01-01 00:00 UTC, since nothing says "
        "when they did."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """See `wibam_core.exchange.base.ExchangeFormat.write`."""
        require_parts(self, content)
        instants = content.instants or ()
        seen: dict[str, list[tuple[Detections2D, dict[int, tuple[int, RoadUserClass]]]]] = {}
        for instant in instants:
            for camera_id, detections in instant.detections.items():
                linked = {
                    vehicle.views[camera_id]: (vehicle.track_id, vehicle.vehicle_class)
                    for vehicle in instant.vehicles
                    if vehicle.track_id >= 0 and camera_id in vehicle.views
                }
                seen.setdefault(camera_id, []).append((detections, linked))
        paths = []
        for camera_id, frames in seen.items():
            frames.sort(key=lambda frame: frame[0].frame_time_ns)
            times_ns = np.array([detections.frame_time_ns for detections, _ in frames], np.int64)
            period_ns = motion.frame_period_ns([times_ns])
            numbers = 1 + motion.frame_numbers(times_ns, period_ns)
            document = {
                "metadata": _metadata(camera_id, content.size_px(camera_id), 1e9 / period_ns, int(numbers[-1])),
                "data": {"detections": _detections(camera_id, frames, numbers.tolist())},
            }
            paths.append(folder / f"{camera_id}.ottrk")
            with bz2.open(paths[-1], "wt", encoding="utf-8") as file:
                json.dump(document, file, allow_nan=False)
        return paths


def _metadata(camera_id: str, size_px: tuple[int, int], rate_hz: float, number_of_frames: int) -> dict[str, Any]:
    width_px, height_px = size_px
    end_s = number_of_frames / rate_hz
    return {
        "otdet_version": _OTDET_VERSION,
        "ottrk_version": _OTTRK_VERSION,
        "video": {
            "filename": camera_id,
            "filetype": _FILETYPE,
            "width": width_px,
            "height": height_px,
            "recorded_fps": rate_hz,
            "actual_fps": rate_hz,
            "number_of_frames": number_of_frames,
            "recorded_start_date": 0.0,
            "expected_duration": end_s,
        },
        "detection": {
            "otvision_version": "",
            "model": {
                "name": "WIBAM",
                "weights": "",
                "classes": {str(c.number): c.traits.elsewhere.opentrafficcam for c in CLASSES},
            },
            "normalized_bbox": False,
        },
        "tracking": {
            "otvision_version": "",
            "first_tracked_video_start": 0.0,
            "last_tracked_video_end": end_s,
            "tracker": {"name": "WIBAM"},
            "tracking_run_id": _RUN_ID,
            "frame_group": _FRAME_GROUP,
        },
    }


def _detections(
    camera_id: str,
    frames: Sequence[tuple[Detections2D, dict[int, tuple[int, RoadUserClass]]]],
    numbers: Sequence[int],
) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    last: dict[int, dict[str, Any]] = {}
    for (detections, linked), number in zip(frames, numbers, strict=True):
        boxes = corner_xywh(detections.boxes).tolist()
        for index, (track_id, road_user) in sorted(linked.items()):
            x, y, w, h = boxes[index]
            found.append(
                {
                    "class": road_user.traits.elsewhere.opentrafficcam,
                    "confidence": float(detections.scores[index]),
                    "x": x,
                    "y": y,
                    "w": w,
                    "h": h,
                    "frame": number,
                    "occurrence": detections.frame_time_ns * 1e-9,
                    "input_file_path": f"{camera_id}{_FILETYPE}",
                    "interpolated-detection": False,
                    "first": track_id not in last,
                    "finished": False,
                    "track-id": track_id,
                }
            )
            last[track_id] = found[-1]
    for detection in last.values():
        detection["finished"] = True
    return found
