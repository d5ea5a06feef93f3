"""Two clocks from road users whose places are wrong, by how much differs from place to place.

What one camera thinks of a road user's place differs from what another does by what the clocks are wrong by, times the
velocity, and by errors that have nothing to do with time: calibrations disagree smoothly over the ground, each camera
sees another side of the vehicle (which depends on the place and on the axis along which it stands, not on which way it
drives, nor how fast), each vehicle has a shape and a size of its own, and every box is a little off. How large each of
these is follows from the samples: many sizes are tried, each counts by how likely it makes them (marginal likelihood).
So where cameras agree, a few road users say much, and where they do not, they say less, and the standard deviation says
so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: Samples of one road user closer than this share their errors: one of them is taken.
_APART_S = 0.6
#: Biases are alike within about this distance; the field is a sum of bumps so far apart, m.
_BUMP_M = 12.0
#: Of a bias' variance, how much more depends on the axis of the vehicle.
_BY_AXIS = 0.5
#: Of the variance of biases that differ from place to place, in that of what is tried.
_FROM_PLACE_TO_PLACE = 0.5
#: What is tried: the standard deviation of what cameras disagree by everywhere alike, m, and what it usually is. It
#: looks like a clock that is off where all traffic goes one way at one speed; across that way it tells its size.
_SHIFT_M = (0.1, 0.3, 0.9)
_USUAL_SHIFT_M = 0.3
#: A road user that is slower than this has no axis, m/s.
_LEAST_SPEED_MPS = 2.0
#: What is tried: the standard deviation of a road user's own error, and of the biases, in those of a sample.
_OWN = (0.5, 1.0, 2.0, 4.0)
_FIELD = (0.25, 0.5, 1.0, 2.0, 4.0)
#: What the biases and the road users' own errors usually are, m, and the factor by which they may well differ.
_USUAL_M = 0.5
_FACTOR = 2.0
#: No sample is more exact than this, m.
_LEAST_SD_M = 0.05
#: Standard deviations before: of what the rough offset is wrong by (s), and of a drift.
_OFFSET_SD_S = 1.0
_DRIFT_SD = 2e-3
#: These are of samples whose two places are known so well; of others they are as many times larger or smaller, m.
_TYPICAL_SD_M = 1.0
#: A road user whose residuals are so many times the usual ones counts less.
_HUBER = 1.5
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Samples:
    """Road users (N samples) as both cameras see them at one moment, as clocks say.

    Attributes:
        road_user: (N,) ascending numbers.
        second_s: (N,) on the second camera's clock.
        point_m, velocity_mps: (N, 2) means of both. apart_m: (N, 2) the first's minus the second's.
        sd_m: (N,) standard deviations of the latter.
    """

    road_user: NDArray[np.int64]
    second_s: Array
    point_m: Array
    velocity_mps: Array
    apart_m: Array
    sd_m: Array

    def __len__(self) -> int:
        return len(self.road_user)

    def thinned(self) -> Samples:
        """Of each road user, samples that are some time apart."""
        kept, last, last_s = [], -1, 0.0
        for k in range(len(self)):
            if self.road_user[k] != last or self.second_s[k] - last_s >= _APART_S:
                kept.append(k)
                last, last_s = int(self.road_user[k]), float(self.second_s[k])
        return Samples(*(getattr(self, name)[kept] for name in vars(self)))


def solve(samples: Samples, centre_s: float, drift: float) -> tuple[Array, Array]:
    """By how much offset (s, at ``centre_s`` of the second clock) and drift are wrong, and their covariance (2, 2).

    A first camera's clock that is thought to be ``e`` too late sees road users ``e`` further on: they are apart by
    ``- velocity * e`` and by the biases.

    Args:
        samples: road users in both cameras.
        centre_s: of the offset.
        drift: that was assumed.
    """
    samples = samples.thinned()
    n = len(samples)
    field = _field(samples)
    scale = (samples.sd_m / _TYPICAL_SD_M)[:, None]
    speed = samples.velocity_mps / scale
    clock = np.stack([speed, speed * (samples.second_s - centre_s)[:, None]], axis=2)
    width = field.shape[1]
    design = np.zeros((n, 2, 2 + 2 * width))
    design[:, :, :2] = clock
    for k in (0, 1):
        design[:, k, 2 + k * width : 2 + (k + 1) * width] = field / scale
    # first = second + offset: where the first is truly at second + offset + e, it was compared e too early.
    observed = -samples.apart_m / scale
    everywhere = np.zeros(2 + 2 * width, dtype=bool)
    everywhere[[2 + k * width + axis * (width // 3) for k in (0, 1) for axis in range(3)]] = True
    first = np.flatnonzero(np.diff(samples.road_user, prepend=-1))
    model = _Model.of(design, observed, _own(samples), first, np.array([0.0, -drift]), everywhere)
    weight = np.ones(len(first))
    for _ in range(_ROUNDS):
        tried = [
            one.solved(spread, shift_m)
            for one in (model.without_own(weight, own) for own in _OWN)
            for spread in _FIELD
            for shift_m in _SHIFT_M
        ]
        odds = np.exp([one.likely - max(other.likely for other in tried) for one in tried])
        odds /= odds.sum()
        solution = np.tensordot(odds, [one.solution for one in tried], 1)
        left = observed - design @ solution
        rms = np.sqrt(np.add.reduceat((left**2).sum(axis=1), first) / np.diff(np.append(first, n)) / 2)
        usual = max(1.5 * float(np.median(rms)), 1e-6)
        weight = np.minimum(1.0, (_HUBER * usual / np.maximum(rms, 1e-9)) ** 2)
    covariance = np.zeros((2, 2))
    for share, one in zip(odds, tried, strict=True):
        apart = one.solution[:2] - solution[:2]
        covariance += share * (one.covariance + np.outer(apart, apart))
    return solution[:2], covariance


@dataclass(frozen=True, eq=False)
class _Solved:
    likely: float
    solution: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class _Model:
    """A linear mixed model: clock and field (U unknowns), errors of each of G road users' own (E), and of each sample.

    Attributes:
        squares: (G, U, U) ``AᵀA`` of each road user's samples. right: (G, U) ``Aᵀb``. square: (G,) ``bᵀb``.
        own: (G, E, E), own_design: (G, E, U), own_right: (G, E): ``ZᵀZ``, ``ZᵀA``, ``Zᵀb``, where Z is what its own
            errors do to its samples.
        sizes: (G,) samples. told: (2,) what is known of the clock before.
        everywhere: (U,) which of the unknowns are biases that are the same everywhere.
    """

    squares: Array
    right: Array
    square: Array
    own: Array
    own_design: Array
    own_right: Array
    sizes: IntArray
    told: Array
    everywhere: BoolArray

    @classmethod
    def of(cls, A: Array, b: Array, Z: Array, first: IntArray, told: Array, everywhere: BoolArray) -> _Model:
        """From design (N, 2, U), what is observed (N, 2), own errors (N, 2, E) and each road user's first sample."""
        bounds = [*first.tolist(), len(b)]
        parts = [
            (A[i:j].reshape(-1, A.shape[2]), b[i:j].ravel(), Z[i:j].reshape(-1, Z.shape[2]))
            for i, j in pairwise(bounds)
        ]
        return cls(
            squares=np.array([a.T @ a for a, _, _ in parts]),
            right=np.array([a.T @ y for a, y, _ in parts]),
            square=np.array([y @ y for _, y, _ in parts]),
            own=np.array([z.T @ z for _, _, z in parts]),
            own_design=np.array([z.T @ a for a, _, z in parts]),
            own_right=np.array([z.T @ y for _, y, z in parts]),
            sizes=np.diff(bounds),
            told=told,
            everywhere=everywhere,
        )

    def without_own(self, weight: Array, own: float) -> _Reduced:
        """What is left of the problem once road users' own errors are solved for.

        Args:
            weight: (G,) of each road user.
            own: standard deviation of a road user's own errors, in those of a sample.
        """
        inner = np.linalg.cholesky(np.linalg.inv(np.eye(self.own.shape[1]) / own**2 + self.own))
        M = (np.swapaxes(inner, 1, 2) @ self.own_design) * np.sqrt(weight)[:, None, None]
        m = np.einsum("gij,gi->gj", inner, self.own_right) * np.sqrt(weight)[:, None]
        flat = M.reshape(-1, M.shape[2])
        return _Reduced(
            squares=np.tensordot(weight, self.squares, 1) - flat.T @ flat,
            right=weight @ self.right - flat.T @ m.ravel(),
            square=float(weight @ self.square - (m**2).sum()),
            count=2.0 * float(weight @ self.sizes),
            complexity=weight @ np.linalg.slogdet(np.eye(self.own.shape[1]) + own**2 * self.own)[1],
            own=own,
            told=self.told,
            everywhere=self.everywhere,
        )


@dataclass(frozen=True, eq=False)
class _Reduced:
    """Clock and field alone (U unknowns), where own errors have one size.

    Attributes:
        squares: (U, U). right: (U,). square: as of `_Model`, of all road users together.
        count: of observed coordinates, by weight.
        complexity: what that size costs in likelihood.
        own: the size.
        told, everywhere: as of `_Model`.
    """

    squares: Array
    right: Array
    square: float
    count: float
    complexity: float
    own: float
    told: Array
    everywhere: BoolArray

    def solved(self, spread: float, shift_m: float) -> _Solved:
        """The clock, where biases differ from place to place by ``spread`` times a sample's error, and are ``shift_m``
        everywhere."""
        A, b, count = self.squares, self.right, self.count
        sd_m = _LEAST_SD_M
        for _ in range(3):
            prior = np.where(self.everywhere, (sd_m / shift_m) ** 2, spread**-2.0)
            prior[:2] = (sd_m / _OFFSET_SD_S) ** 2, (sd_m / _DRIFT_SD) ** 2
            told = np.zeros(len(A))
            told[:2] = self.told
            factor = cho_factor(A + np.diag(prior), lower=True)
            solution = np.asarray(cho_solve(factor, b + prior * told))
            left = self.square - 2 * solution @ b + solution @ A @ solution + (prior * (solution - told) ** 2).sum()
            sd_m = max(float(np.sqrt(max(float(left), 0.0) / count)), _LEAST_SD_M)
        complexity = 2 * np.log(np.diag(factor[0])).sum() - np.log(prior).sum()
        complexity += self.complexity
        sizes = np.array([self.own * sd_m / _USUAL_M, spread * sd_m / _USUAL_M, shift_m / _USUAL_SHIFT_M])
        unusual = np.log(sizes) / np.log(_FACTOR)
        likely = -0.5 * (float(left) / sd_m**2 + 2 * count * np.log(sd_m) + complexity + (unusual**2).sum())
        covariance = cho_solve(factor, np.eye(len(A), 2))[:2] * sd_m**2
        return _Solved(float(likely), solution, covariance)


def _own(samples: Samples) -> Array:
    """(N, 2, 3) what a road user's own errors do to its samples: east, north, and ahead of the vehicle."""
    speed = np.linalg.norm(samples.velocity_mps, axis=1, keepdims=True)
    ahead = samples.velocity_mps / np.maximum(speed, _LEAST_SPEED_MPS)
    return np.concatenate([np.broadcast_to(np.eye(2), (len(samples), 2, 2)), ahead[:, :, None]], axis=2)


def _field(samples: Samples) -> Array:
    """(N, F) functions of place and axis, of which a bias is a random sum: the first, and the first of each third of
    them, is the same everywhere."""
    place = np.column_stack([np.ones(len(samples)), np.sqrt(_FROM_PLACE_TO_PLACE) * _bumps(samples.point_m)])
    turn = 2 * np.arctan2(samples.velocity_mps[:, 1], samples.velocity_mps[:, 0])
    moving = np.minimum(np.linalg.norm(samples.velocity_mps, axis=1) / _LEAST_SPEED_MPS, 1.0)
    by_axis = np.sqrt(_BY_AXIS) * moving[:, None] * place
    return np.concatenate([place, by_axis * np.cos(turn)[:, None], by_axis * np.sin(turn)[:, None]], axis=1)


def _bumps(points_m: Array) -> Array:
    """(N, B) bumps on a grid around the points, the sum of whose squares is 1 everywhere."""
    cells = np.unique(np.rint(points_m / _BUMP_M), axis=0)
    apart = ((points_m[:, None] - cells * _BUMP_M) ** 2).sum(axis=2)
    bumps = np.exp(-apart / (2 * (0.7 * _BUMP_M) ** 2))
    return np.asarray(bumps / np.sqrt((bumps**2).sum(axis=1, keepdims=True)))


def joined(parts: Sequence[Samples]) -> Samples:
    """Samples of several road users as one; none of none."""
    if not parts:
        nothing = np.empty((0, 2))
        return Samples(np.empty(0, np.int64), np.empty(0), nothing, nothing, nothing, np.empty(0))
    return Samples(*(np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])))
