"""Track vehicles over time: predict, assign, update; births and deaths; then smooth each track as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wibam_core.config import TrackConfig
from wibam_core.geometry.box3d import LENGTH, POSE, SIZE, XY, XYZ, YAW
from wibam_core.geometry.iou import bev_iou
from wibam_core.road_users import CLASSES
from wibam_core.scene import Track, Vehicles3D
from wibam_core.tracking.fusion import Fused, fuse, ground_distance
from wibam_core.tracking.models import model_of
from wibam_core.tracking.motion import Belief, Measurement, MotionModel, innovation, update
from wibam_core.tracking.trajectory import Hit, to_track

Array = NDArray[np.float64]

#: A measurement farther off (squared Mahalanobis distance of centre and yaw) is no candidate: 99.9 % of χ² with 3
#: degrees of freedom, doubled because the model is not the vehicle.
_MAX_DISTANCE = 32.0
#: A fused box that overlaps a track more than this and was not assigned to it is a second box of the same vehicle.
_DUPLICATE_IOU = 0.1
#: A new vehicle's speed is not known, so that it may be sought far away: its standard deviation counts as this at most.
_MAX_SPEED_SD = 10.0


@dataclass(eq=False)
class _Candidate:
    """A road user being tracked, of the class that most of what was seen of it votes for."""

    belief: Belief
    time_ns: int
    box: Array
    votes: Array
    hits: list[Hit] = field(default_factory=list)

    @property
    def model(self) -> MotionModel:
        return model_of(CLASSES[int(np.argmax(self.votes))], float(self.box[LENGTH]))

    def at(self, time_ns: int) -> Belief:
        return self.model.predict(self.belief, (time_ns - self.time_ns) * 1e-9)[0]


class Tracker:
    """Feed it instant by instant with `step`, then ask for `tracks`.

    Args:
        config: thresholds.
    """

    def __init__(self, config: TrackConfig) -> None:
        self._config = config
        self._active: list[_Candidate] = []
        self._ended: list[_Candidate] = []
        self._instants: list[int] = []

    def step(
        self, time_ns: int, detections: Sequence[Vehicles3D], frame_times_ns: Mapping[str, int] | None = None
    ) -> None:
        """Take in all cameras' detections of one instant, later than the one before.

        Args:
            time_ns: the instant.
            detections: one entry per camera.
            frame_times_ns: camera id -> when its frame was exposed; a moving vehicle that is already tracked is
                moved from there to the instant. Without it all frames were exposed at the instant.
        """
        self._instants.append(time_ns)
        self._end_unseen(time_ns)
        expected = [candidate.at(time_ns) for candidate in self._active]
        most_m = self._config.max_place_sd_m
        certain = [found.where(np.flatnonzero(~(found.sd[:, XY] > most_m).any(axis=1))) for found in detections]
        moved = [self._move(found, time_ns, frame_times_ns or {}, expected) for found in certain]
        fused = fuse(moved, self._config.fusion_radius_m)
        assigned = self._assign(time_ns, fused, expected)
        for row, column in assigned.items():
            self._update(self._active[row], expected[row], time_ns, fused, column)
        self._begin(time_ns, fused, set(assigned.values()))

    def tracks(self) -> list[Track]:
        """All tracks that were seen often enough, smoothed, numbered from 0 in the order of their first instant.

        Each has a state at every instant from its first to its last detection.
        """
        instants = np.array(self._instants, np.int64)
        kept = [c for c in (*self._ended, *self._active) if self._is_proven(c, instants)]
        kept.sort(key=lambda c: (c.hits[0].time_ns, tuple(c.hits[0].box)))
        return [to_track(number, candidate.hits, instants) for number, candidate in enumerate(kept)]

    def _is_proven(self, candidate: _Candidate, instants: NDArray[np.int64]) -> bool:
        hits = candidate.hits
        lasted = np.searchsorted(instants, hits[-1].time_ns) - np.searchsorted(instants, hits[0].time_ns) + 1
        return len(hits) >= max(self._config.min_hits, self._config.min_seen_share * int(lasted))

    # --- one instant --------------------------------------------------------------------------
    def _end_unseen(self, time_ns: int) -> None:
        unseen = [time_ns - c.hits[-1].time_ns > self._config.max_coast_s * 1e9 for c in self._active]
        self._ended += [c for c, gone in zip(self._active, unseen, strict=True) if gone]
        self._active = [c for c, gone in zip(self._active, unseen, strict=True) if not gone]

    def _move(
        self, found: Vehicles3D, time_ns: int, frame_times_ns: Mapping[str, int], expected: Sequence[Belief]
    ) -> Vehicles3D:
        """Detections as they would be at the instant, where the vehicle's speed is known."""
        late_s = (time_ns - frame_times_ns.get(str(found.camera_id), time_ns)) * 1e-9
        if late_s == 0 or not len(found) or not expected:
            return replace(found, time_ns=time_ns)
        boxes = found.boxes.copy()
        distance = ground_distance(boxes, self._expected_boxes(expected))
        nearest = distance.argmin(axis=1)
        for row, column in enumerate(nearest):
            mean = expected[column].mean
            if distance[row, column] <= self._config.gate_m and len(self._active[column].hits) > 1:
                boxes[row, XY] += late_s * self._active[column].model.travel(mean)[0]
        return replace(found, time_ns=time_ns, boxes=boxes)

    def _expected_boxes(self, expected: Sequence[Belief]) -> Array:
        boxes = np.array([c.box for c in self._active]).reshape(-1, 7)
        for row, (candidate, belief) in enumerate(zip(self._active, expected, strict=True)):
            boxes[row, POSE] = candidate.model.centre(belief)[0]
        return boxes

    def _assign(self, time_ns: int, fused: Fused, expected: Sequence[Belief]) -> dict[int, int]:
        """Candidate -> fused box. Candidates that have proved themselves choose first."""
        if not len(fused) or not expected:
            return {}
        cost = np.full((len(expected), len(fused)), np.inf)
        ground = ground_distance(self._expected_boxes(expected), fused.boxes)
        for row, (candidate, belief) in enumerate(zip(self._active, expected, strict=True)):
            model = candidate.model
            dt_s = (time_ns - candidate.time_ns) * 1e-9
            gate = self._config.gate_m + dt_s * min(model.speed_sd(belief), _MAX_SPEED_SD)
            for column in np.flatnonzero(ground[row] <= gate):
                difference, S, _ = innovation(model, belief, _measurement(time_ns, fused, int(column)))
                distance = float(difference @ np.linalg.solve(S, difference))
                if distance <= _MAX_DISTANCE:
                    cost[row, column] = distance + float(np.log(np.linalg.det(S)))
        proven = np.array([len(c.hits) >= min(3, self._config.min_hits) for c in self._active])
        assigned: dict[int, int] = {}
        for group in (np.flatnonzero(proven), np.flatnonzero(~proven)):
            free = np.setdiff1d(np.arange(len(fused)), list(assigned.values()))
            for i, j in _cheapest(cost[np.ix_(group, free)]):
                assigned[int(group[i])] = int(free[j])
        return assigned

    def _update(self, candidate: _Candidate, expected: Belief, time_ns: int, fused: Fused, column: int) -> None:
        candidate.belief = update(candidate.model, expected, _measurement(time_ns, fused, column))
        candidate.time_ns = time_ns
        candidate.hits.append(_hit(time_ns, fused, column))
        candidate.votes = candidate.votes + fused.votes[column]
        sizes = np.array([hit.box[SIZE] for hit in candidate.hits[-15:]])
        candidate.box = np.concatenate(
            [fused.boxes[column, XYZ], np.median(sizes, axis=0), fused.boxes[column, YAW, None]]
        )

    def _begin(self, time_ns: int, fused: Fused, taken: set[int]) -> None:
        known = [c for c in self._active if c.time_ns == time_ns]
        present = np.array([c.box for c in known]).reshape(-1, 7)
        for column in range(len(fused)):
            box = fused.boxes[column]
            if column in taken or (bev_iou(box[None], present) > _DUPLICATE_IOU).any():
                continue
            present = np.concatenate([present, box[None]])
            road_user = CLASSES[int(np.argmax(fused.votes[column]))]
            belief = model_of(road_user, float(box[LENGTH])).first_belief(_measurement(time_ns, fused, column))
            self._active.append(_Candidate(belief, time_ns, box, fused.votes[column], [_hit(time_ns, fused, column)]))


def _measurement(time_ns: int, fused: Fused, column: int) -> Measurement:
    return Measurement(time_ns, fused.boxes[column, POSE], fused.sd[column, POSE])


def _hit(time_ns: int, fused: Fused, column: int) -> Hit:
    return Hit(time_ns, fused.boxes[column], fused.sd[column], fused.votes[column], fused.headings[column])


def _cheapest(cost: Array) -> list[tuple[int, int]]:
    """Pairs with finite cost: the most of them, and of those the cheapest."""
    valid = np.isfinite(cost)
    if not valid.any():
        return []
    low = cost[valid].min()
    forbidden = 1.0 + 2.0 * float((cost[valid] - low + 1.0).sum())
    rows, columns = linear_sum_assignment(np.where(valid, cost - low + 1.0, forbidden))
    return [(int(r), int(c)) for r, c in zip(rows, columns, strict=True) if valid[r, c]]
