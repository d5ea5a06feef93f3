"""The catalogue of road users: all that is known of a class before anything is looked at, in one entry each.

A class is added by one entry in `RoadUserClass`, at its end. Files carry the classes' names, never their numbers, so
that a file that was made before a class was added still reads the same. What a class is called elsewhere is in its
entry too; a network or a detector brings the names of the classes that it knows.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

from wibam_core.traits import (
    Driving,
    FloatArray,
    ForeignName,
    NamesElsewhere,
    SizePrior,
    Traits,
    Walking,
    pairs,
    ring,
    same,
)

#: Motor vehicles on four wheels or more. They accelerate by 2 m/s² and turn in 4 m at most.
_MOTORING = Driving(
    axle_share=0.27,
    axle_m=1.26,
    turn_rad_per_m=0.15,
    acceleration_mps2=2.0,
    curvature_drift=0.06,
    yaw_drift_rad=0.01,
    position_drift_m=0.025,
    max_curvature=0.25,
    straightening_s=2.0,
    first_speed_sd_mps=8.0,
    first_curvature_sd=0.05,
)


class RoadUserClass(StrEnum):
    """Road users that the system knows: `traits` says what of each. Append, never insert.

    Sizes of vehicles are what is sold and driven: passenger cars 3.6–5.1 m, panel vans 4.4–6.9 m, rigid trucks
    5.5–12 m, buses 9–13 m. Long ones are often half hidden or cut by the border of an image, and their middle then lies
    metres off. Those of others are means of data sets labelled by hand: KITTI's of pedestrians (0.84, 0.66, 1.76) m and
    cyclists (1.76, 0.60, 1.74) m, which Qi et al. 2018 (arXiv 1711.08488) give, and nuScenes's of pedestrians (0.73,
    0.66, 1.76) m and motorcycles (2.10, 0.76, 1.44) m, which Zhu et al. 2019 (arXiv 1908.09492) give.

    A cyclist or motorcyclist is one road user with what is ridden, from the ground to the top of the rider. nuScenes's
    motorcycles are lower, since many of them stand there without a rider.
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
            vulnerable=False,
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
            vulnerable=False,
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
            vulnerable=False,
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
            vulnerable=False,
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
    MOTORCYCLE = (
        "motorcycle",
        Traits(
            size=SizePrior((2.1, 0.8, 1.55), (0.08, 0.15, 0.10)),
            body=(
                *ring(0.5, -0.5, 0.15, 0.15, 0.05, 0.2),
                *ring(0.3, -0.35, 0.1, 0.5, 0.4, 0.65),
                *pairs((0.33, 0.05, 0.0), (-0.33, 0.05, 0.0), (0.05, 0.18, 1.0), (-0.15, 0.18, 1.0)),
            ),
            plane_height_m=0.72,
            place_scale=0.6,
            motion=Driving(
                axle_share=0.3,
                axle_m=0.63,
                turn_rad_per_m=0.25,
                acceleration_mps2=3.0,
                curvature_drift=0.1,
                yaw_drift_rad=0.03,
                position_drift_m=0.05,
                max_curvature=0.4,
                straightening_s=2.0,
                first_speed_sd_mps=8.0,
                first_curvature_sd=0.08,
            ),
            vulnerable=True,
            colour="#56b4e9",
            elsewhere=NamesElsewhere(
                coco=same("motorcycle"),
                nuscenes=same("motorcycle"),
                kitti=ForeignName("Cyclist"),
                openlabel=same("MOTORCYCLE"),
                levelx=same("motorcycle"),
                opentrafficcam="motorcyclist",
                sumo="motorcycle",
            ),
        ),
    )
    #: Accelerates by about 1 m/s² (Figliozzi, Wheeler & Monsere 2013, doi 10.3141/2387-08) and turns within 2 m.
    BICYCLE = (
        "bicycle",
        Traits(
            size=SizePrior((1.76, 0.6, 1.74), (0.07, 0.15, 0.08)),
            body=(
                *ring(0.5, -0.5, 0.15, 0.12, 0.04, 0.2),
                *ring(0.3, -0.25, 0.1, 0.5, 0.4, 0.62),
                *pairs((0.3, 0.04, 0.0), (-0.3, 0.04, 0.0), (0.12, 0.18, 1.0), (-0.06, 0.18, 1.0)),
            ),
            plane_height_m=0.8,
            place_scale=0.5,
            motion=Driving(
                axle_share=0.3,
                axle_m=0.53,
                turn_rad_per_m=0.4,
                acceleration_mps2=1.2,
                curvature_drift=0.15,
                yaw_drift_rad=0.05,
                position_drift_m=0.05,
                max_curvature=0.5,
                straightening_s=2.0,
                first_speed_sd_mps=5.0,
                first_curvature_sd=0.15,
            ),
            vulnerable=True,
            colour="#d55e00",
            elsewhere=NamesElsewhere(
                coco=same("bicycle"),
                nuscenes=same("bicycle"),
                kitti=same("Cyclist"),
                openlabel=same("BICYCLE"),
                levelx=same("bicycle"),
                opentrafficcam="bicyclist",
                sumo="bicycle",
            ),
        ),
    )
    #: Walks at 1.34 ± 0.26 m/s (Weidmann 1993, Transporttechnik der Fussgänger), and stops or turns within a step.
    PEDESTRIAN = (
        "pedestrian",
        Traits(
            size=SizePrior((0.78, 0.66, 1.76), (0.2, 0.15, 0.1)),
            body=(
                *ring(0.4, -0.4, 0.15, 0.5, 0.25, 0.45),
                *ring(0.25, -0.25, 0.1, 0.5, 0.3, 0.8),
                *pairs((0.5, 0.2, 0.0), (-0.5, 0.2, 0.0), (0.14, 0.13, 1.0), (-0.14, 0.13, 1.0)),
            ),
            plane_height_m=0.85,
            place_scale=0.4,
            motion=Walking(
                turn_rad_per_m=1.5,
                acceleration_mps2=3.0,
                yaw_drift_rad=1.0,
                position_drift_m=0.05,
                first_speed_sd_mps=1.5,
            ),
            vulnerable=True,
            colour="#7a5195",
            elsewhere=NamesElsewhere(
                coco=same("person"),
                nuscenes=same("pedestrian"),
                kitti=same("Pedestrian", "Person_sitting"),
                openlabel=same("PEDESTRIAN"),
                levelx=same("pedestrian"),
                opentrafficcam="pedestrian",
                sumo="pedestrian",
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
#: (classes,) in the order of `CLASSES`.
VULNERABLE: NDArray[np.bool_] = np.array([c.traits.vulnerable for c in CLASSES])
VULNERABLE.setflags(write=False)


def may_be_one(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N, M) whether road users of classes a (N,) and b (M,), indices into `CLASSES`, may be one, seen twice."""
    return np.asarray(VULNERABLE[a][:, None] == VULNERABLE[b])
