"""What each view says about each vehicle: four image edges, and which of them may be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, FloatArray, IntArray, MultiViewVehicle

BoolArray = NDArray[np.bool_]

#: An edge this near to the image border is cut by it: this many px, and this share of the box's side.
_BORDER_PX = 1.5
_BORDER_SHARE = 0.04
#: An edge is hidden by a nearer box that covers at least this share of its length.
_HIDDEN_SHARE = 0.2
#: A nearer box counts as larger by this share of its sides, since boxes are never exact.
_OCCLUDER_MARGIN = 0.04


@dataclass(frozen=True, eq=False)
class Observations:
    """N vehicles at instants, each seen in up to V views; unused view slots are padded.

    Attributes:
        instants: (N,) index of the instant. vehicles: (N,) index of the vehicle in its instant.
        times_ns: (N,) the instant. tracks: (N,) track id or −1. classes: (N,) class indices.
        positions: (N, 2) of the cluster of rays, m.
        cameras: (N, V) number of the camera in the rig. seen: (N, V) whether the slot holds a view.
        boxes: (N, V, 4) xyxy, px.
        exact: (N, V, 4) whether the edge is the vehicle's own. An edge cut by the image border or hidden by a nearer
            vehicle only tells that the vehicle reaches at least so far.
        cut: (N, V, 2) whether the image border cuts the box across (left or right) and down (top or bottom).
        lateness_s: (N, V) exposure time after the instant.
    """

    instants: IntArray
    vehicles: IntArray
    times_ns: IntArray
    tracks: IntArray
    classes: IntArray
    positions: FloatArray
    cameras: IntArray
    seen: BoolArray
    boxes: FloatArray
    exact: BoolArray
    cut: BoolArray
    lateness_s: FloatArray

    def __len__(self) -> int:
        return len(self.instants)

    def where(self, keep: BoolArray | IntArray) -> Observations:
        """The selected vehicles."""
        return Observations(**{f.name: getattr(self, f.name)[keep] for f in fields(self)})


def observe(instants: Sequence[AnnotatedInstant], rig: CameraRig, min_views: int) -> Observations:
    """Collect every vehicle that at least ``min_views`` cameras see.

    Args:
        instants: associated.
        rig: one camera for every camera id in the instants.
        min_views: fewest views.
    """
    numbers = {camera_id: number for number, camera_id in enumerate(rig)}
    slots = len(rig)
    rows: list[tuple[int, int, MultiViewVehicle]] = []
    blocks: list[tuple[IntArray, BoolArray, FloatArray, BoolArray, BoolArray, FloatArray]] = []
    for index, instant in enumerate(instants):
        edges = {camera_id: _edges(seen, camera_id, instant, rig) for camera_id, seen in instant.detections.items()}
        for number, vehicle in enumerate(instant.vehicles):
            if len(vehicle.views) < min_views:
                continue
            rows.append((index, number, vehicle))
            blocks.append(_views(vehicle, instant, edges, numbers, slots))
    cameras, seen, boxes, exact, cut, lateness = (
        (np.stack(column) for column in zip(*blocks, strict=True)) if blocks else _no_views(slots)
    )
    return Observations(
        instants=np.array([i for i, _, _ in rows], dtype=np.int64),
        vehicles=np.array([n for _, n, _ in rows], dtype=np.int64),
        times_ns=np.array([instants[i].time_ns for i, _, _ in rows], dtype=np.int64),
        tracks=np.array([v.track_id for _, _, v in rows], dtype=np.int64),
        classes=np.array([v.vehicle_class.number for _, _, v in rows], dtype=np.int64),
        positions=np.array([(v.x_m, v.y_m) for _, _, v in rows], dtype=np.float64).reshape(-1, 2),
        cameras=cameras,
        seen=seen,
        boxes=boxes,
        exact=exact,
        cut=cut,
        lateness_s=lateness,
    )


def _no_views(slots: int) -> tuple[IntArray, BoolArray, FloatArray, BoolArray, BoolArray, FloatArray]:
    return (
        np.empty((0, slots), dtype=np.int64),
        np.empty((0, slots), dtype=bool),
        np.empty((0, slots, 4)),
        np.empty((0, slots, 4), dtype=bool),
        np.empty((0, slots, 2), dtype=bool),
        np.empty((0, slots)),
    )


def _views(
    vehicle: MultiViewVehicle,
    instant: AnnotatedInstant,
    edges: dict[str, tuple[BoolArray, BoolArray]],
    numbers: dict[str, int],
    slots: int,
) -> tuple[IntArray, BoolArray, FloatArray, BoolArray, BoolArray, FloatArray]:
    cameras = np.zeros(slots, dtype=np.int64)
    seen = np.zeros(slots, dtype=bool)
    boxes = np.tile([0.0, 0.0, 1.0, 1.0], (slots, 1))
    exact = np.zeros((slots, 4), dtype=bool)
    cut = np.zeros((slots, 2), dtype=bool)
    lateness = np.zeros(slots)
    for slot, (camera_id, row) in enumerate(vehicle.views.items()):
        detections = instant.detections[camera_id]
        cameras[slot] = numbers[camera_id]
        seen[slot] = True
        boxes[slot] = detections.boxes[row]
        exact[slot], cut[slot] = (part[row] for part in edges[camera_id])
        lateness[slot] = (detections.frame_time_ns - instant.time_ns) * 1e-9
    return cameras, seen, boxes, exact, cut, lateness


def _edges(
    detections: Detections2D, camera_id: str, instant: AnnotatedInstant, rig: CameraRig
) -> tuple[BoolArray, BoolArray]:
    """(N, 4) edges that neither the border cuts nor a nearer vehicle hides; (N, 2) axes on which the border cuts."""
    camera = rig[camera_id]
    distance = np.full(len(detections), np.inf)
    for vehicle in instant.vehicles:
        row = vehicle.views.get(camera_id)
        if row is not None:
            distance[row] = np.hypot(vehicle.x_m - camera.centre_m[0], vehicle.y_m - camera.centre_m[1])
    cut = cut_by_border(detections.boxes, camera.width_px, camera.height_px)
    return ~(cut | hidden_by_nearer(detections.boxes, distance)), cut[:, :2] | cut[:, 2:]


def cut_by_border(boxes: FloatArray, width_px: int, height_px: int) -> BoolArray:
    """Which edges (N, 4) of xyxy boxes (N, 4) touch the border of the image."""
    margin = _BORDER_PX + _BORDER_SHARE * (boxes[:, 2:] - boxes[:, :2])
    limits = np.array([width_px, height_px]) - 0.5
    return np.concatenate([boxes[:, :2] <= -0.5 + margin, boxes[:, 2:] >= limits - margin], axis=1)


def hidden_by_nearer(boxes: FloatArray, distance_m: FloatArray) -> BoolArray:
    """Which edges (N, 4) of xyxy boxes (N, 4) lie in the box of a vehicle that is nearer to the camera.

    Args:
        boxes: in one image, px.
        distance_m: (N,) from the camera; infinite where unknown, which hides nothing.
    """
    n = len(boxes)
    hidden = np.zeros((n, 4), dtype=bool)
    if n < 2:
        return hidden
    nearer = distance_m[None, :] < distance_m[:, None]
    margin = 1.0 + _OCCLUDER_MARGIN * (boxes[:, 2:] - boxes[:, :2])
    low, high = boxes[:, :2] - margin, boxes[:, 2:] + margin
    for side in range(4):
        axis, along = side % 2, 1 - side % 2
        at = boxes[:, side, None]
        reaches = (low[None, :, axis] <= at) & (at <= high[None, :, axis])
        shared = np.minimum(boxes[:, None, 2 + along], high[None, :, along]) - np.maximum(
            boxes[:, None, along], low[None, :, along]
        )
        length = np.maximum(boxes[:, 2 + along] - boxes[:, along], 1e-6)
        covered = shared / length[:, None] >= _HIDDEN_SHARE
        hidden[:, side] = (nearer & reaches & covered).any(axis=1)
    return hidden
