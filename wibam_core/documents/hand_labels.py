"""Hand labels as people make them, instant by instant, and how far two people agree."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from wibam_core.documents.base import Document, MeanSd
from wibam_core.road_users import RoadUserClass

#: Places lie within this of the world's origin, m: worlds may be those of a national grid, whose northings reach it.
FARTHEST_M = 1e7
#: Times lie within this of zero, ns either way: differences of two fit into 64 bits.
LATEST_NS = 2**62
Metres = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Size = Annotated[float, Field(ge=0.05, le=60)]
Speed = Annotated[float, Field(ge=-200, le=200)]
Share = Annotated[float, Field(ge=0, le=1)]
#: A camera, or a view that is cut from the picture of one with a wide lens.
ViewId = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,79}$")]
#: Corners of a region, and regions of an instant.
MOST_CORNERS, MOST_REGIONS = 100, 200
Seconds = Annotated[float, Field(ge=0, le=1e7)]


class HandVehicle(Document):
    """A road user that somebody labelled."""

    model_config = ConfigDict(extra="forbid", serialize_by_alias=True)

    id: int = Field(ge=0, le=2**53 - 1)
    """The same for one vehicle at all instants."""
    vehicle_class: RoadUserClass = Field(alias="class")
    box: tuple[Metres, Metres, Metres, Size, Size, Size, Annotated[float, Field(ge=-10, le=10)]]
    """Centre x, y, z, length, width, height in m and yaw in rad, in the world, at the time of the instant."""
    velocity_mps: tuple[Speed, Speed] = (0.0, 0.0)
    """Along world X and Y. Cameras expose frames a little before or after the instant, and see it moved by that."""
    visibility: dict[ViewId, Share] = Field(default={})
    """Camera -> share of the vehicle that it sees, where somebody corrected what is estimated."""
    ignored: bool = False
    """Nobody is asked for it and nobody is wrong who finds it: it is hidden, or cannot be told."""
    seconds: Seconds = 0.0
    """How long somebody worked on it."""


def _no_vehicle_twice(vehicles: tuple[HandVehicle, ...]) -> tuple[HandVehicle, ...]:
    ids = [vehicle.id for vehicle in vehicles]
    if len(set(ids)) < len(ids):
        raise ValueError(f"vehicle {next(i for i in ids if ids.count(i) > 1)} is labelled twice")
    return vehicles


#: All vehicles of an instant.
HandVehicles = Annotated[tuple[HandVehicle, ...], Field(max_length=500), AfterValidator(_no_vehicle_twice)]


class HandRegion(Document):
    """A region where labels are as they are for a reason."""

    model_config = ConfigDict(extra="forbid", serialize_by_alias=True)

    kind: Literal["do_not_care", "hidden"]
    """Do not care: on the ground; nobody looked closely there, so that nothing is asked for and nothing that is found
    is wrong. Hidden: in the picture of a camera, where something stands before the road: a tree, a pole, a building."""
    camera: ViewId | None = None
    """Whose picture; null on the ground."""
    polygon: Annotated[tuple[tuple[Metres, Metres], ...], Field(min_length=3, max_length=MOST_CORNERS)]
    """Corners: X, Y in m in the world, or u, v in px of the recording."""

    @model_validator(mode="after")
    def _in_a_picture_or_on_the_ground(self) -> HandRegion:
        if (self.kind == "hidden") != (self.camera is not None):
            raise ValueError("a hidden region names its camera, one that nobody cares for lies on the ground")
        return self


#: All regions of an instant.
HandRegions = Annotated[tuple[HandRegion, ...], Field(max_length=MOST_REGIONS)]


class HandLabels(Document):
    """All that is labelled at one instant."""

    model_config = ConfigDict(extra="forbid", serialize_by_alias=True)

    time_ns: int = Field(ge=-LATEST_NS, le=LATEST_NS)
    """The instant, on the reference clock."""
    vehicles: HandVehicles = ()
    regions: HandRegions = ()
    finished: bool = False
    """Every road user is labelled that a camera sees. Only finished instants are exported and evaluate anything."""
    seconds: Seconds = 0.0
    """How long somebody worked on the instant."""


class Suggestion(Document):
    """An instant that is worth labelling."""

    time_ns: int
    """Reference clock."""
    vehicles: int
    """How many road users were fitted there."""
    disagreement: float | None
    """1 − the mean overlap of the fits' reprojections with what the detector saw; null where nothing was seen."""


class Agreement(Document):
    """How far two sets of hand labels agree, over the instants that both have finished."""

    instants: int
    """Finished in both."""
    pairs: int
    """Vehicles that both labelled, none of them ignored."""
    only_first: int
    """Vehicles that the first labelled and the second did not; ignored ones do not count."""
    only_second: int
    bev_iou: MeanSd
    """Overlap of the ground rectangles."""
    iou_3d: MeanSd
    ate_m: MeanSd
    """Distance of the centres."""
    ase: MeanSd
    """1 − overlap of the ground rectangles once they lie on each other."""
    aoe_deg: MeanSd
    """Difference of the headings."""
    visibility: MeanSd
    """Difference of the shares that a camera sees, over pairs and cameras that see one of the two."""
    same_class: float | None
    """Share of the pairs."""
