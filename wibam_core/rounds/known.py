"""How many of the vehicles that move a detector finds by itself.

Of those that stand it finds about as many, and nothing helps it with these. What moves is found beside the still
backgrounds, whatever it is, and what several cameras see of it at once is there. Agreement between views counts such
vehicles as found and says nothing of the others: all cameras overlook who stands and is of no kind that the detector
learned, so that none asks for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wibam_core.detection.instants import frame_of
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.rounds.seen import SAME_IOU
from wibam_core.rounds.world import Detected
from wibam_core.scene import AnnotatedInstant, FrameSet

#: Whoever is as fast as this over so long, before and after together, moves: places of clusters of rays jump.
_MOVING_MPS, _AROUND_S = 2.0, 1.0
#: Fewer sightings say nothing.
_FEWEST_SIGHTINGS = 20


def share_known(
    frames: Sequence[FrameSet], instants: Sequence[AnnotatedInstant], of_detector: Detected
) -> float | None:
    """Of the boxes of vehicles that move and that several cameras see at once, the share that a detector has one of.

    Args:
        frames: of each instant.
        instants: with their vehicles, whatever found their boxes.
        of_detector: what the detector found in all frames.

    Returns:
        A share, or None where there are too few such boxes.
    """
    known = asked = 0
    moving = _moving(instants)
    for number, (of, instant) in enumerate(zip(frames, instants, strict=True)):
        for camera_id, seen in instant.detections.items():
            rows = [
                vehicle.views[camera_id]
                for vehicle in instant.vehicles
                if camera_id in vehicle.views and len(vehicle.views) > 1 and (vehicle.track_id, number) in moving
            ]
            own = image_iou(seen.boxes[rows], of_detector[frame_of(of, camera_id)].boxes).max(axis=1, initial=0.0)
            known, asked = known + int((own > SAME_IOU).sum()), asked + len(rows)
    return known / asked if asked >= _FEWEST_SIGHTINGS else None


def _moving(instants: Sequence[AnnotatedInstant]) -> set[tuple[int, int]]:
    """Tracks, and numbers of the instants at which they move."""
    ways: dict[int, list[tuple[int, float, float]]] = {}
    for number, instant in enumerate(instants):
        for vehicle in instant.vehicles:
            if vehicle.track_id >= 0:
                ways.setdefault(vehicle.track_id, []).append((number, vehicle.x_m, vehicle.y_m))
    times_s = np.array([(instant.time_ns - instants[0].time_ns) * 1e-9 for instant in instants])
    found = set()
    for track, rows in ways.items():
        numbers, x, y = np.array(rows).T
        at_s = times_s[numbers.astype(int)]
        first_s, last_s = np.maximum(at_s - _AROUND_S / 2, at_s[0]), np.minimum(at_s + _AROUND_S / 2, at_s[-1])
        made_m = np.hypot(*(np.interp(last_s, at_s, axis) - np.interp(first_s, at_s, axis) for axis in (x, y)))
        moves = (last_s > first_s) & (made_m >= _MOVING_MPS * (last_s - first_s))
        found |= {(track, number) for number in numbers[moves].astype(int).tolist()}
    return found
