"""Conflicts between road users: who, when, how close, and how sure that is.

Two road users are in conflict where they are on a crash course for a moment, or where one comes to a place shortly
after the other has left it. A crash course counts
- if at least one of the two moves,
- if the time to collision stays below the threshold over several instants in a row,
- if the same holds if both keep turning as they do: a vehicle in a turn does not hit what stands beside its lane,
- unless braking softly would do: a queue that rolls up to a red light has short times to collision too.
Instants at which the footprints already overlap are left out: boxes may be a little too large, and a true crash shows
very short times to collision just before.

Tracks err, and so do these measures: how probable it is that they held for what really happened, `evidence` says. Pairs
that overlap deeply, and tracks that lasted too short a time to know their speed, are left out as a whole: they are one
road user tracked twice, or none. So are two who walk: they pass and accompany each other closer than any threshold.
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
from wibam_core.safety.evidence import (
    LEAST_POSSIBLE,
    CourseEvidence,
    critical_instants,
    encroachment_draws,
    in_runs,
    needed_instants,
    of_course,
    probability,
)
from wibam_core.safety.measures import measured
from wibam_core.safety.pairs import PairInstants, approaching, crossing, together
from wibam_core.safety.pet import Encroachment, post_encroachment
from wibam_core.safety.track_errors import TrackErrors, place_sd_m
from wibam_core.safety.uncertainty import Interval
from wibam_core.scene import Track
from wibam_core.traits import Walking

Array = NDArray[np.float64]
#: Of what is drawn of a pair for one measure: generators are made where there is anything to draw.
Seed = tuple[int, int, int, int]

#: A crash course is looked at with so much time before and after.
_AROUND_NS = 800_000_000
#: Encroachments are looked for up to so much above the threshold: some of their versions may lie below.
_PET_MARGIN_S = 0.6


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
        probability: that the two really were in conflict, by either measure. ttc_probability, pet_probability: by each.
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
    ttc_probability: float
    pet_probability: float
    pet_s: float
    pet: Interval
    deceleration_mps2: float
    duration_s: float
    heading_difference_rad: float
    measures: Mapping[str, float]


@dataclass(frozen=True)
class _Course:
    """A crash course: the index into each track where it came closest, how long it lasted, and its evidence."""

    i: int
    j: int
    ttc_s: float
    duration_s: float
    evidence: CourseEvidence


@dataclass(frozen=True, eq=False)
class _Passing:
    """An encroachment, and the times (D,) of its versions."""

    found: Encroachment
    draws_s: Array


def find_conflicts(
    tracks: Sequence[Track],
    config: SafetyConfig,
    *,
    errors: TrackErrors = TrackErrors(),
    seed: int = 0,
    progress: Progress = silent,
) -> list[Conflict]:
    """All conflicts that are at least as probable as ``config.min_probability``, at most one for a pair of tracks,
    sorted by time.

    Args:
        tracks: on one clock. Pairs are compared at the instants that both have.
        config: thresholds.
        errors: how the tracks err.
        seed: of the versions that are drawn of each pair.
        progress: told after every few pairs.
    """
    tracks = sorted(
        (track for track in tracks if track.times_ns[-1] - track.times_ns[0] >= config.min_track_s * 1e9),
        key=lambda track: track.track_id,
    )
    courses = approaching(tracks, config, errors, progress)
    same_direction = math.radians(config.same_direction_deg)
    passing = crossing(tracks, config.pet_s + _PET_MARGIN_S, same_direction, config.min_speed_mps)
    pairs = sorted(courses.keys() | passing)
    found = []
    for done, pair in enumerate(pairs):
        a, b = tracks[pair[0]], tracks[pair[1]]
        # draws depend neither on other pairs nor on what else is looked at in this one
        seeds = ((seed, a.track_id, b.track_id, 0), (seed, a.track_id, b.track_id, 1))
        conflict = _conflict(a, b, courses.get(pair), pair in passing, config, errors, seeds)
        if conflict is not None and conflict.probability >= config.min_probability:
            found.append(conflict)
        if done % 50 == 0:
            progress(0.3 + 0.7 * done / len(pairs), "Looking for conflicts")
    progress(1.0, f"{len(found)} conflicts", conflicts=len(found), pairs=len(pairs))
    return sorted(found, key=lambda c: (c.time_ns, c.track_ids))


def _conflict(
    a: Track,
    b: Track,
    approach_ns: NDArray[np.int64] | None,
    may_cross: bool,
    config: SafetyConfig,
    errors: TrackErrors,
    seeds: tuple[Seed, Seed],
) -> Conflict | None:
    if _both_walk(a, b):
        return None
    begin, end = max(a.times_ns[0], b.times_ns[0]), min(a.times_ns[-1], b.times_ns[-1])
    if _overlap_deeply(a, b, together(a, b, int(begin), int(end)), config):
        return None
    course = None if approach_ns is None else _course(a, b, approach_ns, config, errors, seeds[0])
    passing = _passing(a, b, config, errors, seeds[1]) if may_cross else None
    if course is None and passing is None:
        return None
    possible = np.ones(1, bool) if course is None else course.evidence.possible
    by_course = np.zeros(1, bool) if course is None else course.evidence.in_conflict
    by_passing = np.zeros(1, bool) if passing is None else (passing.draws_s > 0) & (passing.draws_s < config.pet_s)
    ttc_probability = probability(possible, by_course)
    crossed = passing is not None and bool((passing.draws_s > 0).any())
    pet_probability = float(by_passing[passing.draws_s > 0].mean()) if passing is not None and crossed else 0.0
    if possible.mean() < LEAST_POSSIBLE:
        pet_probability = 0.0
    return _described(a, b, course, passing, ttc_probability, pet_probability, config)


def _described(
    a: Track,
    b: Track,
    course: _Course | None,
    passing: _Passing | None,
    ttc_probability: float,
    pet_probability: float,
    config: SafetyConfig,
) -> Conflict | None:
    """The conflict, None where one of the two is too uncertain then: tracks of nobody cross those of all others."""
    if course is not None and (passing is None or ttc_probability >= config.min_probability):
        i, j, time_ns = course.i, course.j, int(a.times_ns[course.i])
        ttc_s, duration_s = course.ttc_s, course.duration_s
        ttc = Interval.of(course.evidence.ttc_s[course.evidence.possible])
    else:
        assert passing is not None
        leaves, arrives = passing.found.leaves_ns, passing.found.arrives_ns
        at_a, at_b = (leaves, arrives) if passing.found.first_index == 0 else (arrives, leaves)
        i, j, time_ns = _nearest(a, at_a), _nearest(b, at_b), arrives
        ttc_s, ttc, duration_s = np.inf, Interval(np.inf, np.inf), 0.0
    if max(place_sd_m(a)[i], place_sd_m(b)[j]) > config.max_place_sd_m:
        return None
    boxes = np.stack([a.boxes[i], b.boxes[j]])
    velocities = np.stack([a.velocities_mps[i], b.velocities_mps[j]])
    kind, difference = classify(boxes, math.radians(config.same_direction_deg))
    place = boxes[:, XY].mean(axis=0)
    if duration_s == 0.0 and passing is not None:
        place = np.array([passing.found.x_m, passing.found.y_m])
    return Conflict(
        track_ids=(a.track_id, b.track_id),
        classes=(a.vehicle_class, b.vehicle_class),
        kind=kind,
        time_ns=time_ns,
        x_m=float(place[0]),
        y_m=float(place[1]),
        speeds_mps=_speeds(velocities),
        ttc_s=ttc_s,
        ttc=ttc,
        # both measures see one event: that either holds is about as probable as the likelier of the two
        probability=max(ttc_probability, pet_probability),
        ttc_probability=ttc_probability,
        pet_probability=pet_probability,
        pet_s=np.inf if passing is None else passing.found.pet_s,
        pet=Interval(np.inf, np.inf) if passing is None else Interval.of(passing.draws_s),
        deceleration_mps2=float(deceleration_to_avoid(ttc_s, velocities[0], velocities[1])),
        duration_s=duration_s,
        heading_difference_rad=difference,
        measures=measured(Encounter(boxes, velocities, ttc_s)),
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


def _course(
    a: Track,
    b: Track,
    approach_ns: NDArray[np.int64],
    config: SafetyConfig,
    errors: TrackErrors,
    seed: Seed,
) -> _Course | None:
    """The crash course of a pair, if any version of the two has one."""
    instants = together(a, b, int(approach_ns[0]) - _AROUND_NS, int(approach_ns[-1]) + _AROUND_NS)
    least = needed_instants(a, config)
    if len(instants.index_a) < least:
        return None
    instants = _within(instants, _near_in_time(a.times_ns[instants.index_a], approach_ns))
    evidence = of_course(a, b, instants, config, errors, np.random.default_rng(seed))
    if not evidence.in_conflict.any():
        return None
    i, j = instants.index_a, instants.index_b
    critical, ttc = critical_instants(*_states(a, i), *_states(b, j), config)
    runs = in_runs(critical[None], instants.consecutive, least)[0]
    if runs.any():
        closest = int(np.argmin(np.where(runs, ttc, np.inf)))
        first = last = closest
        while first > 0 and runs[first - 1] and instants.consecutive[first]:
            first -= 1
        while last + 1 < len(runs) and runs[last + 1] and instants.consecutive[last + 1]:
            last += 1
        ttc_s, duration_s = float(ttc[closest]), float(a.times_ns[i[last]] - a.times_ns[i[first]]) * 1e-9
    else:  # the track itself just misses: what most versions say
        ahead = np.where(ttc > 0, ttc, np.inf)
        gaps = np.hypot(*(a.boxes[i][:, XY] - b.boxes[j][:, XY]).T)
        closest = int(np.argmin(ahead)) if np.isfinite(ahead).any() else int(np.argmin(gaps))
        ttc_s = float(np.median(evidence.ttc_s[evidence.in_conflict]))
        duration_s = (least - 1) * float(np.median(np.diff(a.times_ns))) * 1e-9
    return _Course(int(i[closest]), int(j[closest]), ttc_s, duration_s, evidence)


def _near_in_time(times_ns: NDArray[np.int64], approach_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    after = np.clip(np.searchsorted(approach_ns, times_ns), 1, max(len(approach_ns) - 1, 1))
    before = np.abs(times_ns - approach_ns[after - 1])
    then = np.abs(times_ns - approach_ns[np.minimum(after, len(approach_ns) - 1)])
    return np.asarray(np.minimum(before, then) <= _AROUND_NS)


def _within(instants: PairInstants, keep: NDArray[np.bool_]) -> PairInstants:
    follows = np.r_[False, keep[:-1]] & instants.consecutive
    return PairInstants(instants.index_a[keep], instants.index_b[keep], follows[keep])


def _states(track: Track, rows: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    return track.boxes[rows], track.velocities_mps[rows], track.yaw_rates_radps[rows]


def _passing(a: Track, b: Track, config: SafetyConfig, errors: TrackErrors, seed: Seed) -> _Passing | None:
    """The encroachment of paths that cross, if it may be short enough and neither crept."""
    found = post_encroachment(
        a,
        b,
        max_pet_s=config.pet_s + _PET_MARGIN_S,
        min_heading_difference_rad=math.radians(config.same_direction_deg),
    )
    if found is None:
        return None
    first, second = (a, b) if found.first_index == 0 else (b, a)
    if min(_speed_at(first, found.leaves_ns), _speed_at(second, found.arrives_ns)) < config.min_speed_mps:
        return None
    return _Passing(found, encroachment_draws(a, b, found, config, errors, np.random.default_rng(seed)))


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
