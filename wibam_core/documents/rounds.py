"""What rounds of finding, fitting and teaching gained."""

from __future__ import annotations

from typing import Literal

from wibam_core.documents.base import Document

#: What found the boxes of a round: the detector, what moves beside the still background, or a network that was taught.
Source = Literal["detector", "motion", "network"]


class HeldOutAgreement(Document):
    """How well fits agree with a camera that they were not made from, each camera in turn.

    Of the instants between the training and the test part, so that neither what was taught nor what is tested decides.
    """

    instants: int
    sightings: int
    """Boxes of a camera that show a vehicle which the other cameras' boxes place. Vehicles that taught do not count."""
    iou: float | None
    """Mean overlap (IoU) of these boxes with the outlines of the fits."""
    missed: int
    """How often a camera should show such a vehicle unhidden, and has no box of it."""
    found: float | None
    """Share of all that should be seen which has a box."""
    an_instant: float
    """Sum of the overlaps an instant: it rises with what is found and with how well it agrees."""


class Round(Document):
    """The boxes of all cameras after a round. Round 0 is what the detector found."""

    number: int
    source: Source
    """What found those that were not there before."""
    boxes_an_image: dict[str, float]
    """By camera, at the instants before the test part."""
    vehicles_an_instant: dict[str, float]
    """How many vehicles an instant are seen in so many views, before the test part."""
    views_a_vehicle: float | None
    taught_vehicles: int | None = None
    """Tracks of the training part that taught the network that found these boxes; none of other sources."""
    taught_fits: int | None = None
    """Their fits: vehicle-instants of the training part."""
    scenery_left_out: int | None = None
    """How many of the detector's boxes lie on what never changes, and were left out since other cameras mostly have no
    box of the same; none of rounds that do not look for what moves."""
    known_share: float | None = None
    """Of the boxes of vehicles that move and that several cameras see, the share that the detector has one of, or of a
    network's round that network by itself: who stands is found by these alone. None where there are too few."""
    agreement: HeldOutAgreement

    @property
    def agreement_a_box(self) -> float:
        """The agreement over the boxes, both of an instant: it falls with boxes that nothing agrees with."""
        return self.agreement.an_instant / max(sum(self.boxes_an_image.values()), 1e-9)


class Rounds(Document):
    """All rounds, those that were not kept included."""

    rounds: list[Round]
    """None where nothing was judged."""
    kept: int
    """Number of the round whose boxes are used."""
    reason: str
    """Why no other round followed, or none was run."""
