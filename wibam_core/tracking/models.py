"""Which model of motion a class of road users has."""

from __future__ import annotations

from wibam_core.road_users import RoadUserClass
from wibam_core.tracking.driving import DrivingModel
from wibam_core.tracking.motion import MotionModel


def model_of(road_user: RoadUserClass, length_m: float) -> MotionModel:
    """The model of one road user of a class and a length."""
    return DrivingModel(road_user.traits.motion, length_m)
