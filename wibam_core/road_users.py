"""The catalogue of road users: all that is known of a class before anything is looked at, in one entry each.

A class is added by one entry in `RoadUserClass`, at its end. Files carry the classes' names, never their numbers, so
that a file that was made before a class was added still reads the same. What a class is called elsewhere is in its
entry too; a network or a detector brings the names of the classes that it knows.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Points of a body: x in lengths and y in widths from the centre, z in heights above the ground.
Outline = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class SizePrior:
    """Length, width, height: usual value in m, and standard deviation of its logarithm."""

    size_m: tuple[float, float, float]
    log_sd: tuple[float, float, float]


@dataclass(frozen=True)
class ForeignName:
    """What a class is called in another vocabulary.

    Attributes:
        written: the name that comes closest, None where the vocabulary has none.
        read: all names there that mean this class. A class that the vocabulary does not tell apart from another has
            none, and comes back as the other.
    """

    written: str | None
    read: tuple[str, ...] = ()


def _same(name: str, *also_read: str) -> ForeignName:
    """A class that has a name of its own elsewhere; others mean it as well."""
    return ForeignName(name, (name, *also_read))


@dataclass(frozen=True)
class NamesElsewhere:
    """What a class is called elsewhere.

    Attributes:
        coco: among the 80 classes of COCO's detections (Lin et al. 2014, arXiv 1405.0312).
        nuscenes: among the 10 classes of the nuScenes detection challenge (Caesar et al. 2020, arXiv 1903.11027).
        kitti: among the types of KITTI's object labels (Geiger et al. 2012).
        openlabel: among the object types of the TUM Traffic data sets, which follow ASAM OpenLABEL (Zimmer et al. 2023,
            arXiv 2306.09266).
        levelx: among the classes of inD and rounD (Bock et al. 2020, arXiv 1911.07602; Krajewski et al. 2020).
        opentrafficcam: among the road users that OpenTrafficCam counts.
        sumo: the abstract vehicle class (vClass) of SUMO that it is simulated as (Lopez et al. 2018).
    """

    coco: ForeignName
    nuscenes: ForeignName
    kitti: ForeignName
    openlabel: ForeignName
    levelx: ForeignName
    opentrafficcam: str
    sumo: str


@dataclass(frozen=True)
class Driving:
    """How a class moves that rolls on wheels, the rear ones of which follow its heading (`tracking.driving`).

    Attributes:
        axle_share: the rear axle lies this share of the length behind the centre. axle_m: that of a usual one.
        turn_rad_per_m: it turns by about this much per metre that it drives.
        acceleration_mps2: standard deviation of what is not foreseen, along the heading.
        curvature_drift: of the path's curvature, 1/m per √s. yaw_drift_rad: of the yaw, per √s.
        position_drift_m: of the place, per √s.
        max_curvature: of the tightest turn, 1/m. straightening_s: time constant in which a turn ends.
        first_speed_sd_mps, first_curvature_sd: of one that was seen once, m/s and 1/m.
    """

    axle_share: float
    axle_m: float
    turn_rad_per_m: float
    acceleration_mps2: float
    curvature_drift: float
    yaw_drift_rad: float
    position_drift_m: float
    max_curvature: float
    straightening_s: float
    first_speed_sd_mps: float
    first_curvature_sd: float


@dataclass(frozen=True)
class Traits:
    """What is known of a class of road users.

    Attributes:
        label: for a person, in the singular.
        size: what its sizes are before looking.
        body: outline of its coarse body. A vehicle is not its cuboid: its tight image box hugs a body with chamfered
            corners and an inset roof. Comparing the cuboid's corners with such boxes shrinks it, so that a coarse body
            is compared instead. All bodies have the same number of points.
        plane_height_m: height of the plane on which the ray through the middle of its image box is met: a little below
            the middle of a usual body.
        place_scale: how far a ground point from an image box lies off, as a multiple of a car's.
        motion: how it moves.
        colour: ``#rrggbb`` in figures, told apart by colour-blind readers.
        elsewhere: its names in other vocabularies.
    """

    label: str
    size: SizePrior
    body: Outline
    plane_height_m: float
    place_scale: float
    motion: Driving
    colour: str
    elsewhere: NamesElsewhere


def _ring(front: float, rear: float, corner: float, half_width: float, inner: float, height: float) -> Outline:
    """Eight points of a rectangle with cut corners at one height: ends at ``front`` and ``rear``, cut back by
    ``corner`` along the length, from ``half_width`` in to ``inner`` across."""
    return tuple(
        point
        for side in (1.0, -1.0)
        for point in (
            (front, side * inner, height),
            (front - corner, side * half_width, height),
            (rear + corner, side * half_width, height),
            (rear, side * inner, height),
        )
    )


def _pairs(*points: tuple[float, float, float]) -> Outline:
    """Points and their mirror images on the other side."""
    return tuple((x, side * y, z) for x, y, z in points for side in (1.0, -1.0))


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
            label="car",
            size=SizePrior((4.4, 1.82, 1.52), (0.10, 0.05, 0.08)),
            body=(
                *_ring(0.5, -0.5, 0.07, 0.49, 0.36, 0.2),
                *_ring(0.48, -0.49, 0.08, 0.49, 0.36, 0.52),
                *_pairs((0.3, 0.47, 0.0), (-0.3, 0.47, 0.0), (0.1, 0.37, 1.0), (-0.3, 0.37, 1.0)),
            ),
            plane_height_m=0.67,
            place_scale=1.0,
            motion=_MOTORING,
            colour="#0072b2",
            elsewhere=NamesElsewhere(
                coco=_same("car"),
                nuscenes=_same("car"),
                kitti=_same("Car"),
                openlabel=_same("CAR"),
                levelx=_same("car"),
                opentrafficcam="car",
                sumo="passenger",
            ),
        ),
    )
    VAN = (
        "van",
        Traits(
            label="van",
            size=SizePrior((5.3, 2.0, 2.2), (0.13, 0.06, 0.12)),
            body=(
                *_ring(0.5, -0.5, 0.05, 0.49, 0.4, 0.15),
                *_pairs((0.47, 0.38, 0.5), (0.42, 0.48, 0.5), (-0.5, 0.44, 0.5), (-0.48, 0.49, 0.5)),
                *_pairs((0.32, 0.47, 0.0), (-0.32, 0.47, 0.0), (0.24, 0.42, 1.0), (-0.47, 0.42, 1.0)),
            ),
            plane_height_m=0.97,
            place_scale=1.0,
            motion=_MOTORING,
            colour="#e69f00",
            elsewhere=NamesElsewhere(
                coco=ForeignName("car"),
                nuscenes=ForeignName("car"),
                kitti=_same("Van"),
                openlabel=_same("VAN"),
                levelx=_same("van"),
                opentrafficcam="delivery_van",
                sumo="delivery",
            ),
        ),
    )
    TRUCK = (
        "truck",
        Traits(
            label="truck",
            size=SizePrior((8.0, 2.45, 3.2), (0.20, 0.06, 0.12)),
            body=(
                *_ring(0.5, -0.5, 0.03, 0.49, 0.43, 0.17),
                *_pairs((0.5, 0.43, 0.5), (0.47, 0.48, 0.5), (0.46, 0.44, 0.75), (-0.5, 0.5, 0.4)),
                *_pairs((0.33, 0.46, 0.0), (-0.3, 0.46, 0.0), (0.25, 0.49, 1.0), (-0.5, 0.49, 1.0)),
            ),
            plane_height_m=1.4,
            place_scale=1.3,
            motion=_MOTORING,
            colour="#009e73",
            elsewhere=NamesElsewhere(
                coco=_same("truck"),
                nuscenes=_same("truck", "construction_vehicle"),
                kitti=_same("Truck"),
                openlabel=_same("TRUCK"),
                levelx=_same("truck", "truck_bus"),
                opentrafficcam="truck",
                sumo="truck",
            ),
        ),
    )
    BUS = (
        "bus",
        Traits(
            label="bus",
            size=SizePrior((11.5, 2.55, 3.1), (0.12, 0.03, 0.06)),
            body=(
                *_ring(0.5, -0.5, 0.02, 0.5, 0.45, 0.12),
                *_ring(0.49, -0.5, 0.02, 0.49, 0.44, 0.85),
                *_pairs((0.28, 0.47, 0.0), (-0.26, 0.47, 0.0), (0.46, 0.44, 1.0), (-0.48, 0.44, 1.0)),
            ),
            plane_height_m=1.36,
            place_scale=1.6,
            motion=_MOTORING,
            colour="#cc79a7",
            elsewhere=NamesElsewhere(
                coco=_same("bus"),
                nuscenes=_same("bus"),
                kitti=ForeignName("Misc"),
                openlabel=_same("BUS"),
                levelx=_same("bus"),
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
