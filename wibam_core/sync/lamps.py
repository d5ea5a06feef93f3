"""What a signal region shows, frame by frame: colour profiles, and the lamps that explain them.

A frame's crop becomes a *profile*: how much glowing red, amber and green there is in each of `BINS` slices along the
region's longer side. Profiles are small (36 numbers), so that a whole recording's fit in memory while its frames do
not. From all profiles of a region the lamps are learned: where each sits along the region, in what hue and how bright
this camera sees it. Each profile is then unmixed into lamps that are lit.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COLOURS = ("red", "amber", "green")
RED, AMBER, GREEN = range(3)
#: Slices along the longer side of a region.
BINS = 12
#: Hue (degrees) and weight of each colour: piecewise linear, over 0..360.
_HUE_DEG = np.array([0, 14, 24, 60, 75, 200, 225, 310, 330, 360], dtype=np.float64)
_HUE_WEIGHTS: Array = np.array(
    [
        [1, 1, 0, 0, 0, 0, 0, 0, 1, 1],
        [0, 0, 1, 1, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 1, 1, 0, 0, 0, 0],
    ],
    dtype=np.float64,
)
#: The red and the amber lamp are told apart by place and hue together: a difference of this share of the region's
#: length counts as 1, and so does this much on the scale of hues from red (0) to amber (1).
_POSITION_SCALE = 0.33
_HUE_SCALE = 0.6
#: Profiles farther apart than this, so counted, are of two lamps.
_CLUSTER_RADIUS = 0.7
#: A profile whose part that no lamp explains exceeds this share of its energy says nothing (something else is in view).
_MAX_UNEXPLAINED = 0.6


def colour_profile(crop_bgr: NDArray[np.uint8]) -> Array:
    """Glow per colour and slice of one crop (h, w, 3), uint8 BGR.

    A pixel's glow is its chroma (saturation times value, in [0, 1]): lamps are bright and saturated, roads, sky and
    dark housings are not, and an overexposed white core leaves its coloured halo.

    Returns:
        (3, BINS): mean glow of red, amber and green pixels in each slice along the longer side, from the top or left.
    """
    hsv = cv2.cvtColor(crop_bgr.astype(np.float32) / 255.0, cv2.COLOR_BGR2HSV).astype(np.float64)
    glow = hsv[..., 1] * hsv[..., 2]
    axis = 1 if crop_bgr.shape[0] >= crop_bgr.shape[1] else 0
    length = max(crop_bgr.shape[:2])
    edges = np.linspace(0.0, length, BINS + 1)
    profile = np.empty((len(COLOURS), BINS))
    for colour, weights in enumerate(_HUE_WEIGHTS):
        line = (glow * np.interp(hsv[..., 0], _HUE_DEG, weights)).mean(axis=axis)
        total = np.concatenate([[0.0], np.cumsum(line)])
        profile[colour] = np.diff(np.interp(edges, np.arange(length + 1), total)) * BINS / length
    return profile


@dataclass(frozen=True, eq=False)
class Lamps:
    """The lamps of one signal head as one camera sees them.

    Attributes:
        background: (3, BINS) glow with all lamps off.
        templates: (3, 3, BINS) added glow of the lit red, amber and green lamp; zero for a lamp never seen lit.
    """

    background: Array
    templates: Array

    @property
    def seen(self) -> tuple[bool, bool, bool]:
        """Which of red, amber and green were seen lit at all."""
        red, amber, green = (self.templates.sum(axis=(1, 2)) > 0).tolist()
        return red, amber, green

    def unmix(self, profiles: Array) -> tuple[Array, Array]:
        """Which lamps are lit.

        Args:
            profiles: (T, 3, BINS).

        Returns:
            lit (T, 3): brightness of each lamp against its usual one, clipped to [0, 1]; and trust (T,) in [0, 1]:
            0 where the lamps do not explain what is seen.
        """
        glow = (profiles - self.background).reshape(len(profiles), -1)
        atoms = self.templates.reshape(len(COLOURS), -1)
        seen = np.flatnonzero(self.seen)
        lit = np.zeros((len(profiles), len(COLOURS)))
        if len(seen) == 0 or len(profiles) == 0:
            return lit, np.zeros(len(profiles))
        lit[:, seen] = np.maximum(glow @ np.linalg.pinv(atoms[seen]), 0.0)
        unexplained = ((glow - lit @ atoms) ** 2).sum(axis=1)
        floor = 0.1 * (atoms[seen] ** 2).sum(axis=1).min()
        trust = 1.0 - unexplained / (_MAX_UNEXPLAINED * ((glow**2).sum(axis=1) + floor))
        return np.minimum(lit, 1.0), np.clip(trust, 0.0, 1.0)


def learn_lamps(profiles: Array) -> Lamps:
    """Find the lamps in all profiles (T, 3, BINS) of a region.

    The background is what is always there. Green stands out by hue; red and amber, whose hues meet when a lamp is
    overexposed or an amber one is reddish, are told apart by place and hue together: warm profiles are clustered
    (DP-means, as any number of them may be passing vehicles) and the two largest compact clusters are the two lamps,
    red being the redder one and the one farther from green.
    """
    background = np.percentile(profiles, 2.0, axis=0)
    glow = np.maximum(profiles - background, 0.0)
    energy = glow.sum(axis=2)
    total = energy.sum(axis=1)
    templates = np.zeros((len(COLOURS), len(COLOURS), BINS))
    centres, spreads = _place(glow.sum(axis=1))
    active = total > max(0.15 * float(np.percentile(total, 95)), 1e-6)
    if not active.any():
        return Lamps(background, templates)

    cool = _compact(active & (energy[:, GREEN] > 0.6 * total), spreads)
    green_at = None
    if cool.sum() >= 2:
        templates[GREEN] = np.median(glow[cool], axis=0)
        green_at = float(np.median(centres[cool]))

    warm = np.flatnonzero(_compact(active & (energy[:, GREEN] < 0.4 * total), spreads))
    if len(warm) >= 2:
        amberness = energy[warm, AMBER] / np.maximum(energy[warm, RED] + energy[warm, AMBER], 1e-12)
        lamps = _warm_clusters(centres[warm], amberness)
        levels = [float(np.median(total[warm[members]])) for members in lamps]
        lamps = [members for members, level in zip(lamps, levels, strict=True) if level > 0.2 * max(levels)][:2]
        for colour, members in _name_warm(lamps, centres[warm], amberness, green_at).items():
            templates[colour] = np.median(glow[warm[members]], axis=0)
    return Lamps(background, templates)


def _compact(frames: NDArray[np.bool_], spreads: Array) -> NDArray[np.bool_]:
    """Those of ``frames`` (T,) whose glow is not much wider than usual: no vehicle, no two lamps at once."""
    if not frames.any():
        return frames
    return frames & (spreads <= 1.25 * float(np.median(spreads[frames])) + 0.02)


def _place(lines: Array) -> tuple[Array, Array]:
    """Centre and standard deviation of energy (T, BINS) along the region, in units of its length: (T,), (T,)."""
    at = (np.arange(BINS) + 0.5) / BINS
    weight = lines / np.maximum(lines.sum(axis=1, keepdims=True), 1e-12)
    centre = weight @ at
    return centre, np.sqrt(np.maximum(weight @ at**2 - centre**2, 0.0))


def _warm_clusters(centres: Array, amberness: Array) -> list[NDArray[np.int64]]:
    """Members of each cluster of (place, hue), largest first; clusters of a single frame are left out."""
    points = np.stack([centres / _POSITION_SCALE, amberness / _HUE_SCALE], axis=1)
    means = [np.median(points, axis=0)]
    labels = np.zeros(len(points), dtype=np.int64)
    for _ in range(8):
        distance = np.linalg.norm(points[:, None] - np.array(means), axis=2)
        farthest = int(np.argmax(distance.min(axis=1)))
        grown = distance[farthest].min() > _CLUSTER_RADIUS
        if grown:
            means.append(points[farthest])
            distance = np.linalg.norm(points[:, None] - np.array(means), axis=2)
        labels = np.argmin(distance, axis=1)
        means = [np.median(points[labels == k], axis=0) for k in range(len(means)) if (labels == k).any()]
        if not grown:
            break
    members = [np.flatnonzero(labels == k) for k in range(labels.max() + 1)]
    return sorted((m for m in members if len(m) >= 2), key=len, reverse=True)


def _name_warm(
    lamps: list[NDArray[np.int64]], centres: Array, amberness: Array, green_at: float | None
) -> dict[int, NDArray[np.int64]]:
    places = [float(np.median(centres[members])) for members in lamps]
    hues = [float(np.median(amberness[members])) for members in lamps]
    if len(lamps) == 2:
        middle = 0.5 if green_at is None else green_at
        away = [abs(place - middle) / _POSITION_SCALE for place in places]
        first_is_red = (hues[1] - hues[0]) / _HUE_SCALE + away[0] - away[1] > 0
        return {RED: lamps[0], AMBER: lamps[1]} if first_is_red else {RED: lamps[1], AMBER: lamps[0]}
    if len(lamps) == 1:
        central = abs(places[0] - 0.5) < 0.22
        is_amber = hues[0] > 0.9 or (hues[0] > 0.5 and central)
        return {AMBER if is_amber else RED: lamps[0]}
    return {}
