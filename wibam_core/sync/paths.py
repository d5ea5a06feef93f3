"""Ways of road users over the ground, as one camera sees them on its own clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wibam_core.association.rays import ground_covariances, ground_points, within_range
from wibam_core.association.tracklets import tracklets
from wibam_core.geometry.camera import Camera
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant, Detections2D, FloatArray

#: Ground points farther from the camera than this say little: a pixel is metres there.
_RANGE_M = 60.0
#: A road user that is not found for longer begins anew.
_GAP_S = 1.0
#: Ways shorter than this say nothing of speed.
_LEAST_SAMPLES = 5
#: Places and speeds are those of a parabola through what lies within this of a sample.
_WINDOW_S = 0.7
#: Boxes that end within this share of the image's width of its border are cut: their middle is not that of the vehicle.
_BORDER_SHARE = 0.015


@dataclass(frozen=True, eq=False)
class GroundPath:
    """One road user's way.

    Attributes:
        times_s: (T,) ascending, on the camera's own clock.
        points_m: (T, 2) in the world, smoothed over time.
        velocities_mps: (T, 2).
        sd_m: (T,) how uncertain a place is along the camera's ray.
    """

    times_s: FloatArray
    points_m: FloatArray
    velocities_mps: FloatArray
    sd_m: FloatArray

    def __len__(self) -> int:
        return len(self.times_s)


def ground_paths(seen: Sequence[Detections2D], camera: Camera) -> list[GroundPath]:
    """Ways of the vehicles that one camera sees.

    Args:
        seen: frames of the camera in order of time; ``frame_time_ns`` is on the camera's own clock.
        camera: that saw them.
    """
    if not seen:
        return []
    instants = [AnnotatedInstant(frame.frame_time_ns, {frame.camera_id: frame}) for frame in seen]
    numbers = [found[seen[0].camera_id] for found in tracklets(instants, [seen[0].camera_id], _GAP_S)]
    origin_s = seen[0].frame_time_ns / 1e9
    rows = []
    for frame, of in zip(seen, numbers, strict=True):
        if not len(frame):
            continue
        points = ground_points(camera, frame.whole_boxes, frame.classes)
        usable = within_range(points, camera.centre_m[:2], _RANGE_M) & ~_cut(frame, camera)
        usable &= np.array([not CLASSES[c].traits.vulnerable for c in frame.classes])
        since_s = np.full(len(frame), (frame.frame_time_ns / 1e9) - origin_s)
        sd_m = np.full(len(frame), np.nan)
        spread = ground_covariances(camera, frame.whole_boxes[usable], frame.classes[usable], points[usable])
        sd_m[usable] = np.sqrt(np.linalg.eigvalsh(spread)[:, -1])
        rows.append(np.column_stack([of, since_s, points, sd_m])[usable])
    if not rows:
        return []
    table = np.concatenate(rows)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    bounds = np.flatnonzero(np.diff(table[:, 0], prepend=-1.0))
    ways = np.split(table, bounds[1:])
    return [_smoothed(way[:, 1] + origin_s, way[:, 2:4], way[:, 4]) for way in ways if len(way) >= _LEAST_SAMPLES]


def _cut(frame: Detections2D, camera: Camera) -> np.ndarray:
    boxes = frame.boxes
    margin_px = _BORDER_SHARE * camera.width_px
    far = np.array([camera.width_px, camera.height_px]) - 1 - margin_px
    return np.asarray((boxes[:, :2] < margin_px).any(axis=1) | (boxes[:, 2:] > far).any(axis=1))


def _smoothed(times_s: FloatArray, points_m: FloatArray, sd_m: FloatArray) -> GroundPath:
    """Local parabolas by least squares, three samples at least."""
    places, speeds = np.empty_like(points_m), np.empty_like(points_m)
    for k, now_s in enumerate(times_s):
        since = times_s - now_s
        reach = max(_WINDOW_S, float(np.sort(np.abs(since))[2]))
        near = np.abs(since) <= reach + 1e-9
        weight = 1.0 - 0.9 * (np.abs(since[near]) / (reach * 1.05)) ** 2
        degree = 2 if near.sum() >= 5 else 1
        design = since[near, None] ** np.arange(degree + 1)
        fit = np.linalg.lstsq(design * weight[:, None], points_m[near] * weight[:, None], rcond=None)[0]
        places[k], speeds[k] = fit[0], fit[1]
    return GroundPath(times_s, places, speeds, sd_m)
