"""Every camera's clock offset and drift from signal changes that several cameras saw.

Robust least squares over all changes at once: unknown are the true time of each change and every camera's offset and
drift. A change is seen as an interval, between the last frame of the old and the first frame of the new state; its
half length over the square root of 3 is the standard deviation of a uniform error. The mean of the exact posterior
under such intervals was measured too (sampling the product of the lengths of their intersections): 0 to 10 % better
with two to four cameras, worse with eight, where a signal's constant amber time makes its changes' errors cancel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.clocks import ClockMap, SignalChange
from wibam_core.formats.clocks import ClockError
from wibam_core.sync.matching import Alignment, ChangeGroup, match_changes
from wibam_core.sync.rounding import regular_times, rounding_covariance

Array = NDArray[np.float64]

#: What is known of a camera's drift against the reference before: a t distribution of this scale (crystals) with few
#: degrees of freedom, since frame rates that are not what they claim to be drift by a thousand.
DRIFT_SD_PPM = 30.0
_DRIFT_FREEDOM = 2.0
#: No change is timed better than this: lamps need time to light up, rows of a frame are exposed one by one.
_SMALLEST_S = 0.002
#: Rows of a frame are exposed one after another: how far off all changes of a camera may be by where its lamps are in
#: the picture.
_ROW_S = 0.0015
#: How far the frames of a camera may slide past the changes, in standard deviations of its drift.
_SLIDES = (-1.2, 0.0, 1.2)
#: What the rounding of changes does is only known from the changes themselves. With few of them errors follow Student's
#: t distribution, of as many degrees of freedom as there are more observations than unknowns, but this many at least.
_LEAST_SPARE = 4
#: Residuals beyond this many standard deviations count less (a uniform error ends at 1.7).
_HUBER = 2.0


@dataclass(frozen=True)
class Observation:
    """One camera's view of one matched change.

    Attributes:
        camera_id: whose.
        group: index into `SyncResult.groups`.
        time_s: on the camera's own clock.
        delay_before_s: the camera's time minus the reference camera's for the same change; None where the reference
            did not see it.
        delay_after_s: the same after the camera's time is mapped to the reference clock.
        residual_s: mapped time minus the change's estimated time.
    """

    camera_id: str
    group: int
    time_s: float
    delay_before_s: float | None
    delay_after_s: float | None
    residual_s: float


@dataclass(frozen=True)
class Meeting:
    """What the traffic says of two cameras' clocks: when the first shows ``first_s``, the second shows ``second_s``,
    and from there the first runs faster by ``drift``.

    Attributes:
        first_id, second_id: the cameras.
        first_s, second_s: one moment on either clock, at which the errors of offset and drift are independent.
        drift: ``d(first) = (1 + drift) d(second)``.
        sd_s, drift_sd: standard deviations of the moment and of the drift.
    """

    first_id: str
    second_id: str
    first_s: float
    second_s: float
    drift: float
    sd_s: float
    drift_sd: float

    def terms(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """(s on the second clock since the moment, sd s): of the moment, and of how far clocks part in 100 s."""
        return (0.0, self.sd_s), (100.0, 100.0 * self.drift_sd)


@dataclass(frozen=True, eq=False)
class SyncResult:
    """Clocks and what they rest on.

    Attributes:
        reference_id: the camera whose clock is the reference.
        clocks: camera id -> clock, the reference first with an exact identity.
        errors: camera id -> standard deviations; the offset's at the middle of that camera's changes.
        groups: matched changes, by time.
        alignments: per camera but the reference, how its changes met the others'.
        observations: one per camera and matched change.
        centres_s: camera id -> middle of what its clock was found from, on its own clock.
    """

    reference_id: str
    clocks: Mapping[str, ClockMap]
    errors: Mapping[str, ClockError]
    groups: tuple[ChangeGroup, ...]
    alignments: Mapping[str, Alignment]
    observations: tuple[Observation, ...]
    centres_s: Mapping[str, float] = field(default_factory=dict)

    def sd_s(self, camera_id: str, at_s: float) -> float:
        """Standard deviation of a camera's mapped time at ``at_s`` on its own clock, s."""
        error = self.errors[camera_id]
        since_s = at_s - self.centres_s.get(camera_id, at_s)
        return float(np.hypot(error.offset_sd_ns / 1e9, since_s * error.drift_sd))

    def rms_s(self, camera_id: str) -> tuple[float | None, float | None]:
        """Root mean square delay of a camera to the reference, before and after; None where no change is shared."""
        both = [
            (o.delay_before_s, o.delay_after_s)
            for o in self.observations
            if o.camera_id == camera_id and o.delay_before_s is not None and o.delay_after_s is not None
        ]
        if not both:
            return None, None
        before, after = np.sqrt((np.array(both) ** 2).mean(axis=0)).tolist()
        return before, after


@dataclass(frozen=True, eq=False)
class _System:
    """Linear model of all light changes (m) and of what the traffic says (n). A change's time on the reference clock,
    relative to the group's rough time, is ``rough + design @ x`` ± ``half``; ``between @ x`` is ``between_at_s`` ±
    ``between_sd_s``. x is (offset s at ``centre_s``, drift ppm) per camera but the reference, both against the rough
    clocks, whose drifts are ``drift_ppm``."""

    group: NDArray[np.int64]
    camera: NDArray[np.int64]
    rough: Array
    half: Array
    design: Array
    drift_ppm: Array
    centre_s: Array
    group_s: Array
    kinds: tuple[tuple[str, str, str], ...]
    between: Array
    between_at_s: Array
    between_sd_s: Array


def estimate_clocks(
    changes: Mapping[str, Sequence[SignalChange]],
    reference_id: str,
    max_offset_s: float | None = None,
    spans_s: Mapping[str, tuple[float, float]] | None = None,
    meetings: Sequence[Meeting] = (),
    near_s: Mapping[str, float] | None = None,
) -> SyncResult:
    """Offset and drift of every camera against the reference.

    Args:
        changes: camera id -> its changes, for every camera.
        reference_id: the camera whose clock is kept.
        max_offset_s: of offsets that explain the changes equally well, smaller ones than this are preferred.
        spans_s: camera id -> first and last time of its recording, on its own clock.
        meetings: what the traffic says of two cameras' clocks.
        near_s: camera id -> an offset found from the traffic, which decides between equally good ones.

    Raises:
        NoSignalChange: naming a camera that saw no change, or none that another camera saw.
    """
    groups, alignments = match_changes(changes, reference_id, max_offset_s, spans_s, near_s)
    rough = {c: (one.taken.offset_s, one.taken.drift) for c, one in alignments.items()}
    return solve_clocks(reference_id, groups, rough, alignments, meetings)


def solve_clocks(
    reference_id: str,
    groups: Sequence[ChangeGroup],
    rough: Mapping[str, tuple[float, float]],
    alignments: Mapping[str, Alignment],
    meetings: Sequence[Meeting] = (),
) -> SyncResult:
    """All clocks at once from what was matched.

    Args:
        reference_id: the camera whose clock is kept.
        groups: light changes that several cameras saw; may be none.
        rough: camera id -> offset (s) and drift to start from, for every camera but the reference.
        alignments: how the changes were matched, for the result.
        meetings: what the traffic says of two cameras' clocks.
    """
    others = list(rough)
    if not others:
        return SyncResult(reference_id, {reference_id: ClockMap()}, {reference_id: ClockError(0, 0)}, (), {}, ())
    system = _system(groups, rough, meetings)
    x, sd = _least_squares(system)
    clocks, errors = {reference_id: ClockMap()}, {reference_id: ClockError(0.0, 0.0)}
    for k, camera_id in enumerate(others):
        offset_s, drift = rough[camera_id]
        turned = float(x[2 * k + 1]) * 1e-6
        offset_s += float(x[2 * k]) - turned * system.centre_s[k]
        clocks[camera_id] = ClockMap(round(offset_s * 1e9), drift + turned)
        errors[camera_id] = ClockError(float(sd[2 * k]) * 1e9, float(sd[2 * k + 1]) * 1e-6)
    timed = tuple(_retimed(group, clocks) for group in groups)
    observations = _observe(timed, clocks, reference_id)
    centres_s = dict(zip(others, system.centre_s.tolist(), strict=True))
    return SyncResult(reference_id, clocks, errors, timed, alignments, observations, centres_s)


def _system(
    groups: Sequence[ChangeGroup], rough: Mapping[str, tuple[float, float]], meetings: Sequence[Meeting]
) -> _System:
    others = list(rough)
    column = {camera_id: k for k, camera_id in enumerate(others)}
    own_times: list[list[float]] = [[] for _ in others]
    for group in groups:
        for camera_id, change in group.seen.items():
            if camera_id in column:
                own_times[column[camera_id]].append(change.time_ns / 1e9)
    for meeting in meetings:
        for camera_id, at_s in ((meeting.first_id, meeting.first_s), (meeting.second_id, meeting.second_s)):
            if camera_id in column:
                own_times[column[camera_id]].append(at_s)
    centre_s = np.array([float(np.mean(times)) if times else 0.0 for times in own_times])

    def seen(camera_id: str, local_s: float) -> tuple[float, Array]:
        """The rough reference time, and by how much the unknowns move it."""
        row = np.zeros(2 * len(others))
        if camera_id not in column:
            return local_s, row
        offset_s, drift = rough[camera_id]
        k = column[camera_id]
        row[2 * k : 2 * k + 2] = 1.0, (local_s - centre_s[k]) * 1e-6
        return local_s + offset_s + drift * local_s, row

    index, at, half, rows, cameras = [], [], [], [], []
    for g, group in enumerate(groups):
        for camera_id, change in group.seen.items():
            rough_s, row = seen(camera_id, change.time_ns / 1e9)
            index.append(g)
            at.append(rough_s - group.time_s)
            half.append(max(change.half_interval_ns / 1e9, _SMALLEST_S))
            cameras.append(column.get(camera_id, -1))
            rows.append(row)
    between, between_at, between_sd = [], [], []
    for meeting in meetings:
        for since_s, sd_s in meeting.terms():
            first_s, first = seen(meeting.first_id, meeting.first_s + since_s * (1 + meeting.drift))
            second_s, second = seen(meeting.second_id, meeting.second_s + since_s)
            origin_first, base_first = seen(meeting.first_id, meeting.first_s)
            origin_second, base_second = seen(meeting.second_id, meeting.second_s)
            if since_s:
                first, second = first - base_first, second - base_second
                first_s, second_s = first_s - origin_first, second_s - origin_second
            between.append(first - second)
            between_at.append(second_s - first_s)
            between_sd.append(sd_s)
    return _System(
        group=np.array(index, dtype=np.int64),
        camera=np.array(cameras, dtype=np.int64),
        rough=np.array(at),
        half=np.array(half),
        design=np.array(rows).reshape(-1, 2 * len(others)),
        drift_ppm=np.array([1e6 * drift for _, drift in rough.values()]),
        centre_s=centre_s,
        group_s=np.array([group.time_s for group in groups]),
        kinds=tuple(group.key for group in groups),
        between=np.array(between).reshape(-1, 2 * len(others)),
        between_at_s=np.array(between_at),
        between_sd_s=np.array(between_sd),
    )


def _least_squares(system: _System) -> tuple[Array, Array]:
    """Huber-weighted least squares over all observations, with the drifts' prior, a t distribution.

    Returns:
        x (2(C − 1),) and its standard deviations.
    """
    unknowns = 2 * len(system.drift_ppm)
    m = len(system.group)
    groups = len(system.kinds)
    picks = np.zeros((m, groups))
    picks[np.arange(m), system.group] = 1.0
    rows = np.concatenate([-system.design, picks], axis=1)
    sigma = system.half / np.sqrt(3.0)
    pairs = np.concatenate([system.between, np.zeros((len(system.between), groups))], axis=1)
    robust, pairs_robust = np.ones(m), np.ones(len(pairs))
    prior_sd = np.maximum(DRIFT_SD_PPM, np.abs(system.drift_ppm))
    for _ in range(15):
        weight = np.sqrt(robust) / sigma
        pairs_weight = np.sqrt(pairs_robust) / system.between_sd_s
        prior = np.zeros((unknowns // 2, rows.shape[1]))
        prior[np.arange(unknowns // 2), 2 * np.arange(unknowns // 2) + 1] = 1.0 / prior_sd
        A = np.concatenate([rows * weight[:, None], pairs * pairs_weight[:, None], prior])
        b = np.concatenate(
            [system.rough * weight, system.between_at_s * pairs_weight, -system.drift_ppm / prior_sd],
        )
        solution = np.linalg.lstsq(A, b, rcond=None)[0]
        error = np.abs(rows @ solution - system.rough) / sigma
        robust = np.minimum(1.0, _HUBER / np.maximum(error, 1e-12))
        pairs_error = np.abs(pairs @ solution - system.between_at_s) / system.between_sd_s
        pairs_robust = np.minimum(1.0, _HUBER / np.maximum(pairs_error, 1e-12))
        drift_ppm = system.drift_ppm + solution[1:unknowns:2]
        prior_sd = DRIFT_SD_PPM * np.sqrt((_DRIFT_FREEDOM + (drift_ppm / DRIFT_SD_PPM) ** 2) / (_DRIFT_FREEDOM + 1))
    inverse = np.linalg.pinv(A.T @ A)
    gain = inverse[:unknowns] @ A.T
    late_s = rows @ solution - system.rough
    sd_s = np.sqrt(np.diag(inverse)[unknowns:])
    order = np.argsort(system.group_s + solution[unknowns:], kind="stable")
    times_s = (system.group_s + solution[unknowns:])[order]
    moved_s, sets = np.empty(groups), np.empty(groups, np.int64)
    regular_s, sets[order] = regular_times([system.kinds[g] for g in order], times_s, sd_s[order])
    moved_s[order] = regular_s - times_s
    late_s += moved_s[system.group]
    others = gain[:, m:]
    of_camera = system.camera == np.arange(-1, len(system.drift_ppm))[:, None]
    rows_s = _ROW_S * (gain[:, :m] * weight) @ of_camera.T
    known = others @ others.T + rows_s @ rows_s.T
    slides = np.zeros((1, m))
    spare = max(m - groups + len(pairs) - unknowns, _LEAST_SPARE)
    few = spare / (spare - 2)
    for _ in range(2):
        rounded = rounding_covariance(
            gain[:, :m] * weight, system.camera, sets[system.group], system.half, late_s, slides
        )
        covariance = known + few * rounded
        slides = np.array(_SLIDES)[:, None] * (system.design[:, 1::2] @ np.sqrt(np.diag(covariance)[1::2]))
    freedom = max(m - groups + len(pairs) - unknowns, 1)
    squares = float((robust * error**2).sum() + (pairs_robust * pairs_error**2).sum())
    return solution[:unknowns], np.sqrt(np.diag(covariance) * max(1.0, squares / freedom))


def _retimed(group: ChangeGroup, clocks: Mapping[str, ClockMap]) -> ChangeGroup:
    """The group at the middle of where its intervals meet, or of the gap between them where they do not."""
    ends = [(int(clocks[c].to_reference_ns(seen.time_ns)), seen.half_interval_ns) for c, seen in group.seen.items()]
    latest_start, earliest_end = max(t - half for t, half in ends), min(t + half for t, half in ends)
    return replace(group, time_s=(latest_start + earliest_end) / 2e9)


def _observe(
    groups: Sequence[ChangeGroup], clocks: Mapping[str, ClockMap], reference_id: str
) -> tuple[Observation, ...]:
    observations = []
    for g, group in enumerate(groups):
        reference = group.seen.get(reference_id)
        for camera_id, change in group.seen.items():
            own_s = change.time_ns / 1e9
            mapped_s = int(clocks[camera_id].to_reference_ns(change.time_ns)) / 1e9
            observations.append(
                Observation(
                    camera_id=camera_id,
                    group=g,
                    time_s=own_s,
                    delay_before_s=None if reference is None else own_s - reference.time_ns / 1e9,
                    delay_after_s=None if reference is None else mapped_s - reference.time_ns / 1e9,
                    residual_s=mapped_s - group.time_s,
                )
            )
    return tuple(observations)
