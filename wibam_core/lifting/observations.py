"""What each view says about each vehicle: four image edges, and which of them may be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.boxes2d import sides_px
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.occlusion import hidden_edges, stands_before
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, FloatArray, IntArray

BoolArray = NDArray[np.bool_]

#: Standard deviation of an edge of a good detector: this many px, and this share of the box's side, added in squares.
_EDGE_SD_PX = 1.0
_EDGE_SD_SHARE = 0.03
#: An edge that states a standard deviation is never better than this, px.
_LEAST_EDGE_SD_PX = 0.3
#: An edge this near to the image border is cut by it: this many px, and this share of the box's side.
_BORDER_PX = 1.5
_BORDER_SHARE = 0.04
#: An edge is hidden by a nearer box that covers at least this share of its length.
_HIDDEN_SHARE = 0.2
#: A nearer box counts as larger on each side, since boxes are never exact: this many px, and this share of its side.
_OCCLUDER_PX, _OCCLUDER_SHARE = 1.0, 0.04


@dataclass(frozen=True, eq=False)
class Observations:
    """N vehicles at instants, each seen in up to V views; unused view slots are padded.

    Attributes:
        instants: (N,) index of the instant. vehicles: (N,) index of the vehicle in its instant.
        times_ns: (N,) the instant. tracks: (N,) track id or −1. classes: (N,) class indices.
        positions: (N, 2) of the cluster of rays, m.
        cameras: (N, V) number of the camera in the rig. seen: (N, V) whether the slot holds a view.
        boxes: (N, V, 4) xyxy, px: amodal where known.
        edge_sd: (N, V, 4) standard deviations of their edges, px.
        exact: (N, V, 4) whether the edge is the vehicle's own. An edge cut by the image border, or one of a box of what
            is seen that a nearer vehicle hides, only tells that the vehicle reaches at least so far.
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
    edge_sd: FloatArray
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
    rows = [
        (index, number, vehicle)
        for index, instant in enumerate(instants)
        for number, vehicle in enumerate(instant.vehicles)
        if len(vehicle.views) >= min_views
    ]
    n, slots = len(rows), len(rig)
    found = Observations(
        instants=np.array([i for i, _, _ in rows], dtype=np.int64),
        vehicles=np.array([n for _, n, _ in rows], dtype=np.int64),
        times_ns=np.array([instants[i].time_ns for i, _, _ in rows], dtype=np.int64),
        tracks=np.array([v.track_id for _, _, v in rows], dtype=np.int64),
        classes=np.array([v.vehicle_class.number for _, _, v in rows], dtype=np.int64),
        positions=np.array([(v.x_m, v.y_m) for _, _, v in rows], dtype=np.float64).reshape(-1, 2),
        cameras=np.zeros((n, slots), dtype=np.int64),
        seen=np.zeros((n, slots), dtype=bool),
        boxes=np.tile([0.0, 0.0, 1.0, 1.0], (n, slots, 1)),
        edge_sd=np.ones((n, slots, 4)),
        exact=np.zeros((n, slots, 4), dtype=bool),
        cut=np.zeros((n, slots, 2), dtype=bool),
        lateness_s=np.zeros((n, slots)),
    )
    edges: dict[str, _Edges] = {}
    edges_of = -1
    for number, (index, _, vehicle) in enumerate(rows):
        instant = instants[index]
        if index != edges_of:
            edges = {camera_id: _edges(seen, rig[camera_id], instant) for camera_id, seen in instant.detections.items()}
            edges_of = index
        for slot, (camera_id, row) in enumerate(vehicle.views.items()):
            at = number, slot
            found.cameras[at], found.seen[at] = numbers[camera_id], True
            found.boxes[at], found.edge_sd[at], found.exact[at], found.cut[at] = (p[row] for p in edges[camera_id])
            found.lateness_s[at] = (instant.detections[camera_id].frame_time_ns - instant.time_ns) * 1e-9
    return found


class _Edges(NamedTuple):
    """Of N boxes of one image, as in `Observations`: boxes and edge_sd (N, 4), exact (N, 4), cut (N, 2)."""

    boxes: FloatArray
    sd: FloatArray
    exact: BoolArray
    cut: BoolArray


def _edges(detections: Detections2D, camera: Camera, instant: AnnotatedInstant) -> _Edges:
    distance = np.full(len(detections), np.inf)
    for vehicle in instant.vehicles:
        row = vehicle.views.get(detections.camera_id)
        if row is not None:
            distance[row] = np.hypot(vehicle.x_m - camera.centre_m[0], vehicle.y_m - camera.centre_m[1])
    boxes, known = detections.whole_boxes, np.isfinite(detections.amodal_sd)
    cut = cut_by_border(boxes, camera.width_px, camera.height_px)
    seen = detections.boxes
    grown = seen + (_OCCLUDER_PX + _OCCLUDER_SHARE * np.tile(sides_px(seen), 2)) * [-1, -1, 1, 1]
    hidden = hidden_edges(seen, stands_before(distance), _HIDDEN_SHARE, grown) & ~known
    usual = np.hypot(_EDGE_SD_PX, _EDGE_SD_SHARE * np.tile(sides_px(boxes), 2))
    sd = np.where(known, np.hypot(_LEAST_EDGE_SD_PX, detections.amodal_sd), usual)
    return _Edges(boxes, sd, ~(cut | hidden), cut[:, :2] | cut[:, 2:])


def cut_by_border(boxes: FloatArray, width_px: int, height_px: int) -> BoolArray:
    """Which edges (N, 4) of xyxy boxes (N, 4) touch the border of the image."""
    margin = _BORDER_PX + _BORDER_SHARE * sides_px(boxes)
    limits = np.array([width_px, height_px]) - 0.5
    return np.concatenate([boxes[:, :2] <= -0.5 + margin, boxes[:, 2:] >= limits - margin], axis=1)
