"""Headings of tracks from their motion: along the course where a vehicle moves, and held where it stands.

A vehicle turns only as far as it drives. Places err by jumps whenever another camera begins or stops to see a vehicle,
and a jump of a standing vehicle looks like motion. How far a course is believed therefore depends on the way made
around it, as far as pictures confirm it (`way_seen`), and between two moments a heading may change only by what the way
between them allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.se3 import normalise_angle
from wibam_core.lifting.trajectory import Motion, Tracks
from wibam_core.road_users import CLASSES
from wibam_core.scene import FloatArray, IntArray

#: How far a course (the direction of the velocity) is believed depends on the way that the vehicle makes in this many
#: seconds before and after.
HALF_WINDOW_S = 1.5
#: A track has a heading by motion if the standard deviation of one of its courses is at most this, rad.
_KNOWN_SD_RAD = 0.35
#: Courses with a larger standard deviation than this are not looked at, rad.
_USELESS_SD_RAD = 1.2
#: (classes,) in the order of `CLASSES`: see `wibam_core.traits.Driving`.
_TURN_RAD_PER_M: FloatArray = np.array([c.traits.motion.turn_rad_per_m for c in CLASSES])
_AXLE_M: FloatArray = np.array([c.traits.motion.axle_m for c in CLASSES])
#: Variance of a heading before any course was seen, rad².
_NOTHING_KNOWN = 1e6
#: Courses that lie farther than this many standard deviations off the smoothed heading count less, in so many passes.
_ROBUST_SD = 2.5
_ROBUST_PASSES = 2
#: Courses are never trusted to be better than this (rad): vehicles slip and drift in their lanes.
_COURSE_FLOOR_RAD = 0.03
#: A vehicle slower than this stands, as far as its heading is concerned, and keeps the heading that it had.
_MOVING_MPS = 1.5
#: Standard deviation that keeping a heading adds.
_HELD_SD_RAD = 0.06


@dataclass(frozen=True, eq=False)
class Headings:
    """Heading by motion of M tracks: yaw (M, T) and its s.d. (M, T), rad; infinite for a track that never moves."""

    yaw_rad: FloatArray
    sd_rad: FloatArray


@dataclass(frozen=True, eq=False)
class _Way:
    """Of every moment (M, T): the way made around it and the speed that this amounts to, less what jumps explain."""

    made_m: FloatArray
    speed_mps: FloatArray


def headings(
    tracks: Tracks, classes: IntArray, motion: Motion, jump_m: float, seen_share: FloatArray | None = None
) -> Headings:
    """Direction of travel where a vehicle moves; where it stands, what it was before and will be after.

    Args:
        tracks: M tracks of at most T observations.
        classes: (M,) of the tracks, indices into `wibam_core.road_users.CLASSES`.
        motion: of them, smoothed.
        jump_m: standard deviation of the places' errors that do not average out over time.
        seen_share: (M, T) how much of the way made around each moment the pictures confirm, 0 to 1; all if not given.
    """
    way = _way(tracks, motion, jump_m, np.ones(tracks.valid.shape) if seen_share is None else seen_share)
    speed = np.linalg.norm(motion.velocity, axis=-1)
    course = np.arctan2(motion.velocity[..., 1], motion.velocity[..., 0])
    course_sd = np.hypot(_course_sd(motion, speed), np.sqrt(2) * jump_m / np.maximum(way.made_m, 1e-6))
    told = tracks.valid & (course_sd < _USELESS_SD_RAD)
    known = (told & (course_sd < _KNOWN_SD_RAD)).any(axis=1)
    noise = np.where(told, course_sd**2 + _COURSE_FLOOR_RAD**2, np.inf)
    step = np.diff(tracks.times_s, axis=1)
    turn = (_TURN_RAD_PER_M[classes, None] * 0.5 * (way.speed_mps[:, 1:] + way.speed_mps[:, :-1]) * step) ** 2 + 1e-8
    measured = _unwrapped(course, noise, turn)
    yaw, variance = _smoothed(measured, noise, turn)
    for _ in range(_ROBUST_PASSES):
        off = np.where(told, measured - yaw, 0.0)
        yaw, variance = _smoothed(measured, noise + (off / _ROBUST_SD) ** 2, turn)
    slip = _slip(tracks, _AXLE_M[classes], yaw, speed)
    held = np.where(speed > _MOVING_MPS, 0.0, _HELD_SD_RAD)
    sd = np.sqrt(variance + _COURSE_FLOOR_RAD**2 + slip**2 + held**2)
    return Headings(np.where(known[:, None], yaw, 0.0), np.where(known[:, None], sd, np.inf))


def telling(tracks: Tracks, motion: Motion, jump_m: float) -> np.ndarray:
    """(M, T) moments around which so much way is made that a course may be believed, if pictures confirm it."""
    return np.asarray(_made(tracks, motion) > np.sqrt(2) * jump_m / _USELESS_SD_RAD)


def _made(tracks: Tracks, motion: Motion) -> FloatArray:
    """(M, T) way from the beginning to the end of the window around each moment, m."""
    made = np.zeros(tracks.valid.shape)
    for k, count in enumerate(tracks.valid.sum(axis=1)):
        times, places = tracks.times_s[k, :count], motion.position[k, :count]
        first, last = _window(times)
        moved = [np.interp(last, times, places[:, axis]) - np.interp(first, times, places[:, axis]) for axis in (0, 1)]
        made[k, :count] = np.hypot(*moved)
    return made


def _window(times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Beginnings and ends (T,) of the windows around each of a track's moments (T,)."""
    return np.maximum(times_s - HALF_WINDOW_S, times_s[0]), np.minimum(times_s + HALF_WINDOW_S, times_s[-1])


def _way(tracks: Tracks, motion: Motion, jump_m: float, seen_share: FloatArray) -> _Way:
    made, speed = _made(tracks, motion) * seen_share, np.zeros(tracks.valid.shape)
    for k, count in enumerate(tracks.valid.sum(axis=1)):
        first, last = _window(tracks.times_s[k, :count])
        speed[k, :count] = np.maximum(made[k, :count] - 1.5 * jump_m, 0.0) / np.maximum(last - first, 1e-3)
    return _Way(made, speed)


def _course_sd(motion: Motion, speed: FloatArray) -> FloatArray:
    """(M, T) s.d. of the direction of the velocity."""
    across = np.stack([-motion.velocity[..., 1], motion.velocity[..., 0]], axis=-1) / np.maximum(speed, 1e-6)[..., None]
    variance = np.einsum("mti,mtij,mtj->mt", across, motion.covariance[..., 2:, 2:], across)
    return np.asarray(np.sqrt(np.maximum(variance, 0)) / np.maximum(speed, 1e-6))


def _unwrapped(course: FloatArray, noise: FloatArray, turn: FloatArray) -> FloatArray:
    """The courses (M, T) without jumps by whole turns, followed outwards from each track's most certain one."""
    m, t = course.shape
    result = course.copy()
    if not m or not t:
        return result
    rows = np.arange(m)
    seed = noise.argmin(axis=1)
    for direction in (1, -1):
        yaw, variance = course[rows, seed], np.minimum(noise[rows, seed], _NOTHING_KNOWN)
        for step in range(1, t):
            at = seed + direction * step
            inside = (at >= 0) & (at < t)
            at = np.clip(at, 0, t - 1)
            between = np.minimum(at, at - direction)
            variance = variance + turn[rows, np.clip(between, 0, t - 2)]
            off = normalise_angle(course[rows, at] - yaw)
            gain = variance / (variance + noise[rows, at] + (off / _ROBUST_SD) ** 2)  # 0 where the noise is infinite
            gain = np.where(inside, gain, 0.0)
            result[rows[inside], at[inside]] = (yaw + off)[inside]
            yaw, variance = yaw + gain * off, variance * (1 - gain)
    return result


def _smoothed(measured: FloatArray, noise: FloatArray, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Random walk with step variances ``turn`` (M, T − 1) through measurements: mean and variance (M, T) (RTS)."""
    m, t = measured.shape
    mean, variance = np.zeros((m, t)), np.full((m, t), _NOTHING_KNOWN)
    if not m or not t:
        return mean, variance
    now, now_variance = np.zeros(m), np.full(m, _NOTHING_KNOWN)
    for k in range(t):
        if k:
            now_variance = now_variance + turn[:, k - 1]
        gain = np.where(np.isfinite(noise[:, k]), now_variance / (now_variance + noise[:, k]), 0.0)
        now, now_variance = now + gain * (measured[:, k] - now), now_variance * (1 - gain)
        mean[:, k], variance[:, k] = now, now_variance
    for k in range(t - 2, -1, -1):
        prior = variance[:, k] + turn[:, k]
        back = variance[:, k] / prior
        mean[:, k] += back * (mean[:, k + 1] - mean[:, k])
        variance[:, k] += back**2 * (variance[:, k + 1] - prior)
    return mean, variance


def _slip(tracks: Tracks, axle_m: FloatArray, yaw: FloatArray, speed: FloatArray) -> FloatArray:
    """(M, T) how far, in a bend, the course of the centre may be off the heading (rad): the rear axle, which runs
    ``axle_m`` (M,) behind the centre, is what follows the heading."""
    step = np.diff(tracks.times_s, axis=1)
    rate: NDArray[np.float64] = np.zeros_like(yaw)
    if step.shape[1]:
        change = np.abs(np.diff(yaw, axis=1)) / np.maximum(step, 1e-3)
        rate[:, 1:] += change / 2
        rate[:, :-1] += change / 2
    bend = np.where(speed > _MOVING_MPS, rate / np.maximum(speed, 1e-6), 0.0)
    return np.asarray(0.5 * np.arctan(axle_m[:, None] * bend))
