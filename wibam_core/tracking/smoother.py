"""Rauch–Tung–Striebel smoothing: every state from all measurements, earlier and later."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.se3 import normalise_angle
from wibam_core.tracking.motion import STATES, YAW, Belief, Measurement, MotionModel, update


def smooth(model: MotionModel, times_ns: NDArray[np.int64], measurements: Mapping[int, Measurement]) -> list[Belief]:
    """Smoothed beliefs at ``times_ns`` (ascending), the first of which was measured.

    Args:
        model: how the road user moves.
        times_ns: instants; those without a measurement are bridged.
        measurements: by instant.
    """
    belief = model.first_belief(measurements[int(times_ns[0])])
    filtered, predicted, steps = [belief], [belief], [np.eye(STATES)]
    for before, now in pairwise(times_ns):
        expected, F = model.predict(belief, float(now - before) * 1e-9)
        measurement = measurements.get(int(now))
        belief = expected if measurement is None else update(model, expected, measurement)
        filtered.append(belief)
        predicted.append(expected)
        steps.append(F)
    smoothed = [filtered[-1]]
    for k in range(len(filtered) - 2, -1, -1):
        ahead = predicted[k + 1]
        gain = np.linalg.solve(ahead.covariance, steps[k + 1] @ filtered[k].covariance).T
        difference = smoothed[-1].mean - ahead.mean
        difference[YAW] = normalise_angle(difference[YAW])
        mean = filtered[k].mean + gain @ difference
        mean[YAW] = normalise_angle(mean[YAW])
        covariance = filtered[k].covariance + gain @ (smoothed[-1].covariance - ahead.covariance) @ gain.T
        smoothed.append(Belief(mean, 0.5 * (covariance + covariance.T)))
    return smoothed[::-1]
