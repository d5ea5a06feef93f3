"""How probable it is that two road users really came as close to a collision as their tracks say.

Many versions of what both did are drawn that agree with their tracks, each with errors that last (`track_errors`). In
each version the two either are in conflict or not; the share of versions that are is the probability. So one bad
instant proves nothing, while a short crash course that all versions share counts in full. Versions in which the two
stand in each other are impossible and count as none; where nearly all are, the two are one vehicle, tracked twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr

from wibam_core.config import SafetyConfig
from wibam_core.geometry.box3d import LENGTH, WIDTH, XY
from wibam_core.safety.drac import deceleration_to_avoid
from wibam_core.safety.pairs import PairInstants
from wibam_core.safety.pet import Encroachment, courses_differ
from wibam_core.safety.track_errors import Drawn, TrackErrors, draw, shrunk
from wibam_core.safety.trajectory import resample
from wibam_core.safety.ttc import footprints_touch, time_to_collision
from wibam_core.safety.turning import TurningStates, collide_turning
from wibam_core.scene import Track

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DRAWS = 96
#: So many are drawn at first, and no more where what they say has less than this chance at the least probability told.
_FIRST_DRAWS, _NEXT_TO_IMPOSSIBLE = 24, 1e-4
#: Versions whose footprints overlap by more than this all round are impossible.
_DEPTH_M = 0.25
#: Fewer possible versions than this share: the two are one.
LEAST_POSSIBLE = 0.1
#: Post-encroachment times are sought on this grid, so far around the ones of the tracks.
_STEP_S, _AROUND_S = 0.05, 0.8
#: So many pairs of times are compared at once.
_BAND = 128


@dataclass(frozen=True, eq=False)
class CourseEvidence:
    """What D versions say of a crash course.

    Attributes:
        possible, in_conflict: (D,) of the versions.
        ttc_s: (D,) least time to collision of each, inf where there is none.
    """

    possible: Mask
    in_conflict: Mask
    ttc_s: Array


def critical_instants(
    boxes_a: Array,
    velocities_a: Array,
    yaw_rates_a: Array,
    boxes_b: Array,
    velocities_b: Array,
    yaw_rates_b: Array,
    config: SafetyConfig,
) -> tuple[Mask, Array]:
    """Which of N states are critical, and their times to collision (N,) in s.

    Critical is a crash course in less than ``config.ttc_s``, straight on and on the present arcs, that soft braking
    would not avoid, and with at least one of the two moving.
    """  # fmt: skip
    ttc = time_to_collision(boxes_a, velocities_a, boxes_b, velocities_b)
    speed = np.maximum(np.hypot(*velocities_a.T), np.hypot(*velocities_b.T))
    critical = (ttc > 0) & (ttc < config.ttc_s) & (speed >= config.min_speed_mps)
    critical &= deceleration_to_avoid(ttc, velocities_a, velocities_b) >= config.min_deceleration_mps2
    at = np.flatnonzero(critical)
    if len(at):
        critical[at] = collide_turning(
            TurningStates(boxes_a[at], velocities_a[at], yaw_rates_a[at]),
            TurningStates(boxes_b[at], velocities_b[at], yaw_rates_b[at]),
            config.ttc_s,
            ttc[at],
        )
    return critical, ttc


def of_course(
    a: Track, b: Track, instants: PairInstants, config: SafetyConfig, errors: TrackErrors, rng: np.random.Generator
) -> CourseEvidence:
    """Of a crash course at these instants: of fewer versions where the first ones leave it next to impossible that
    ``config.min_probability`` is reached."""
    parts: list[CourseEvidence] = []
    for count in (_FIRST_DRAWS, DRAWS - _FIRST_DRAWS):
        parts.append(_of_versions(a, b, instants, config, errors, count, rng))
        so_far = int((parts[0].in_conflict & parts[0].possible).sum())
        if bdtr(so_far, _FIRST_DRAWS, config.min_probability) < _NEXT_TO_IMPOSSIBLE:
            break
    return CourseEvidence(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("possible", "in_conflict", "ttc_s"))
    )


def _of_versions(
    a: Track,
    b: Track,
    instants: PairInstants,
    config: SafetyConfig,
    errors: TrackErrors,
    count: int,
    rng: np.random.Generator,
) -> CourseEvidence:
    drawn_a = draw(a, instants.index_a, errors, count, rng)
    drawn_b = draw(b, instants.index_b, errors, count, rng)
    possible = ~_stand_in_each_other(drawn_a, drawn_b)
    everything = np.ones(drawn_a.yaw_rates.shape, bool)
    critical, ttc = critical_instants(*drawn_a.where(everything), *drawn_b.where(everything), config)
    critical, ttc = critical.reshape(everything.shape), ttc.reshape(everything.shape)
    runs = in_runs(critical, instants.consecutive, needed_instants(a, config))
    closest = np.where(runs, ttc, np.inf).min(axis=1)
    foreseen = np.where(ttc > 0, ttc, np.inf).min(axis=1)
    return CourseEvidence(possible, np.asarray(runs.any(axis=1)), np.where(np.isfinite(closest), closest, foreseen))


def needed_instants(track: Track, config: SafetyConfig) -> int:
    """How many critical instants in a row make a conflict."""
    period_s = float(np.median(np.diff(track.times_ns))) * 1e-9 if len(track) > 1 else 1.0
    return max(config.min_instants, math.ceil(config.min_duration_s / period_s - 1e-6))


def in_runs(critical: Mask, consecutive: Mask, least: int) -> Mask:
    """Which of (D, K) belong to a run of at least so many critical instants, each directly after the one before."""
    length = np.zeros(critical.shape, dtype=np.int64)
    for k in range(critical.shape[1]):
        before = length[:, k - 1] if k and consecutive[k] else 0
        length[:, k] = np.where(critical[:, k], before + 1, 0)
    runs = length >= least
    for k in range(critical.shape[1] - 2, -1, -1):
        if consecutive[k + 1]:
            runs[:, k] |= critical[:, k] & runs[:, k + 1]
    return runs


def _stand_in_each_other(a: Drawn, b: Drawn) -> Mask:
    """(D,) versions with deeply overlapping footprints at any instant."""
    offset = a.boxes[..., XY] - b.boxes[..., XY]
    near = np.hypot(offset[..., 0], offset[..., 1]) < 0.5 * (
        np.hypot(a.boxes[..., LENGTH], a.boxes[..., WIDTH]) + np.hypot(b.boxes[..., LENGTH], b.boxes[..., WIDTH])
    )
    deep = np.zeros(near.shape, bool)
    deep[near] = footprints_touch(shrunk(a.boxes[near], _DEPTH_M), shrunk(b.boxes[near], _DEPTH_M))
    return np.asarray(deep.any(axis=1))


def probability(possible: Mask, in_conflict: Mask) -> float:
    """Share of all versions that are possible and in conflict: who stands in another is more often one that was tracked
    twice than one who came that close."""
    return float((in_conflict & possible).mean())


def encroachment_draws(
    a: Track, b: Track, found: Encroachment, config: SafetyConfig, errors: TrackErrors, rng: np.random.Generator
) -> Array:
    """(DRAWS,) post-encroachment times, s: inf where a version's paths do not cross on different courses, 0 where both
    are there at once."""
    times = (found.leaves_ns, found.arrives_ns)
    at_a, at_b = times if found.first_index == 0 else times[::-1]
    grid_a, boxes_a = _around(a, at_a, errors, rng)
    grid_b, boxes_b = _around(b, at_b, errors, rng)
    i = np.repeat(np.arange(len(grid_a)), len(grid_b))
    j = np.tile(np.arange(len(grid_b)), len(grid_a))
    differ = courses_differ(boxes_a[0], boxes_b[0], i, j, math.radians(config.same_direction_deg))
    i, j = i[differ], j[differ]
    apart_s = np.abs(grid_a[i] - grid_b[j]) * 1e-9
    order = np.argsort(apart_s, kind="stable")
    i, j, apart_s = i[order], j[order], apart_s[order]
    # of each version the pair of times that touch with the least time between: looked for in bands of that time
    least = np.full(DRAWS, np.inf)
    sizes = [0.5 * np.hypot(boxes[:, 0, LENGTH], boxes[:, 0, WIDTH]) for boxes in (boxes_a, boxes_b)]
    reach2 = (sizes[0] + sizes[1]) ** 2
    open_draws = np.arange(DRAWS)
    for first in range(0, len(i), _BAND):
        band_i, band_j = i[first : first + _BAND], j[first : first + _BAND]
        offset = boxes_a[open_draws][:, band_i, :2] - boxes_b[open_draws][:, band_j, :2]
        row, column = np.nonzero(offset[..., 0] ** 2 + offset[..., 1] ** 2 < reach2[open_draws, None])
        d = open_draws[row]
        touch = footprints_touch(boxes_a[d, band_i[column]], boxes_b[d, band_j[column]])
        found_draws, at = np.unique(row[touch], return_index=True)
        least[open_draws[found_draws]] = apart_s[first + column[touch][at]]
        open_draws = np.delete(open_draws, found_draws)
        if not len(open_draws):
            break
    # the grid finds the first and the last touch about half a step too late and too early each
    return np.where(least > _STEP_S, least - 0.5 * _STEP_S, least)


def _around(track: Track, at_ns: int, errors: TrackErrors, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array]:
    """Times around ``at_ns`` within the track, and boxes (D, G, 7) then."""
    around = int(_AROUND_S * 1e9)
    begin, end = max(at_ns - around, int(track.times_ns[0])), min(at_ns + around, int(track.times_ns[-1]))
    grid = np.arange(begin, end + 1, int(_STEP_S * 1e9), dtype=np.int64)
    fine = resample(track, grid)
    return grid, draw(fine, np.arange(len(grid)), errors, DRAWS, rng).boxes
