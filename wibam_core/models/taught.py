"""What the networks that come with the project are trained to tell apart: the simulation has no others."""

from __future__ import annotations

from wibam_core.road_users import RoadUserClass

#: In the order of their channels. They are the first of the catalogue: a class's number is its channel.
TAUGHT: tuple[RoadUserClass, ...] = (
    RoadUserClass.CAR,
    RoadUserClass.VAN,
    RoadUserClass.TRUCK,
    RoadUserClass.BUS,
)
