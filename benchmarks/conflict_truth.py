"""The conflicts that simulated traffic really has: brute force on its exact states, apart from the code it judges.

Time to collision: both vehicles of a pair are moved on in small steps, straight and on their present arcs, until their
rectangles overlap. Post-encroachment time: a grid on the ground remembers when each vehicle covered each cell; what
may be below the threshold is looked at again on a finer grid, at finer times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, WIDTH, XY, YAW, footprints
from wibam_core.synthetic.driving import STEP_S
from wibam_core.synthetic.routes import footprints_overlap
from wibam_core.synthetic.traffic import Traffic

Array = NDArray[np.float64]

#: Every other step of the simulation is looked at.
_EVERY = 2
_PERIOD_S = _EVERY * STEP_S
_ROLL_S = 0.05
_CELL_M = 0.25
#: The second look at an encroachment: cells and steps of this size, so far around its place and its two times.
_FINE_CELL_M, _FINE_STEP_S, _FINE_AROUND_M, _FINE_AROUND_S = 0.05, 0.01, 1.5, 0.5
_SAME_DIRECTION_RAD = np.radians(30.0)


@dataclass(frozen=True)
class TrueConflict:
    """Of vehicles ``ids``, smaller first.

    Attributes:
        ttc_s: least time to collision of the run that makes it a conflict, inf without one.
        pet_s: post-encroachment time below its threshold, else inf.
        time_s, x_m, y_m: when and where it came closest.
    """

    ids: tuple[int, int]
    ttc_s: float
    pet_s: float
    time_s: float
    x_m: float
    y_m: float


@dataclass(frozen=True, eq=False)
class States:
    """One vehicle at every `_PERIOD_S` from step ``first`` on: boxes (T, 7), velocities (T, 2), yaw rates (T,)."""

    vehicle_id: int
    first: int
    boxes: Array
    velocities: Array
    yaw_rates: Array


def states_of(traffic: Traffic) -> list[States]:
    """All vehicles, those that are parked left out."""
    found = []
    for t in traffic.trajectories:
        if t.route is None:
            continue
        steps = np.arange(-t.first_step % _EVERY, len(t.s_m), _EVERY)
        if len(steps) < 4:
            continue
        poses = t.route.poses(t.s_m[steps], t.model.length_m)
        length, width, height = t.model.size_m
        n = len(steps)
        boxes = np.column_stack(
            [
                poses[:, :2],
                np.full(n, height / 2),
                np.full(n, length),
                np.full(n, width),
                np.full(n, height),
                poses[:, 2],
            ]
        )
        first = (t.first_step + int(steps[0])) // _EVERY
        velocities = np.gradient(boxes[:, :2], _PERIOD_S, axis=0)
        turning = np.gradient(np.unwrap(boxes[:, YAW]), _PERIOD_S)
        found.append(States(t.vehicle_id, first, boxes, velocities, turning))
    return found


def true_conflicts(
    traffic: Traffic, *, ttc_s: float, pet_s: float, radius_m: float, braking_mps2: float = 3.0, lasts_s: float = 0.2
) -> list[TrueConflict]:
    """All of them within ``radius_m`` of the middle: pairs whose TTC is below ``ttc_s`` for ``lasts_s`` in a row, while
    avoiding it would take ``braking_mps2``, or whose PET is below ``pet_s``."""
    vehicles = states_of(traffic)
    ttc, pet = _times_to_collision(vehicles, ttc_s, braking_mps2, lasts_s), _encroachments(vehicles, pet_s)
    found = []
    for ids in sorted(ttc.keys() | pet.keys()):
        t, p = ttc.get(ids), pet.get(ids)
        _, time_s, x, y = t if t is not None else p if p is not None else (0.0, 0.0, 0.0, 0.0)
        if np.hypot(x, y) < radius_m and 0 <= time_s < traffic.duration_s:
            found.append(TrueConflict(ids, t[0] if t else np.inf, p[0] if p else np.inf, time_s, x, y))
    return found


def _times_to_collision(
    vehicles: Sequence[States], ttc_s: float, braking_mps2: float, lasts_s: float
) -> dict[tuple[int, int], tuple[float, float, float, float]]:
    critical: dict[tuple[int, int], list[tuple[int, float, float, float]]] = {}
    last = max(v.first + len(v.boxes) for v in vehicles)
    steps = np.arange(1, round(ttc_s / _ROLL_S) + 1) * _ROLL_S
    for k in range(last):
        here = [v for v in vehicles if v.first <= k < v.first + len(v.boxes)]
        if len(here) < 2:
            continue
        boxes = np.array([v.boxes[k - v.first] for v in here])
        velocities = np.array([v.velocities[k - v.first] for v in here])
        turning = np.array([v.yaw_rates[k - v.first] for v in here])
        i, j = np.triu_indices(len(here), 1)
        gap = boxes[j, :2] - boxes[i, :2]
        closing = velocities[j] - velocities[i]
        speed = np.hypot(*closing.T)
        reach = 0.5 * (np.hypot(boxes[i, LENGTH], boxes[i, WIDTH]) + np.hypot(boxes[j, LENGTH], boxes[j, WIDTH]))
        near = (
            (np.hypot(*gap.T) < speed * ttc_s + reach)
            & ((gap * closing).sum(1) < 0)
            & (speed > 2 * braking_mps2 * _ROLL_S)
        )
        i, j, speed = i[near], j[near], speed[near]
        straight = footprints_overlap(
            _rolled(boxes[i], velocities[i], None, steps), _rolled(boxes[j], velocities[j], None, steps)
        )
        hits = straight.any(1)
        i, j, speed, straight = i[hits], j[hits], speed[hits], straight[hits]
        if not len(i):
            continue
        ttc = steps[straight.argmax(1)] - 0.5 * _ROLL_S
        arcs = footprints_overlap(
            _rolled(boxes[i], velocities[i], turning[i], steps), _rolled(boxes[j], velocities[j], turning[j], steps)
        ).any(1)
        apart = ~footprints_overlap(boxes[i], boxes[j])
        good = arcs & apart & (speed / (2 * ttc) >= braking_mps2) & (ttc < ttc_s)
        for a, b, time in zip(i[good].tolist(), j[good].tolist(), ttc[good].tolist(), strict=True):
            ids = (min(here[a].vehicle_id, here[b].vehicle_id), max(here[a].vehicle_id, here[b].vehicle_id))
            middle = 0.5 * (boxes[a, :2] + boxes[b, :2])
            critical.setdefault(ids, []).append((k, time, float(middle[0]), float(middle[1])))
    found = {}
    for ids, rows in critical.items():
        run: list[tuple[int, float, float, float]] = []
        for row, after in zip(rows, [*rows[1:], (-9, 0.0, 0.0, 0.0)], strict=True):
            run.append(row)
            if after[0] == row[0] + 1:
                continue
            if len(run) * _PERIOD_S >= lasts_s - 1e-9:
                closest = min(run, key=lambda r: r[1])
                if ids not in found or closest[1] < found[ids][0]:
                    found[ids] = (closest[1], closest[0] * _PERIOD_S, closest[2], closest[3])
            run = []
    return found


def _rolled(boxes: Array, velocities: Array, turning: Array | None, steps: Array) -> Array:
    """Boxes (N, S, 7) after each of S times."""
    moved = np.repeat(boxes[:, None], len(steps), axis=1)
    if turning is None:
        moved[..., :2] += velocities[:, None] * steps[:, None]
        return moved
    turned = turning[:, None] * steps
    share = np.sinc(turned / (2 * np.pi)) * steps
    course = np.arctan2(velocities[:, 1], velocities[:, 0])[:, None] + 0.5 * turned
    speed = np.hypot(*velocities.T)[:, None]
    moved[..., 0] += share * speed * np.cos(course)
    moved[..., 1] += share * speed * np.sin(course)
    moved[..., YAW] += turned
    return moved


def _encroachments(
    vehicles: Sequence[States], pet_s: float
) -> dict[tuple[int, int], tuple[float, float, float, float]]:
    """Least time between one leaving a cell of the ground and another, on another course, coming to it."""
    by_id = {v.vehicle_id: v for v in vehicles}
    visits: dict[tuple[int, int], list[tuple[float, float, int, float]]] = {}
    for v in vehicles:
        moving = np.hypot(*v.velocities.T) >= 1.0
        spans: dict[tuple[int, int], list[float]] = {}
        for k in np.flatnonzero(moving).tolist():
            time = (v.first + k) * _PERIOD_S
            for cell in _covered(v.boxes[k]):
                span = spans.get(cell)
                if span is None:
                    spans[cell] = [time, time, float(v.boxes[k, YAW])]
                else:
                    span[1] = time
        for cell, (enters, leaves, yaw) in spans.items():
            visits.setdefault(cell, []).append((enters, leaves, v.vehicle_id, yaw))
    rough: dict[tuple[int, int], tuple[float, float, float, tuple[int, int], tuple[int, int]]] = {}
    crashed: set[tuple[int, int]] = set()
    for cell, rows in visits.items():
        rows.sort()
        for n, (_, leaves, one, yaw) in enumerate(rows):
            for enters, _, other, its_yaw in rows[n + 1 :]:
                if enters - leaves > pet_s + 3 * _PERIOD_S:
                    break
                if one == other or abs((its_yaw - yaw + np.pi) % (2 * np.pi) - np.pi) < _SAME_DIRECTION_RAD:
                    continue
                ids = (min(one, other), max(one, other))
                if enters <= leaves:
                    crashed.add(ids)
                    continue
                if ids not in rough or enters - leaves < rough[ids][0]:
                    rough[ids] = (enters - leaves, leaves, enters, (one, other), cell)
    found = {}
    for ids, (_, leaves, enters, (one, other), cell) in rough.items():
        if ids in crashed or not _cut(by_id[one].boxes[:, XY], by_id[other].boxes[:, XY]):
            continue
        x, y = (cell[0] + 0.5) * _CELL_M, (cell[1] + 0.5) * _CELL_M
        gap = _second_look(by_id[one], by_id[other], leaves, enters, x, y)
        if gap is not None and gap < pet_s:
            found[ids] = (gap, enters, x, y)
    return found


def _second_look(one: States, other: States, leaves_s: float, enters_s: float, x_m: float, y_m: float) -> float | None:
    """Least time between one leaving and the other reaching a place near (x, y), None where they share none there."""
    side = np.arange(-_FINE_AROUND_M, _FINE_AROUND_M, _FINE_CELL_M)
    places = np.stack(np.meshgrid(x_m + side, y_m + side, indexing="ij"), axis=-1)
    spans = []
    for vehicle, about_s in ((one, leaves_s), (other, enters_s)):
        last_s = (vehicle.first + len(vehicle.boxes) - 1) * _PERIOD_S
        times = np.arange(
            max(about_s - _FINE_AROUND_S, vehicle.first * _PERIOD_S),
            min(about_s + _FINE_AROUND_S, last_s),
            _FINE_STEP_S,
        )
        first, last = np.full(places.shape[:2], np.inf), np.full(places.shape[:2], -np.inf)
        known_s = (vehicle.first + np.arange(len(vehicle.boxes))) * _PERIOD_S
        boxes = np.column_stack(
            [
                np.interp(times, known_s, column)
                for column in (*vehicle.boxes[:, :YAW].T, np.unwrap(vehicle.boxes[:, YAW]))
            ]
        )
        for time, box in zip(times.tolist(), boxes, strict=True):
            covered = _in_footprint(places, box)
            first[covered] = np.minimum(first[covered], time)
            last[covered] = time
        spans.append((first, last))
    gaps = spans[1][0] - spans[0][1]
    both = np.isfinite(gaps)
    # a place counts as left at the last look and as reached at the first: on average half a step each
    return max(float(gaps[both].min()) - _FINE_STEP_S, 0.01) if both.any() else None


def _cut(one: Array, other: Array) -> bool:
    """Whether the middles' ways cut each other at 30 degrees or more: each step of one against each of the other."""
    one, other = one[::4], other[::4]
    for k in range(len(one) - 1):
        step = one[k + 1] - one[k]
        if np.hypot(*step) < 0.05:
            continue
        # which side of this step's line the other's places lie on, and the other way round
        side = step[0] * (other[:, 1] - one[k, 1]) - step[1] * (other[:, 0] - one[k, 0])
        for m in np.flatnonzero(side[:-1] * side[1:] < 0).tolist():
            its = other[m + 1] - other[m]
            first = its[0] * (one[k, 1] - other[m, 1]) - its[1] * (one[k, 0] - other[m, 0])
            last = its[0] * (one[k + 1, 1] - other[m, 1]) - its[1] * (one[k + 1, 0] - other[m, 0])
            if first * last < 0:
                cosine = float(step @ its) / float(np.hypot(*step) * np.hypot(*its))
                if cosine < np.cos(_SAME_DIRECTION_RAD):
                    return True
    return False


def _covered(box: Array) -> list[tuple[int, int]]:
    """Cells whose middle lies in a footprint."""
    corners = footprints(box)
    low, high = np.floor(corners.min(0) / _CELL_M).astype(int), np.ceil(corners.max(0) / _CELL_M).astype(int)
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]), indexing="ij")
    inside = _in_footprint((np.stack([x, y], -1) + 0.5) * _CELL_M, box)
    return list(zip(x[inside].tolist(), y[inside].tolist(), strict=True))


def _in_footprint(places: Array, box: Array) -> NDArray[np.bool_]:
    """(...) whether places (..., 2) lie in a box's footprint."""
    offset, c, s = places - box[XY], np.cos(box[YAW]), np.sin(box[YAW])
    along, across = c * offset[..., 0] + s * offset[..., 1], c * offset[..., 1] - s * offset[..., 0]
    return np.asarray((np.abs(along) < box[LENGTH] / 2) & (np.abs(across) < box[WIDTH] / 2))
