"""Which model of motion a class of road users has."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.road_users import CLASSES
from wibam_core.tracking.driving import DrivingModel
from wibam_core.tracking.motion import Array, Belief, Measurement, MotionModel, Rows
from wibam_core.tracking.walking import WalkingModel
from wibam_core.traits import Driving, Walking

_MOTIONS = [c.traits.motion for c in CLASSES]
_DRIVING = DrivingModel.of_unit_length([motion for motion in _MOTIONS if isinstance(motion, Driving)])
_WALKING = WalkingModel.of([motion for motion in _MOTIONS if isinstance(motion, Walking)])
#: (classes,) in the order of `CLASSES`: whether it walks, and its place among those that move as it does.
WALKS: NDArray[np.bool_] = np.array([isinstance(motion, Walking) for motion in _MOTIONS])
_PLACE = np.where(WALKS, np.cumsum(WALKS), np.cumsum(~WALKS)) - 1


def model_of(classes: ArrayLike, lengths_m: ArrayLike) -> MotionModel:
    """The model of road users (...) of these classes, as indices into `CLASSES`, and lengths; () or (N,) of them."""
    numbers, lengths = np.asarray(classes, dtype=np.int64), np.asarray(lengths_m, dtype=np.float64)
    walks = WALKS[numbers]
    if not walks.any():
        return _driving(numbers, lengths)
    if walks.all():
        return _WALKING.where(_PLACE[numbers])
    return MixedModel(walks, _driving(numbers[~walks], lengths[~walks]), _WALKING.where(_PLACE[numbers[walks]]))


def _driving(numbers: NDArray[np.int64], lengths_m: Array) -> DrivingModel:
    unit = _DRIVING.where(_PLACE[numbers])
    return replace(unit, axle_m=unit.axle_m * lengths_m)


@dataclass(frozen=True, eq=False)
class MixedModel:
    """A `MotionModel` of N road users, some of which drive and some walk.

    Attributes:
        walks: (N,) which do.
        driving, walking: of those that drive and of those that walk, in their order.
    """

    walks: NDArray[np.bool_]
    driving: DrivingModel
    walking: WalkingModel

    @property
    def turns_freely(self) -> NDArray[np.bool_]:
        return self.walks

    def where(self, rows: Rows) -> MixedModel:
        place = np.where(self.walks, np.cumsum(self.walks), np.cumsum(~self.walks)) - 1
        walks, place = self.walks[rows], place[rows]
        return MixedModel(walks, self.driving.where(place[~walks]), self.walking.where(place[walks]))

    def first_belief(self, measurement: Measurement) -> Belief:
        return self._beliefs(
            self.driving.first_belief(measurement.where(~self.walks)),
            self.walking.first_belief(measurement.where(self.walks)),
        )

    def predict(self, belief: Belief, dt_s: ArrayLike) -> tuple[Belief, Array]:
        dt = np.broadcast_to(np.asarray(dt_s, dtype=np.float64), self.walks.shape)
        driven, driving_step = self.driving.predict(belief.where(~self.walks), dt[~self.walks])
        walked, walking_step = self.walking.predict(belief.where(self.walks), dt[self.walks])
        return self._beliefs(driven, walked), self._joined(driving_step, walking_step)

    def centre(self, mean: Array) -> tuple[Array, Array]:
        driving, walking = self.driving.centre(mean[~self.walks]), self.walking.centre(mean[self.walks])
        return self._joined(driving[0], walking[0]), self._joined(driving[1], walking[1])

    def bounded(self, mean: Array) -> Array:
        return self._joined(self.driving.bounded(mean[~self.walks]), self.walking.bounded(mean[self.walks]))

    def halted(self, belief: Belief) -> Belief:
        return self._beliefs(
            self.driving.halted(belief.where(~self.walks)), self.walking.halted(belief.where(self.walks))
        )

    def velocity(self, mean: Array) -> tuple[Array, Array]:
        driving, walking = self.driving.velocity(mean[~self.walks]), self.walking.velocity(mean[self.walks])
        return self._joined(driving[0], walking[0]), self._joined(driving[1], walking[1])

    def travel(self, mean: Array) -> tuple[Array, Array]:
        driving, walking = self.driving.travel(mean[~self.walks]), self.walking.travel(mean[self.walks])
        return self._joined(driving[0], walking[0]), self._joined(driving[1], walking[1])

    def speed_sd(self, belief: Belief) -> Array:
        return self._joined(
            self.driving.speed_sd(belief.where(~self.walks)), self.walking.speed_sd(belief.where(self.walks))
        )

    def _beliefs(self, driving: Belief, walking: Belief) -> Belief:
        return Belief(self._joined(driving.mean, walking.mean), self._joined(driving.covariance, walking.covariance))

    def _joined(self, driving: Array, walking: Array) -> Array:
        """(N, ...) of values of those that drive and of those that walk."""
        together = np.empty((len(self.walks), *driving.shape[1:]))
        together[~self.walks], together[self.walks] = driving, walking
        return together
