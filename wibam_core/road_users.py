"""The catalogue of road users: all that is known of a class before anything is looked at, in one entry each.

A class is added by one entry in `RoadUserClass`, at its end. Files carry the classes' names, never their numbers, so
that a file that was made before a class was added still reads the same. What a class is called elsewhere is in its
entry too; a network or a detector brings the names of the classes that it knows.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Self

import numpy as np

from wibam_core.traits import Driving, FloatArray, ForeignName, NamesElsewhere, SizePrior, Traits, pairs, ring, same

#: Motor vehicles on four wheels or more. They accelerate by 2 m/s² and turn in 4 m at most.
_MOTORING = Driving(
    axle_share=0.27,
    axle_m=1.26,
    turn_rad_per_m=0.15,
    acceleration_mps2=2.0,
    curvature_drift=0.06,
    yaw_drift_rad=0.02,
    position_drift_m=0.05,
    max_curvature=0.25,
    straightening_s=2.0,
    first_speed_sd_mps=8.0,
    first_curvature_sd=0.05,
)


class RoadUserClass(StrEnum):
    """Road users that the system knows: `traits` says what of each. Append, never insert.

    Sizes are what is sold and driven: passenger cars 3.6–5.1 m, panel vans 4.4–6.9 m, rigid trucks 5.5–12 m, buses
    9–13 m. Long vehicles are often half hidden or cut by the border of an image, and their middle then lies metres off.
    """

    traits: Traits

    def __new__(cls, name: str, traits: Traits) -> Self:
        member = str.__new__(cls, name)
        member._value_ = name
        member.traits = traits
        return member

    @property
    def number(self) -> int:
        """Place in `CLASSES`, by which arrays name classes. It is never written to a file."""
        return CLASSES.index(self)

    CAR = (
        "car",
        Traits(
            size=SizePrior((4.4, 1.82, 1.52), (0.10, 0.05, 0.08)),
            body=(
                *ring(0.5, -0.5, 0.07, 0.49, 0.36, 0.2),
                *ring(0.48, -0.49, 0.08, 0.49, 0.36, 0.52),
                *pairs((0.3, 0.47, 0.0), (-0.3, 0.47, 0.0), (0.1, 0.37, 1.0), (-0.3, 0.37, 1.0)),
            ),
            plane_height_m=0.67,
            place_scale=1.0,
            motion=_MOTORING,
            colour="#0072b2",
            elsewhere=NamesElsewhere(
                coco=same("car"),
                nuscenes=same("car"),
                kitti=same("Car"),
                openlabel=same("CAR"),
                levelx=same("car"),
                opentrafficcam="car",
                sumo="passenger",
            ),
        ),
    )
    VAN = (
        "van",
        Traits(
            size=SizePrior((5.3, 2.0, 2.2), (0.13, 0.06, 0.12)),
            body=(
                *ring(0.5, -0.5, 0.05, 0.49, 0.4, 0.15),
                *pairs((0.47, 0.38, 0.5), (0.42, 0.48, 0.5), (-0.5, 0.44, 0.5), (-0.48, 0.49, 0.5)),
                *pairs((0.32, 0.47, 0.0), (-0.32, 0.47, 0.0), (0.24, 0.42, 1.0), (-0.47, 0.42, 1.0)),
            ),
            plane_height_m=0.97,
            place_scale=1.0,
            motion=_MOTORING,
            colour="#e69f00",
            elsewhere=NamesElsewhere(
                coco=ForeignName("car"),
                nuscenes=ForeignName("car"),
                kitti=same("Van"),
                openlabel=same("VAN"),
                levelx=same("van"),
                opentrafficcam="delivery_van",
                sumo="delivery",
            ),
        ),
    )
    TRUCK = (
        "truck",
        Traits(
            size=SizePrior((8.0, 2.45, 3.2), (0.20, 0.06, 0.12)),
            body=(
                *ring(0.5, -0.5, 0.03, 0.49, 0.43, 0.17),
                *pairs((0.5, 0.43, 0.5), (0.47, 0.48, 0.5), (0.46, 0.44, 0.75), (-0.5, 0.5, 0.4)),
                *pairs((0.33, 0.46, 0.0), (-0.3, 0.46, 0.0), (0.25, 0.49, 1.0), (-0.5, 0.49, 1.0)),
            ),
            plane_height_m=1.4,
            place_scale=1.3,
            motion=_MOTORING,
            colour="#009e73",
            elsewhere=NamesElsewhere(
                coco=same("truck"),
                nuscenes=same("truck", "construction_vehicle"),
                kitti=same("Truck"),
                openlabel=same("TRUCK"),
                levelx=same("truck", "truck_bus"),
                opentrafficcam="truck",
                sumo="truck",
            ),
        ),
    )
    BUS = (
        "bus",
        Traits(
            size=SizePrior((11.5, 2.55, 3.1), (0.12, 0.03, 0.06)),
            body=(
                *ring(0.5, -0.5, 0.02, 0.5, 0.45, 0.12),
                *ring(0.49, -0.5, 0.02, 0.49, 0.44, 0.85),
                *pairs((0.28, 0.47, 0.0), (-0.26, 0.47, 0.0), (0.46, 0.44, 1.0), (-0.48, 0.44, 1.0)),
            ),
            plane_height_m=1.36,
            place_scale=1.6,
            motion=_MOTORING,
            colour="#cc79a7",
            elsewhere=NamesElsewhere(
                coco=same("bus"),
                nuscenes=same("bus"),
                kitti=ForeignName("Misc"),
                openlabel=same("BUS"),
                levelx=same("bus"),
                opentrafficcam="bus",
                sumo="bus",
            ),
        ),
    )


CLASSES: tuple[RoadUserClass, ...] = tuple(RoadUserClass)


def _frozen(values: FloatArray) -> FloatArray:
    values.setflags(write=False)
    return values


#: (classes, P, 3) in the order of `CLASSES`: the bodies in the vehicle frame, in lengths, widths and heights.
BODIES: FloatArray = _frozen(np.array([c.traits.body for c in CLASSES]) - np.array([0.0, 0.0, 0.5]))
#: (classes, 3) in the order of `CLASSES`: logarithms of length, width and height in m, and their standard deviations.
LOG_SIZE_MEAN: FloatArray = _frozen(np.log([c.traits.size.size_m for c in CLASSES]))
LOG_SIZE_SD: FloatArray = _frozen(np.array([c.traits.size.log_sd for c in CLASSES]))
