"""Every camera's clock offset and drift from signal changes that several cameras saw.

Robust least squares over all changes at once: unknown are the true time of each change and every camera's offset and
drift. A change is seen as an interval, between the last frame of the old and the first frame of the new state; its
half length over the square root of 3 is the standard deviation of a uniform error. The mean of the exact posterior
under such intervals was measured too (sampling the product of the lengths of their intersections): 0 to 10 % better
with two to four cameras, worse with eight, where a signal's constant amber time makes its changes' errors cancel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.formats.clocks import ClockError
from wibam_core.scene import ClockMap, SignalChange
from wibam_core.sync.matching import Alignment, ChangeGroup, match_changes

Array = NDArray[np.float64]

#: Prior standard deviation of a camera's drift against the reference.
DRIFT_SD_PPM = 30.0
#: Changes that span less time than this say nothing about drift; it is taken as 0.
_MIN_DRIFT_SPAN_S = 60.0
#: No change is timed better than this: lamps need time to light up, rows of a frame are exposed one by one.
_SMALLEST_S = 0.002
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
    """

    reference_id: str
    clocks: Mapping[str, ClockMap]
    errors: Mapping[str, ClockError]
    groups: tuple[ChangeGroup, ...]
    alignments: Mapping[str, Alignment]
    observations: tuple[Observation, ...]

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
    """Linear model of all observations (m): time on the reference clock, relative to the group's rough time, is
    ``rough + design @ x`` ± ``half``; x is (offset s at ``centre_s``, drift ppm) per camera but the reference."""

    group: NDArray[np.int64]
    rough: Array
    half: Array
    design: Array
    prior_sd: Array
    centre_s: Array
    groups: int


def estimate_clocks(
    changes: Mapping[str, Sequence[SignalChange]], reference_id: str, max_offset_s: float = 30.0
) -> SyncResult:
    """Offset and drift of every camera against the reference.

    Args:
        changes: camera id -> its changes, for every camera.
        reference_id: the camera whose clock is kept.
        max_offset_s: largest offset that is looked for.

    Raises:
        NoSignalChange: naming a camera that saw no change, or none that another camera saw.
    """
    groups, alignments = match_changes(changes, reference_id, max_offset_s)
    others = list(alignments)
    if not others:
        return SyncResult(reference_id, {reference_id: ClockMap()}, {reference_id: ClockError(0, 0)}, (), {}, ())
    system = _system(groups, others, {c: alignments[c].offset_s for c in others})
    x, sd = _least_squares(system)
    clocks, errors = {reference_id: ClockMap()}, {reference_id: ClockError(0.0, 0.0)}
    for k, camera_id in enumerate(others):
        known = system.prior_sd[k] > 1.0
        drift = float(x[2 * k + 1]) * 1e-6 if known else 0.0
        offset_s = alignments[camera_id].offset_s + float(x[2 * k]) - drift * system.centre_s[k]
        clocks[camera_id] = ClockMap(round(offset_s * 1e9), drift)
        drift_sd = float(sd[2 * k + 1]) * 1e-6 if known else DRIFT_SD_PPM * 1e-6
        errors[camera_id] = ClockError(float(sd[2 * k]) * 1e9, drift_sd)
    timed = tuple(_retimed(group, clocks) for group in groups)
    return SyncResult(reference_id, clocks, errors, timed, alignments, _observe(timed, clocks, reference_id))


def _system(groups: Sequence[ChangeGroup], others: Sequence[str], offsets_s: Mapping[str, float]) -> _System:
    column = {camera_id: k for k, camera_id in enumerate(others)}
    own_times: list[list[float]] = [[] for _ in others]
    for group in groups:
        for camera_id, change in group.seen.items():
            if camera_id in column:
                own_times[column[camera_id]].append(change.time_ns / 1e9)
    centre_s = np.array([float(np.mean(times)) for times in own_times])
    spans = np.array([float(np.ptp(times)) for times in own_times])
    index, rough, half, rows = [], [], [], []
    for g, group in enumerate(groups):
        for camera_id, change in group.seen.items():
            row = np.zeros(2 * len(others))
            local_s = change.time_ns / 1e9
            if camera_id in column:
                k = column[camera_id]
                row[2 * k : 2 * k + 2] = 1.0, (local_s - centre_s[k]) * 1e-6
            index.append(g)
            rough.append(local_s + offsets_s.get(camera_id, 0.0) - group.time_s)
            half.append(max(change.half_interval_ns / 1e9, _SMALLEST_S))
            rows.append(row)
    return _System(
        group=np.array(index, dtype=np.int64),
        rough=np.array(rough),
        half=np.array(half),
        design=np.array(rows),
        prior_sd=np.where(spans >= _MIN_DRIFT_SPAN_S, DRIFT_SD_PPM, 1e-3),
        centre_s=centre_s,
        groups=len(groups),
    )


def _least_squares(system: _System) -> tuple[Array, Array]:
    """Huber-weighted least squares over all observations, with the drifts' Gaussian prior.

    Returns:
        x (2(C − 1),) and its standard deviations.
    """
    unknowns = system.design.shape[1]
    m = len(system.group)
    picks = np.zeros((m, system.groups))
    picks[np.arange(m), system.group] = 1.0
    rows = np.concatenate([-system.design, picks], axis=1)
    prior = np.zeros((unknowns // 2, rows.shape[1]))
    prior[np.arange(unknowns // 2), 2 * np.arange(unknowns // 2) + 1] = 1.0 / system.prior_sd
    sigma = system.half / np.sqrt(3.0)
    robust = np.ones(m)
    for _ in range(10):
        weight = np.sqrt(robust) / sigma
        A = np.concatenate([rows * weight[:, None], prior])
        b = np.concatenate([system.rough * weight, np.zeros(len(prior))])
        solution = np.linalg.lstsq(A, b, rcond=None)[0]
        error = np.abs(rows @ solution - system.rough) / sigma
        robust = np.minimum(1.0, _HUBER / np.maximum(error, 1e-12))
    covariance = np.linalg.pinv(A.T @ A)[:unknowns, :unknowns]
    freedom = max(m - system.groups - unknowns, 1)
    scatter = max(1.0, float((robust * error**2).sum()) / freedom)
    return solution[:unknowns], np.sqrt(np.diag(covariance) * scatter)


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
