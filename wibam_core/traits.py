"""What is known of a class of road users: the shape of an entry of `wibam_core.road_users`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: The classes of the nuScenes detection challenge (Caesar et al. 2020, arXiv 1903.11027) in the order of their numbers.
NUSCENES_CLASSES = (
    "car",
    "truck",
    "bus",
    "trailer",
    "construction_vehicle",
    "pedestrian",
    "motorcycle",
    "bicycle",
    "traffic_cone",
    "barrier",
)

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


def same(name: str, *also_read: str) -> ForeignName:
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
class Walking:
    """How a class moves that turns on the spot and steps to any side (`tracking.walking`).

    Attributes:
        turn_rad_per_m: it turns by about this much per metre that it walks.
        acceleration_mps2: standard deviation of what is not foreseen, along either axis of the ground.
        yaw_drift_rad: of the yaw, per √s. position_drift_m: of the place, per √s.
        first_speed_sd_mps: along either axis, of one that was seen once.
    """

    turn_rad_per_m: float
    acceleration_mps2: float
    yaw_drift_rad: float
    position_drift_m: float
    first_speed_sd_mps: float

    @property
    def axle_m(self) -> float:
        """No axle: it is the centre that moves along the course."""
        return 0.0


@dataclass(frozen=True)
class Traits:
    """What is known of a class of road users.

    Attributes:
        size: what its sizes are before looking.
        body: outline of its coarse body. A vehicle is not its cuboid: its tight image box hugs a body with chamfered
            corners and an inset roof. Comparing the cuboid's corners with such boxes shrinks it, so that a coarse body
            is compared instead. All bodies have the same number of points.
        plane_height_m: height of the plane on which the ray through the middle of its image box is met: a little below
            the middle of a usual body.
        place_scale: how far a ground point from an image box lies off, as a multiple of a car's.
        motion: how it moves.
        vulnerable: whether nothing protects it (pedestrians and riders, by the European Union's directive 2010/40/EU).
            Detections of which one is and one is not are never taken for the same road user.
        colour: ``#rrggbb`` in figures, told apart by colour-blind readers.
        elsewhere: its names in other vocabularies.
    """

    size: SizePrior
    body: Outline
    plane_height_m: float
    place_scale: float
    motion: Driving | Walking
    vulnerable: bool
    colour: str
    elsewhere: NamesElsewhere


def ring(front: float, rear: float, corner: float, half_width: float, inner: float, height: float) -> Outline:
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


def pairs(*points: tuple[float, float, float]) -> Outline:
    """Points and their mirror images on the other side."""
    return tuple((x, side * y, z) for x, y, z in points for side in (1.0, -1.0))
