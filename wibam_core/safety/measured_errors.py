"""How the tracks of one site err, by what all of its views say together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wibam_core.geometry.box3d import LENGTH, XY, YAW, X, Y
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.safety.track_errors import TrackErrors
from wibam_core.scene import Track, Vehicles3D

Array = NDArray[np.float64]

#: A track's state is compared with a fit that lies nearer than this, m.
_NEAR_M = 2.0
#: So many comparisons count as much as what was known before.
_PRIOR_COMPARISONS = 150
_PRIOR_PRODUCTS = 400
_FACTOR_LIMITS = (0.7, 3.0)
_DURATIONS_S = np.array([0.4, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0, 2.5, 3.0])
#: Errors farther apart in time than this say nothing of how long they last.
_LONGEST_LAG_S = 3.0
_ROBUST_SHARE = 0.6827


@dataclass(frozen=True, eq=False)
class _Comparison:
    """Errors of one track against the fits (K, 4): along, across, yaw, length, in standard deviations of both."""

    time_s: Array
    errors: Array


def measured_errors(tracks: Sequence[Track], fits: Iterable[Vehicles3D], prior: TrackErrors) -> TrackErrors:
    """How the tracks of a site err, by the fits to all views of instants that the network did not learn from.

    Fits err as well, so that differences are compared with the standard deviations of both. Few comparisons change
    little of what is known of other sites.

    Args:
        tracks: of the site.
        fits: of instants of the validation part.
        prior: of other sites.
    """
    compared = _compared(tracks, fits)
    if not compared:
        return prior
    every = np.concatenate([c.errors for c in compared])
    share = len(every) / (len(every) + _PRIOR_COMPARISONS)
    # of normal errors, 68 % are smaller than their standard deviation
    size = np.quantile(np.abs(every), _ROBUST_SHARE, axis=0)
    factors = np.array([prior.along, prior.across, prior.yaw, prior.size])
    factors = np.exp((1 - share) * np.log(factors) + share * np.log(np.clip(size, *_FACTOR_LIMITS)))
    lasts = [
        _lasting_s(compared, column, before)
        for column, before in enumerate((prior.along_s, prior.across_s, prior.yaw_s))
    ]
    return TrackErrors(*factors.tolist(), *lasts)


def _compared(tracks: Sequence[Track], fits: Iterable[Vehicles3D]) -> list[_Comparison]:
    rows: dict[int, list[tuple[float, Array]]] = {}
    for fitted in fits:
        here = [(t, int(k)) for t in tracks if (k := np.searchsorted(t.times_ns, fitted.time_ns)) < len(t)]
        here = [(t, k) for t, k in here if t.times_ns[k] == fitted.time_ns]
        if not here or not len(fitted):
            continue
        boxes, sd = np.array([t.boxes[k] for t, k in here]), np.array([t.sd[k] for t, k in here])
        gaps = np.linalg.norm(boxes[:, None, XY] - fitted.boxes[None, :, XY], axis=-1)
        i, j = linear_sum_assignment(np.minimum(gaps, 10 * _NEAR_M))
        for one, other in zip(i.tolist(), j.tolist(), strict=True):
            if gaps[one, other] < _NEAR_M:
                error = _difference(boxes[one], sd[one], fitted.boxes[other], fitted.sd[other])
                rows.setdefault(here[one][0].track_id, []).append((fitted.time_ns * 1e-9, error))
    return [_Comparison(np.array([t for t, _ in of]), np.array([e for _, e in of])) for of in rows.values()]


def _difference(box: Array, sd: Array, fit: Array, fit_sd: Array) -> Array:
    c, s = np.cos(fit[YAW]), np.sin(fit[YAW])
    offset, both = box[XY] - fit[XY], np.hypot(np.nan_to_num(sd), np.nan_to_num(fit_sd))
    yaw = 0.5 * float(normalise_angle(2 * (box[YAW] - fit[YAW])))
    sd_along, sd_across = np.hypot(c * both[X], s * both[Y]), np.hypot(s * both[X], c * both[Y])
    numbers = [c * offset[0] + s * offset[1], c * offset[1] - s * offset[0], yaw, box[LENGTH] - fit[LENGTH]]
    return np.array(numbers) / np.maximum([sd_along, sd_across, both[YAW], both[LENGTH]], 1e-6)


def _lasting_s(compared: Sequence[_Comparison], column: int, before_s: float) -> float:
    """The time for which products of errors at two times fit best, amplitude free, drawn to what is known."""
    lags, products = [], []
    for c in compared:
        i, j = np.triu_indices(len(c.time_s), 1)
        near = np.abs(c.time_s[j] - c.time_s[i]) <= _LONGEST_LAG_S
        errors = np.clip(c.errors[:, column], -4, 4)
        lags.append(np.abs(c.time_s[j] - c.time_s[i])[near])
        products.append((errors[i] * errors[j])[near])
    lag, product = np.concatenate(lags), np.concatenate(products)
    if len(lag) < _PRIOR_PRODUCTS / 4:
        return before_s
    shapes = np.exp(-0.5 * (lag / _DURATIONS_S[:, None]) ** 2)
    amplitude = np.clip((shapes * product).sum(axis=1) / np.maximum((shapes**2).sum(axis=1), 1e-9), 0.0, None)
    wrong = ((product - amplitude[:, None] * shapes) ** 2).sum(axis=1)
    found = float(_DURATIONS_S[int(np.argmin(wrong))])
    share = len(lag) / (len(lag) + _PRIOR_PRODUCTS)
    return float(np.exp((1 - share) * np.log(before_s) + share * np.log(found)))
