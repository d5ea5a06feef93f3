"""Track vehicles over time: predict, assign, update; births and deaths; then smooth each track as a whole."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wibam_core.config import TrackConfig
from wibam_core.geometry.box3d import LENGTH, POSE, SIZE, XY
from wibam_core.geometry.iou import bev_iou
from wibam_core.road_users import CLASSES, may_be_one
from wibam_core.scene import Track, Vehicles3D
from wibam_core.tracking.fusion import REACH, Detected, Fused, fuse, ground_distance
from wibam_core.tracking.models import WALKS, model_of
from wibam_core.tracking.motion import STATES, Belief, Measurement, MotionModel, innovation, squared_distance, update
from wibam_core.tracking.trajectory import Hit, came_nowhere, seen_often, to_tracks

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: A measurement farther off (squared Mahalanobis distance of centre and yaw) is no candidate: 99.9 % of χ² with 3
#: degrees of freedom, doubled because the model is not the vehicle.
_MAX_DISTANCE = 32.0
#: A fused box that overlaps a track more than this and was not assigned to it is a second box of the same vehicle.
_DUPLICATE_IOU = 0.1
#: A new vehicle's speed is not known, so that it may be sought far away: its standard deviation counts as this at most.
_MAX_SPEED_SD = 10.0
#: Slower than this somebody stands, m/s.
_STANDING_MPS = 0.7
#: A tracked road user is as large as the median of so many of its latest boxes.
_LATEST_SIZES = 15
#: How many numbers each array of a hit has.
_HIT_WIDTHS = {"box": 7, "sd": 7, "votes": len(CLASSES), "headings": 2}


@dataclass(frozen=True, eq=False)
class _Candidates:
    """C road users being tracked, each of the class that most of what was seen of it votes for.

    Attributes:
        belief: about each when it was seen last. times_ns: (C,) when that was.
        boxes: (C, 7) then, of the size that it has.
        votes: (C, classes). sizes: (C, _LATEST_SIZES, 3) of its latest boxes, infinite where there were fewer.
        seen: (C,) how often each was seen in all.
        hits: what was seen of each, as far as it is remembered: at least the last.
    """

    belief: Belief
    times_ns: Indices
    boxes: Array
    votes: Array
    sizes: Array
    seen: Indices
    hits: tuple[list[Hit], ...]

    @classmethod
    def none(cls) -> _Candidates:
        return cls(
            Belief(np.empty((0, STATES)), np.empty((0, STATES, STATES))),
            np.empty(0, np.int64),
            np.empty((0, 7)),
            np.empty((0, len(CLASSES))),
            np.empty((0, _LATEST_SIZES, 3)),
            np.empty(0, np.int64),
            (),
        )

    @classmethod
    def first_seen(cls, time_ns: int, fused: Fused, columns: Indices) -> _Candidates:
        boxes, votes = fused.boxes[columns], fused.votes[columns]
        sizes = np.full((len(columns), _LATEST_SIZES, 3), np.inf)
        sizes[:, 0] = boxes[:, SIZE]
        return cls(
            model_of(votes.argmax(axis=1), boxes[:, LENGTH]).first_belief(_measurements(fused, columns)),
            np.full(len(columns), time_ns),
            boxes,
            votes,
            sizes,
            np.ones(len(columns), np.int64),
            tuple([_hit(time_ns, fused, column)] for column in columns.tolist()),
        )

    @property
    def classes(self) -> Indices:
        """(C,) what most votes are for, indices into `wibam_core.road_users.CLASSES`."""
        return self.votes.argmax(axis=1)

    @property
    def model(self) -> MotionModel:
        return model_of(self.classes, self.boxes[:, LENGTH])

    def where(self, keep: NDArray[np.bool_]) -> _Candidates:
        return _Candidates(
            self.belief.where(keep),
            self.times_ns[keep],
            self.boxes[keep],
            self.votes[keep],
            self.sizes[keep],
            self.seen[keep],
            tuple(hits for hits, kept in zip(self.hits, keep, strict=True) if kept),
        )

    def with_more(self, more: _Candidates) -> _Candidates:
        return _Candidates(
            Belief(
                np.concatenate([self.belief.mean, more.belief.mean]),
                np.concatenate([self.belief.covariance, more.belief.covariance]),
            ),
            np.concatenate([self.times_ns, more.times_ns]),
            np.concatenate([self.boxes, more.boxes]),
            np.concatenate([self.votes, more.votes]),
            np.concatenate([self.sizes, more.sizes]),
            np.concatenate([self.seen, more.seen]),
            self.hits + more.hits,
        )

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """All that is known of them: arrays by name, without objects."""
        hits = [hit for of_one in self.hits for hit in of_one]
        return {
            "mean": self.belief.mean,
            "covariance": self.belief.covariance,
            "times_ns": self.times_ns,
            "boxes": self.boxes,
            "votes": self.votes,
            "sizes": self.sizes,
            "seen": self.seen,
            "hits": np.array([len(of_one) for of_one in self.hits], np.int64),
            "hit_times_ns": np.array([hit.time_ns for hit in hits], np.int64),
            **{
                f"hit_{name}": np.array([getattr(hit, name) for hit in hits]).reshape(len(hits), width)
                for name, width in _HIT_WIDTHS.items()
            },
        }

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> _Candidates:
        """What `to_arrays` gave.

        Raises:
            ValueError: they have another shape.
        """
        none, count = cls.none().to_arrays(), len(arrays["hits"])
        for name, like in none.items():
            found = arrays[name]
            rows = int(arrays["hits"].sum()) if name.startswith("hit_") else count
            if found.shape != (rows, *like.shape[1:]) or found.dtype != like.dtype:
                raise ValueError(f"{name} has shape {found.shape} and type {found.dtype}")
        every = [
            Hit(int(time_ns), *of_one)
            for time_ns, *of_one in zip(
                arrays["hit_times_ns"], *(arrays[f"hit_{name}"] for name in _HIT_WIDTHS), strict=True
            )
        ]
        ends = np.cumsum(arrays["hits"]).tolist()
        return cls(
            Belief(arrays["mean"].copy(), arrays["covariance"].copy()),
            arrays["times_ns"].copy(),
            arrays["boxes"].copy(),
            arrays["votes"].copy(),
            arrays["sizes"].copy(),
            arrays["seen"].copy(),
            tuple(every[first:last] for first, last in pairwise([0, *ends])),
        )

    def see(self, rows: Indices, belief: Belief, time_ns: int, fused: Fused, columns: Indices) -> None:
        """Candidates ``rows`` were seen as the fused boxes ``columns``, after which this is believed of them."""
        self.belief.mean[rows], self.belief.covariance[rows] = belief.mean, belief.covariance
        self.times_ns[rows] = time_ns
        walked = WALKS[self.classes[rows]]
        self.votes[rows] += fused.votes[columns]
        self.sizes[rows, self.seen[rows] % _LATEST_SIZES] = fused.boxes[columns, SIZE]
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            self.hits[row].append(_hit(time_ns, fused, column))
        self.seen[rows] += 1
        self.boxes[rows] = fused.boxes[columns]
        self.boxes[rows, SIZE] = _medians(self.sizes[rows], np.minimum(self.seen[rows], _LATEST_SIZES))
        # of those that are taken for another class now, the states of its model of motion may mean other things
        for row in rows[WALKS[self.classes[rows]] != walked].tolist():
            anew = _filtered(self.hits[row], int(self.classes[row]), float(self.boxes[row, LENGTH]))
            self.belief.mean[row], self.belief.covariance[row] = anew.mean, anew.covariance


class Tracker:
    """Feed it instant by instant with `step`, then ask for `tracks`.

    Args:
        config: thresholds.
    """

    def __init__(self, config: TrackConfig) -> None:
        self._config = config
        self._active = _Candidates.none()
        self._ended: list[list[Hit]] = []
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
        model = self._active.model
        # who stands is still there: after a while no less sure
        hidden_s = np.minimum((time_ns - self._active.times_ns) * 1e-9, self._config.max_coast_s)
        expected, _ = model.predict(self._active.belief, hidden_s)
        places = self._active.boxes.copy()
        places[:, POSE] = model.centre(expected.mean)[0]

        exposed = frame_times_ns or {}
        late_s = np.array([(time_ns - exposed.get(str(found.camera_id), time_ns)) * 1e-9 for found in detections])
        detected = Detected.of(detections)
        uncertain = detected.sd[:, XY] > self._config.max_place_sd_m
        detected = detected.where(np.flatnonzero(~uncertain.any(axis=1)))
        moved = self._moved(detected, late_s[detected.cameras], places, model.travel(expected.mean)[0])
        fused = fuse(moved, self._config.fusion_radius_m)

        cost = self._costs(fused, model, expected, places, hidden_s)
        rows, columns = self._assigned(cost)
        updated = update(model.where(rows), expected.where(rows), _measurements(fused, columns))
        self._active.see(rows, updated, time_ns, fused, columns)
        self._begin(time_ns, fused, columns)

    @property
    def instants(self) -> Indices:
        """(N,) the instants that are remembered."""
        return np.array(self._instants, np.int64)

    @property
    def active(self) -> tuple[list[Hit], ...]:
        """What was seen of each that is still followed. What is taken off the front of one is forgotten."""
        return self._active.hits

    def take_ended(self) -> list[list[Hit]]:
        """What was seen of those that are followed no longer, and were not taken yet."""
        ended, self._ended = self._ended, []
        return ended

    def forget_instants(self, before_ns: int) -> None:
        """Remember no instant before this time: no track that is still to be had was there."""
        self._instants = self._instants[bisect_left(self._instants, before_ns) :]

    def is_proven(self, hits: Sequence[Hit]) -> bool:
        """Whether a road user was seen often enough, at instants that are remembered, to be one."""
        return self._is_proven(hits, self.instants)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Those that are still followed, and the instants, for `go_on`; nothing may have ended that was not taken."""
        assert not self._ended, "take what has ended first"
        return {"instants": self.instants, **self._active.to_arrays()}

    def go_on(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Follow those again that another tracker followed when it gave these arrays.

        Raises:
            ValueError: they have another shape than this version's.
        """
        self._active = _Candidates.of_arrays(arrays)
        self._instants = arrays["instants"].tolist()

    def tracks(self) -> list[Track]:
        """All tracks that were seen often enough, smoothed, numbered from 0 in the order of their first instant.

        Each has a state at every instant from its first to its last detection.
        """
        instants = np.array(self._instants, np.int64)
        kept = [hits for hits in (*self._ended, *self._active.hits) if self._is_proven(hits, instants)]
        kept.sort(key=lambda hits: (hits[0].time_ns, tuple(hits[0].box)))
        return to_tracks(kept, instants)

    def _is_proven(self, hits: Sequence[Hit], instants: Indices) -> bool:
        return seen_often(hits, instants, self._config.min_hits, self._config.min_seen_share)

    # --- one instant --------------------------------------------------------------------------
    def _end_unseen(self, time_ns: int) -> None:
        speeds = np.hypot(*self._active.model.travel(self._active.belief.mean)[0].T)
        unseen_s = (time_ns - self._active.times_ns) * 1e-9
        unseen = unseen_s > self._config.max_coast_s
        if not unseen.any():
            return
        stands = speeds < _STANDING_MPS
        for row in np.flatnonzero(unseen & ~stands).tolist():
            stands[row] = came_nowhere(self._active.hits[row][-2:], self._config.max_coast_s, _STANDING_MPS)
        may_hide = stands & (self._active.seen >= self._config.min_hits)
        unseen &= ~may_hide | (unseen_s > self._config.max_coast_standing_s)
        if unseen.any():
            self._ended += self._active.where(unseen).hits
            self._active = self._active.where(~unseen)

    def _moved(self, detected: Detected, late_s: Array, places: Array, velocities: Array) -> Detected:
        """Detections as they would be at the instant, ``late_s`` (N,) later, where the vehicle's speed is known.

        The candidates, of which these are the boxes (C, 7) and velocities (C, 2), say how fast it is.
        """
        if not len(detected) or not len(places):
            return detected
        distance = ground_distance(detected.boxes, places)
        distance[~may_be_one(detected.classes, self._active.classes)] = np.inf
        nearest = distance.argmin(axis=1)
        known = (distance[np.arange(len(nearest)), nearest] <= self._config.gate_m) & (self._active.seen[nearest] > 1)
        boxes = detected.boxes.copy()
        boxes[known, XY] += late_s[known, None] * velocities[nearest[known]]
        return replace(detected, boxes=boxes)

    def _costs(self, fused: Fused, model: MotionModel, expected: Belief, places: Array, hidden_s: Array) -> Array:
        """(C, K) what it costs to take each fused box for each candidate, infinite where it is none."""
        gates = REACH[self._active.classes] * self._config.gate_m
        gates += hidden_s * np.minimum(model.speed_sd(expected), _MAX_SPEED_SD)
        near = ground_distance(places, fused.boxes) <= gates[:, None]
        near &= may_be_one(self._active.classes, fused.classes)
        rows, columns = np.nonzero(near)
        difference, S, _ = innovation(model.where(rows), expected.where(rows), _measurements(fused, columns))
        distance = squared_distance(difference, S)
        cost = np.full(near.shape, np.inf)
        cost[rows, columns] = np.where(distance <= _MAX_DISTANCE, distance + np.log(np.linalg.det(S)), np.inf)
        return cost

    def _assigned(self, cost: Array) -> tuple[Indices, Indices]:
        """Candidates and the fused box of each. Candidates that have proved themselves choose first."""
        proven = self._active.seen >= min(3, self._config.min_hits)
        free = np.arange(cost.shape[1])
        pairs = []
        for group in (np.flatnonzero(proven), np.flatnonzero(~proven)):
            i, j = _cheapest(cost[np.ix_(group, free)])
            pairs.append((group[i], free[j]))
            free = np.delete(free, j)
        rows, columns = (np.concatenate(of) for of in zip(*pairs, strict=True))
        return rows, columns

    def _begin(self, time_ns: int, fused: Fused, taken: Indices) -> None:
        """Fused boxes that are no candidate's become new ones, but for second boxes of the same vehicle."""
        free = np.delete(np.arange(len(fused)), taken)
        boxes = fused.boxes[free]
        classes, now = fused.classes[free], self._active.times_ns == time_ns
        again = may_be_one(classes, self._active.classes[now])
        apart = ~(again & (bev_iou(boxes, self._active.boxes[now]) > _DUPLICATE_IOU)).any(axis=1)
        same = may_be_one(classes, classes) & (bev_iou(boxes, boxes) > _DUPLICATE_IOU)
        begun: list[int] = []
        for column in np.flatnonzero(apart).tolist():
            if not same[column, begun].any():
                begun.append(column)
        if begun:
            self._active = self._active.with_more(_Candidates.first_seen(time_ns, fused, free[begun]))


def _measurements(fused: Fused, columns: Indices) -> Measurement:
    return Measurement(fused.boxes[columns][:, POSE], fused.sd[columns][:, POSE])


def _filtered(hits: Sequence[Hit], road_user: int, length_m: float) -> Belief:
    """What all hits of a road user of this class, an index into `CLASSES`, say of where it was at the last of them."""
    model = model_of(road_user, length_m)
    belief = model.first_belief(hits[0].measurement)
    for before, hit in pairwise(hits):
        belief = update(model, model.predict(belief, (hit.time_ns - before.time_ns) * 1e-9)[0], hit.measurement)
    return belief


def _hit(time_ns: int, fused: Fused, column: int) -> Hit:
    return Hit(time_ns, fused.boxes[column], fused.sd[column], fused.votes[column], fused.headings[column])


def _medians(values: Array, counts: Indices) -> Array:
    """Medians (N, D) of the finite ones of values (N, M, D), which are counts (N,) of M; the others are infinite."""
    ascending = np.sort(values, axis=1)
    rows = np.arange(len(values))
    return 0.5 * (ascending[rows, (counts - 1) // 2] + ascending[rows, counts // 2])


def _cheapest(cost: Array) -> tuple[Indices, Indices]:
    """Rows and columns of pairs with finite cost: the most of them, and of those the cheapest."""
    valid = np.isfinite(cost)
    if not valid.any():
        return np.empty(0, np.int64), np.empty(0, np.int64)
    low = cost[valid].min()
    forbidden = 1.0 + 2.0 * float((cost[valid] - low + 1.0).sum())
    rows, columns = linear_sum_assignment(np.where(valid, cost - low + 1.0, forbidden))
    good = valid[rows, columns]
    return rows[good], columns[good]
