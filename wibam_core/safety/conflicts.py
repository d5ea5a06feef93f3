"""Conflicts between road users: who, when, how close, and how sure that is.

Noise makes conflicts where there are none, so that a pair counts only when
- at least one of the two moves,
- the time to collision stays below the threshold over several instants in a row,
- most draws from the states' own standard deviations agree,
- the same holds if both keep turning as they do: a vehicle in a turn does not hit what stands beside its lane,
- braking softly would not do: a queue that rolls up to a red light has short times to collision too.
Instants at which the footprints already overlap are left out: boxes may be a little too large, and a true crash shows
very short times to collision just before. Pairs that overlap deeply, and tracks that lasted too short a time to know
their speed, are left out as a whole: they are one road user tracked twice, or none. So are two who walk: they pass and
accompany each other closer than any threshold.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from wibam_core.config import SafetyConfig
from wibam_core.geometry.box3d import LENGTH, WIDTH, XY, YAW
from wibam_core.geometry.iou import bev_iou_paired
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.progress import Progress, silent
from wibam_core.road_users import RoadUserClass
from wibam_core.safety.drac import deceleration_to_avoid
from wibam_core.safety.encounter import Encounter
from wibam_core.safety.measures import measured
from wibam_core.safety.pairs import PairInstants, pair_instants
from wibam_core.safety.pet import Encroachment, post_encroachment
from wibam_core.safety.ttc import time_to_collision
from wibam_core.safety.turning import TurningStates, collide_turning
from wibam_core.safety.uncertainty import Interval, pet_interval, ttc_draws
from wibam_core.scene import Track
from wibam_core.traits import Walking

Array = NDArray[np.float64]


class ConflictType(StrEnum):
    REAR_END = "rear_end"
    MERGING = "merging"
    CROSSING = "crossing"
    HEAD_ON = "head_on"


@dataclass(frozen=True)
class Conflict:
    """Two road users that came close to a collision.

    Attributes:
        track_ids, classes, speeds_mps: of the two; the speeds at ``time_ns``.
        kind: by the difference of the headings.
        time_ns: when the time to collision was smallest; where that never fell below its threshold, when the
            second arrived at the place of the encroachment.
        x_m, y_m: the middle between the two at that time.
        ttc_s: the smallest time to collision, inf if there was none. ttc: its 90 % interval.
        probability: share of draws from the states' standard deviations with a time to collision below the
            threshold at ``time_ns``; NaN where the conflict is one of encroachment alone.
        pet_s: post-encroachment time, inf where they shared no place. pet: its 90 % interval.
        deceleration_mps2: braking that would just have avoided the collision at ``time_ns``.
        duration_s: how long the time to collision stayed below its threshold.
        heading_difference_rad: in [0, π].
        measures: what else is measured of the two at ``time_ns``, by name.
    """

    track_ids: tuple[int, int]
    classes: tuple[RoadUserClass, RoadUserClass]
    kind: ConflictType
    time_ns: int
    x_m: float
    y_m: float
    speeds_mps: tuple[float, float]
    ttc_s: float
    ttc: Interval
    probability: float
    pet_s: float
    pet: Interval
    deceleration_mps2: float
    duration_s: float
    heading_difference_rad: float
    measures: Mapping[str, float]


def find_conflicts(
    tracks: Sequence[Track], config: SafetyConfig, *, seed: int = 0, progress: Progress = silent
) -> list[Conflict]:
    """All conflicts, at most one for a pair of tracks, sorted by time.

    Args:
        tracks: on one clock. Pairs are compared at the instants that both have.
        config: thresholds.
        seed: of the draws that give the intervals.
        progress: told after every few pairs.
    """
    tracks = [track for track in tracks if track.times_ns[-1] - track.times_ns[0] >= config.min_track_s * 1e9]
    by_id = {track.track_id: track for track in tracks}
    rng = np.random.default_rng(seed)
    found = []
    pairs = pair_instants(tracks, max(config.ttc_s, config.pet_s))
    for done, (ids, instants) in enumerate(pairs.items()):
        conflict = _conflict(by_id[ids[0]], by_id[ids[1]], instants, config, rng)
        if conflict is not None:
            found.append(conflict)
        if done % 50 == 0:
            progress(done / len(pairs), "Looking for conflicts")
    progress(1.0, f"{len(found)} conflicts", conflicts=len(found), pairs=len(pairs))
    return sorted(found, key=lambda c: (c.time_ns, c.track_ids))


def _conflict(
    a: Track, b: Track, instants: PairInstants, config: SafetyConfig, rng: np.random.Generator
) -> Conflict | None:
    if _both_walk(a, b) or _overlap_deeply(a, b, instants, config):
        return None
    encroachment = _encroachment(a, b, config)
    run = _closest_run(a, b, instants, config)
    if run is None:
        if encroachment is None:
            return None
        return _by_encroachment(a, b, encroachment, config)
    i, j, ttc, duration_s = run
    draws = ttc_draws(a, i, b, j, rng)
    probability = float(np.mean(draws < config.ttc_s))
    if probability < config.min_probability:
        return _by_encroachment(a, b, encroachment, config) if encroachment is not None else None
    boxes = np.stack([a.boxes[i], b.boxes[j]])
    velocities = np.stack([a.velocities_mps[i], b.velocities_mps[j]])
    kind, difference = classify(boxes, math.radians(config.same_direction_deg))
    place = boxes[:, XY].mean(axis=0)
    return Conflict(
        track_ids=(a.track_id, b.track_id),
        classes=(a.vehicle_class, b.vehicle_class),
        kind=kind,
        time_ns=int(a.times_ns[i]),
        x_m=float(place[0]),
        y_m=float(place[1]),
        speeds_mps=_speeds(velocities),
        ttc_s=ttc,
        ttc=Interval.of(draws),
        probability=probability,
        pet_s=np.inf if encroachment is None else encroachment.pet_s,
        pet=Interval(np.inf, np.inf) if encroachment is None else pet_interval(a, b, encroachment),
        deceleration_mps2=float(deceleration_to_avoid(ttc, velocities[0], velocities[1])),
        duration_s=duration_s,
        heading_difference_rad=difference,
        measures=measured(Encounter(boxes, velocities, ttc)),
    )


def _both_walk(a: Track, b: Track) -> bool:
    return all(isinstance(track.vehicle_class.traits.motion, Walking) for track in (a, b))


def _overlap_deeply(a: Track, b: Track, instants: PairInstants, config: SafetyConfig) -> bool:
    """Whether the footprints ever do: by their IoU, or, of two as unlike as a pedestrian and a bus, by what is covered
    of the smaller one."""
    boxes_a, boxes_b = a.boxes[instants.index_a], b.boxes[instants.index_b]
    iou = bev_iou_paired(boxes_a, boxes_b)
    if a.vehicle_class.traits.vulnerable == b.vehicle_class.traits.vulnerable:
        return bool((iou > config.max_overlap_iou).any())
    areas = np.stack([boxes[:, LENGTH] * boxes[:, WIDTH] for boxes in (boxes_a, boxes_b)])
    common = iou * areas.sum(axis=0) / (1.0 + iou)
    return bool((common > config.max_overlap_share * areas.min(axis=0)).any())


def _closest_run(
    a: Track, b: Track, instants: PairInstants, config: SafetyConfig
) -> tuple[int, int, float, float] | None:
    """Index into a, index into b, time to collision and duration of the run of instants that comes closest."""
    i, j = instants.index_a, instants.index_b
    ttc = time_to_collision(a.boxes[i], a.velocities_mps[i], b.boxes[j], b.velocities_mps[j])
    speed = np.maximum(np.hypot(*a.velocities_mps[i].T), np.hypot(*b.velocities_mps[j].T))
    critical = (ttc > 0) & (ttc < config.ttc_s) & (speed >= config.min_speed_mps)
    braking = deceleration_to_avoid(ttc, a.velocities_mps[i], b.velocities_mps[j])
    critical &= braking >= config.min_deceleration_mps2
    at = np.flatnonzero(critical)
    if len(at) < config.min_instants:
        return None
    critical[at] = collide_turning(_states(a, i[at]), _states(b, j[at]), config.ttc_s)
    best = None
    for start, end in _runs(critical, instants.consecutive):
        duration_s = float(a.times_ns[i[end - 1]] - a.times_ns[i[start]]) * 1e-9
        if end - start < config.min_instants or duration_s < config.min_duration_s:
            continue
        closest = start + int(np.argmin(ttc[start:end]))
        if best is None or ttc[closest] < best[2]:
            best = (int(i[closest]), int(j[closest]), float(ttc[closest]), duration_s)
    return best


def _states(track: Track, rows: NDArray[np.int64]) -> TurningStates:
    return TurningStates(track.boxes[rows], track.velocities_mps[rows], track.yaw_rates_radps[rows])


def _runs(critical: NDArray[np.bool_], consecutive: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open ranges in which all are critical and each instant directly follows the one before."""
    runs: list[tuple[int, int]] = []
    start = None
    for k, is_critical in enumerate(critical):
        if start is not None and (not is_critical or not consecutive[k]):
            runs.append((start, k))
            start = None
        if is_critical and start is None:
            start = k
    if start is not None:
        runs.append((start, len(critical)))
    return runs


def _encroachment(a: Track, b: Track, config: SafetyConfig) -> Encroachment | None:
    """The encroachment of paths that cross, if short enough and neither crept; overlap at one time measures none."""
    found = post_encroachment(
        a, b, max_pet_s=config.pet_s, min_heading_difference_rad=math.radians(config.same_direction_deg)
    )
    if found is None or found.pet_s == 0 or found.pet_s >= config.pet_s:
        return None
    first, second = (a, b) if found.first_index == 0 else (b, a)
    return (
        found
        if min(_speed_at(first, found.leaves_ns), _speed_at(second, found.arrives_ns)) >= (config.min_speed_mps)
        else None
    )


def _by_encroachment(a: Track, b: Track, encroachment: Encroachment, config: SafetyConfig) -> Conflict:
    times = (encroachment.leaves_ns, encroachment.arrives_ns)
    at_a, at_b = times if encroachment.first_index == 0 else times[::-1]
    i, j = _nearest(a, at_a), _nearest(b, at_b)
    boxes = np.stack([a.boxes[i], b.boxes[j]])
    velocities = np.stack([a.velocities_mps[i], b.velocities_mps[j]])
    kind, difference = classify(boxes, math.radians(config.same_direction_deg))
    return Conflict(
        track_ids=(a.track_id, b.track_id),
        classes=(a.vehicle_class, b.vehicle_class),
        kind=kind,
        time_ns=encroachment.arrives_ns,
        x_m=encroachment.x_m,
        y_m=encroachment.y_m,
        speeds_mps=_speeds(velocities),
        ttc_s=np.inf,
        ttc=Interval(np.inf, np.inf),
        probability=np.nan,
        pet_s=encroachment.pet_s,
        pet=pet_interval(a, b, encroachment),
        deceleration_mps2=0.0,
        duration_s=0.0,
        heading_difference_rad=difference,
        measures=measured(Encounter(boxes, velocities, np.inf)),
    )


def classify(boxes: Array, same_direction_rad: float) -> tuple[ConflictType, float]:
    """Type and difference of headings in [0, π] of two boxes (2, 7).

    One direction and one behind the other: rear end; one direction, side by side: merging; opposite directions:
    head on; all else crosses. Headings that differ by less than ``same_direction_rad`` are one direction.
    """
    difference = float(abs(normalise_angle(boxes[1, YAW] - boxes[0, YAW])))
    if difference > np.pi - same_direction_rad:
        return ConflictType.HEAD_ON, difference
    if difference >= same_direction_rad:
        return ConflictType.CROSSING, difference
    yaw = boxes[0, YAW] + 0.5 * float(normalise_angle(boxes[1, YAW] - boxes[0, YAW]))
    offset = boxes[1, XY] - boxes[0, XY]
    sideways = abs(-np.sin(yaw) * offset[0] + np.cos(yaw) * offset[1])
    return (ConflictType.REAR_END if sideways < boxes[:, WIDTH].mean() else ConflictType.MERGING), difference


def _speeds(velocities: Array) -> tuple[float, float]:
    return float(np.hypot(*velocities[0])), float(np.hypot(*velocities[1]))


def _nearest(track: Track, time_ns: int) -> int:
    return int(np.argmin(np.abs(track.times_ns - time_ns)))


def _speed_at(track: Track, time_ns: int) -> float:
    return float(np.hypot(*track.velocities_mps[_nearest(track, time_ns)]))
