"""Which model of motion a class of road users has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from wibam_core.road_users import CLASSES
from wibam_core.tracking.driving import DrivingModel
from wibam_core.tracking.motion import MotionModel

#: (classes,) in the order of `CLASSES`.
_OF_UNIT_LENGTH = DrivingModel.of_unit_length([c.traits.motion for c in CLASSES])


def model_of(classes: ArrayLike, lengths_m: ArrayLike) -> MotionModel:
    """The model of road users (...) of these classes, as indices into `CLASSES`, and lengths."""
    unit = _OF_UNIT_LENGTH.where(np.asarray(classes))
    return replace(unit, axle_m=unit.axle_m * np.asarray(lengths_m, dtype=np.float64))
