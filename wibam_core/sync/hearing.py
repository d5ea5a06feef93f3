"""Two cameras' clocks from what both recordings sound like: a witness that confirms or decides, and never stands alone.

What is loud at one camera is loud at the other, later by the way that sound takes: up to 90 ms for cameras 30 m apart,
and nobody knows where its source was. Cameras' sound tracks lie beside their pictures by tens of milliseconds, too. So
sound tells clocks to a tenth of a second at best, which says which cycle of a signal it was, and measures nothing.

Compared is how suddenly it grows louder, in several bands, not how loud it is: a vehicle that passes one camera after
the other is slowly loud in both, at two times. Sounds of one recording, cut into windows, are compared with the other's
at every offset, and summed over all windows along every drift that clocks of cameras have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import uniform_filter1d

from wibam_core.video.sound import STEP_S, Sound

Array = NDArray[np.float64]

#: At 20 °C.
_SPEED_OF_SOUND_MPS = 343.0
#: How far a camera's sound may lie beside its pictures, standard deviation: broadcasters want to stay within
#: +45 and -125 ms, from where on viewers notice (ITU-R BT.1359-1).
_BESIDE_PICTURES_S = 0.05
#: Crystals: recordings whose frame rate is not what it claims to be have their sound right.
_MAX_DRIFT = 3e-4
_WINDOW_S = 40.0
#: Two recordings that overlap by less say nothing.
_LEAST_S = 20.0
#: What is before counts as the usual loudness; what grows for longer than this is no sudden sound.
_BEFORE_STEPS, _SLOW_STEPS = 4, 40
#: One sudden sound counts no more than this, in root mean squares of all.
_LOUDEST = 3.0
#: Loudness below this share of the usual one is silence.
_SILENCE = 1e-3
#: An offset is believed if what meets under it is beyond chance by so many standard deviations, and so many times what
#: meets under any offset that lies farther from it than this.
_LEAST_STRENGTH = 6.0
_LEAST_CONTRAST, _LEAST_WITHOUT_LOUDEST = 1.4, 0.7
_SAME_S = 0.5
#: Seconds that are left out to see whether the rest says the same.
_SPARED = 3
#: Of drifts under which as much meets, but for this share, the smallest is taken.
_AS_GOOD = 0.98


@dataclass(frozen=True)
class SoundAlignment:
    """What the sound says of two cameras' clocks.

    Attributes:
        first_id, second_id: the cameras.
        first_s, second_s: one moment on either clock: when the first shows ``first_s``, the second shows ``second_s``.
        drift: ``d(first) = (1 + drift) d(second)``, roughly.
        strength: by how many standard deviations what meets is more than by chance.
        contrast: by how much more meets than under the best other offset.
        contrast_without_loudest: the same without the seconds in which most meets, since few loud sounds that meet may
            well be chance.
        way_s: how long sound takes from one camera to the other.
    """

    first_id: str
    second_id: str
    first_s: float
    second_s: float
    drift: float
    strength: float
    contrast: float
    contrast_without_loudest: float
    way_s: float

    @property
    def is_clear(self) -> bool:
        enough = self.contrast >= _LEAST_CONTRAST and self.contrast_without_loudest >= _LEAST_WITHOUT_LOUDEST
        return enough and self.strength >= _LEAST_STRENGTH

    @property
    def offset_s(self) -> float:
        """By how much the first clock shows more than the second, at that moment."""
        return self.first_s - self.second_s

    @property
    def sd_s(self) -> float:
        """Standard deviation of the offset: nobody knows where the sounds were made, nor how exact sound tracks are."""
        return float(np.hypot(self.way_s / np.sqrt(3.0), np.sqrt(2.0) * _BESIDE_PICTURES_S))


def align_by_sound(
    first_id: str, first: Sound, second_id: str, second: Sound, distance_m: float
) -> SoundAlignment | None:
    """Offset and drift of two cameras, from their sound; None where they cannot be compared.

    Args:
        first_id: one camera.
        first: what it recorded, on its own clock.
        second_id: the other camera.
        second: what that recorded.
        distance_m: how far the cameras hang from each other.
    """
    least = round(_LEAST_S / STEP_S)
    if min(len(first.power), len(second.power)) < least:
        return None
    one, other = _sudden(first), _sudden(second)
    if min(np.count_nonzero(one.any(axis=1)), np.count_nonzero(other.any(axis=1))) < least:
        return None
    sums, met, drifts, middle = _compared(one, np.isfinite(first.power[:, 0]), other, np.isfinite(second.power[:, 0]))
    possible = met >= least
    if not possible.any():
        return None
    # one sound comes earlier, another later, by where it was made
    way_s = distance_m / _SPEED_OF_SOUND_MPS
    way = 1 + 2 * round(way_s / STEP_S)
    strength = np.where(possible, uniform_filter1d(sums, way, axis=1) / np.sqrt(np.maximum(met, 1.0)), 0.0)
    usual = strength[len(drifts) // 2, possible]
    strength /= max(float(1.4826 * np.median(np.abs(usual - np.median(usual)))), 1e-9)
    peak = strength.max(axis=1)
    drift = min(np.flatnonzero(peak >= _AS_GOOD * peak.max()), key=lambda k: abs(drifts[k]))
    lag = int(strength[drift].argmax())
    best = float(strength[drift, lag])
    elsewhere = np.abs(np.arange(strength.shape[1]) - lag) > _SAME_S / STEP_S + way
    rival = max(float(strength[:, elsewhere].max(initial=0.0)), 1.0)
    shift = lag - (len(other) - 1)  # a lag of 0 puts the end of the second where the first begins
    together = _together(one, other, shift, float(drifts[drift]), middle, way)
    rest = np.sort(together)[: max(len(together) - _SPARED, 0)].sum() / max(together.sum(), 1e-9)
    return SoundAlignment(
        first_id,
        second_id,
        first.first_s + STEP_S * (middle + shift),
        second.first_s + STEP_S * middle,
        float(drifts[drift]),
        best,
        best / rival,
        float(best * rest / rival),
        way_s,
    )


def _together(
    one: NDArray[np.float32], other: NDArray[np.float32], shift: int, drift: float, middle: float, way: int
) -> Array:
    """(S,) what meets in each second of the second recording."""
    steps = np.arange(len(other))
    met = steps + shift + np.rint(drift * (steps - middle)).astype(np.int64)
    inside = (met >= 0) & (met < len(one))
    near = uniform_filter1d(one, way, axis=0)
    products = np.zeros(len(other))
    products[inside] = (near[met[inside]] * other[inside]).sum(axis=1)
    second = round(1 / STEP_S)
    return np.add.reduceat(products, np.arange(0, len(products), second))


def _sudden(sound: Sound) -> NDArray[np.float32]:
    """(N, bands) how suddenly it grows louder, root mean square 1, less what it does over a second; 0 in silence."""
    power, known = sound.power, np.isfinite(sound.power[:, 0])
    loud = np.nan_to_num(power)
    heard = [band[band > 0] for band in loud.T]
    loud = np.log(loud + [_SILENCE * np.median(band) if len(band) else 1.0 for band in heard])
    loud[~known] = loud[known].mean(axis=0) if known.any() else 0.0
    before = uniform_filter1d(loud, _BEFORE_STEPS, axis=0, origin=_BEFORE_STEPS // 2 - 1)
    grown = np.zeros_like(loud)
    grown[1:] = np.maximum(loud[1:] - before[:-1], 0.0)
    scale = np.sqrt(np.mean(grown[known] ** 2, axis=0)) if known.any() else np.zeros(power.shape[1])
    grown = np.minimum(grown / np.where(scale > 1e-6, scale, np.inf), _LOUDEST)
    grown -= uniform_filter1d(grown, _SLOW_STEPS, axis=0)
    grown[~known] = 0.0
    return grown.astype(np.float32)


def _compared(
    one: NDArray[np.float32], one_known: NDArray[np.bool_], other: NDArray[np.float32], other_known: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], Array, Array, float]:
    """What meets, at every drift and lag.

    Returns:
        (drifts, lags) the sum of products, (lags,) over how many steps, (drifts,) the drifts, and the step of
        ``other`` at which drifts move nothing. With lag ``k`` step ``j`` of it meets step ``j + k - (len(other) - 1)``.
    """
    window = round(_WINDOW_S / STEP_S)
    size = fft.next_fast_len(len(one) + window, real=True)
    spectrum, known = fft.rfft(one, size, axis=0), fft.rfft(one_known.astype(np.float32), size)
    lags, middle = len(one) + len(other) - 1, (len(other) - 1) / 2
    reach = _MAX_DRIFT * len(other) / 2
    steps = int(np.ceil(reach))
    drifts = np.linspace(-_MAX_DRIFT, _MAX_DRIFT, 2 * steps + 1)
    sums, met = np.zeros((len(drifts), lags), np.float32), np.zeros(lags)
    for begin in range(0, len(other), window):
        part = other[begin : begin + window]
        if not part.any():
            continue
        products = fft.irfft((spectrum * fft.rfft(part, size, axis=0).conj()).sum(axis=1), size)
        overlap = fft.irfft(known * fft.rfft(other_known[begin : begin + window].astype(np.float32), size).conj(), size)
        # the window's first step meets step -(len(part) - 1) of the other first, which stands at the end
        order = np.arange(-(len(part) - 1), len(one))
        place = len(other) - 1 - begin - (len(part) - 1)
        met[place : place + len(order)] += np.maximum(np.rint(overlap[order]), 0.0)
        since = begin + (len(part) - 1) / 2 - middle
        for k, drift in enumerate(drifts):
            # under this drift the window lies later by so much than in the middle: seen from there, earlier
            at = place - round(drift * since)
            low, high = max(at, 0), min(at + len(order), lags)
            sums[k, low:high] += products[order[low - at : high - at]].astype(np.float32)
    return sums, met, drifts, middle
