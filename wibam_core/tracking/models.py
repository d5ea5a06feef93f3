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

#: Who looks back at a whole track knows that most of an acceleration lasts, and most of a turn: the shares of what is
#: not foreseen of the acceleration that come and go at once, and that last; and how much less the curvature drifts, and
#: how many times as long it takes to straighten (benchmarks/tracking.py).
_AT_ONCE, _LASTING = 0.25, 0.6
_BENDS, _STRAIGHTENS = np.array([1.0, 1.0, 1.0, 1.0, 0.5]), 2.0
_STEADY = replace(
    _DRIVING,
    acceleration_mps2=_AT_ONCE * _DRIVING.acceleration_mps2,
    drift=_BENDS * _DRIVING.drift,
    straightening_s=_STRAIGHTENS * _DRIVING.straightening_s,
)
#: (classes,)
_LASTING_MPS2 = np.array([_LASTING * m.acceleration_mps2 if isinstance(m, Driving) else 0.0 for m in _MOTIONS])


def model_of(classes: ArrayLike, lengths_m: ArrayLike) -> MotionModel:
    """The model of road users (...) of these classes, as indices into `CLASSES`, and lengths; () or (N,) of them."""
    return _model_of(classes, lengths_m, _DRIVING)


def steady_model_of(classes: ArrayLike, lengths_m: ArrayLike) -> tuple[MotionModel, Array]:
    """The same to look back with at all that was seen of (N,) road users, and the standard deviations (N,) in m/s² of
    their accelerations that last, of which the model knows nothing; 0 for those who walk."""
    numbers = np.asarray(classes, dtype=np.int64)
    return _model_of(classes, lengths_m, _STEADY), _LASTING_MPS2[numbers]


def _model_of(classes: ArrayLike, lengths_m: ArrayLike, driving: DrivingModel) -> MotionModel:
    numbers, lengths = np.asarray(classes, dtype=np.int64), np.asarray(lengths_m, dtype=np.float64)
    walks = WALKS[numbers]
    if not walks.any():
        return _of_lengths(driving.where(_PLACE[numbers]), lengths)
    if walks.all():
        return _WALKING.where(_PLACE[numbers])
    return MixedModel(
        walks,
        _of_lengths(driving.where(_PLACE[numbers[~walks]]), lengths[~walks]),
        _WALKING.where(_PLACE[numbers[walks]]),
    )


def _of_lengths(unit: DrivingModel, lengths_m: Array) -> DrivingModel:
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
