"""By how much stated standard deviations are too small or too large, and how to put that right.

A network's standard deviations are learned where it has the labels by heart; elsewhere it errs by more than it says.
One factor for each kind of number, from frames that it did not learn from, makes up for that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from wibam_core.geometry.box3d import YAW
from wibam_core.scene import Vehicles3D

Array = NDArray[np.float64]

#: Kinds of numbers, and their columns in a box. Z is apart: on the ground plane it errs as the height does.
GROUPS: Mapping[str, slice] = MappingProxyType(
    {"position": slice(0, 2), "z": slice(2, 3), "size": slice(3, 6), "yaw": slice(6, 7)}
)
#: A factor beyond these says that something else is wrong.
FACTOR_LIMITS = (0.3, 5.0)
#: Fewer errors than this do not tell a factor.
MIN_ERRORS = 30
#: A vehicle is seen dozens of times with nearly the same error: so many errors count as much as what was learned.
_PRIOR_ERRORS = 150
#: The share of errors by whose size the factor is told: two in three are as they should be, however wrong the rest.
_ROBUST_SHARE = 0.6827


def laplace_quantile(share: float) -> float:
    """Half the width, in standard deviations, of the interval that holds this share of a Laplace distribution."""
    return -math.log(1.0 - share) / math.sqrt(2.0)


def normal_quantile(share: float) -> float:
    """The same of a normal distribution."""
    return float(ndtri(0.5 + share / 2.0))


def scale_factor(errors: Array, sd: Array) -> float | None:
    """What standard deviations (...) are to be multiplied with so that errors (...) are as large as they say.

    The errors are taken for a Laplace distribution's, which the networks' likelihood assumes; a third of them may be
    arbitrarily wrong. None where fewer than `MIN_ERRORS` have a standard deviation.
    """
    known = _known(errors, sd)
    if np.count_nonzero(known) < MIN_ERRORS:
        return None
    ratio = np.abs(errors[known]) / sd[known]
    return float(np.quantile(ratio, _ROBUST_SHARE) / laplace_quantile(_ROBUST_SHARE))


def _known(errors: Array, sd: Array) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(errors) & (sd > 0))


@dataclass(frozen=True)
class SdFactors:
    """What a network's standard deviations are multiplied with, by kind of number; 1 where nothing is known."""

    position: float = 1.0
    z: float = 1.0
    size: float = 1.0
    yaw: float = 1.0

    @classmethod
    def of(cls, errors: Array, sd: Array) -> SdFactors:
        """From errors (N, 7) and standard deviations (N, 7) of boxes; NaN where unknown.

        Factors are held to `FACTOR_LIMITS`, and drawn towards 1 where they rest on few errors.
        """
        factors = {}
        for name, columns in GROUPS.items():
            found = scale_factor(errors[:, columns], sd[:, columns])
            if found is not None:
                count = np.count_nonzero(_known(errors[:, columns], sd[:, columns]))
                factors[name] = float(np.clip(found ** (count / (count + _PRIOR_ERRORS)), *FACTOR_LIMITS))
        return cls(**factors)

    def columns(self) -> Array:
        """(7,) one factor for each number of a box."""
        factors = np.ones(7)
        for name, columns in GROUPS.items():
            factors[columns] = getattr(self, name)
        return factors

    def apply(self, vehicles: Vehicles3D) -> Vehicles3D:
        """The vehicles with these standard deviations; a heading is never less certain than not at all (π)."""
        sd = vehicles.sd * self.columns()
        sd[:, YAW] = np.minimum(sd[:, YAW], math.pi)
        return replace(vehicles, sd=sd)
