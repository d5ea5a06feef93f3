"""Whether the training part shows enough vehicles to learn a site from, and if not, how much longer to record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from wibam_core.documents.split import Split
from wibam_core.documents.warnings import Caution
from wibam_core.errors import NoMultiViewVehicles
from wibam_core.scene import AnnotatedInstant, Vehicles3D

#: Distinct vehicles that the training part should hold. Sightings of one vehicle look alike, so that fewer vehicles say
#: little about the sizes, headings and places of the next ones, however many frames they are seen in.
MIN_VEHICLES = 30


@dataclass(frozen=True)
class Sufficiency:
    """How many distinct vehicles the training part teaches from.

    Attributes:
        vehicles: tracks, not sightings.
        footage_s: length of the recordings as a whole, s.
        more_minutes: how much longer to record for `MIN_VEHICLES`, rounded up; 0 where there are enough.
    """

    vehicles: int
    footage_s: float
    more_minutes: int

    @property
    def cautions(self) -> list[Caution]:
        """What a person should know; nothing where there are enough vehicles."""
        if not self.more_minutes:
            return []
        return [
            Caution(
                code="few_vehicles",
                message=f"The training part holds {self.vehicles} {'vehicle' if self.vehicles == 1 else 'vehicles'} to "
                f"learn from, fewer than the {MIN_VEHICLES} that it should",
                hint=f"Record about {minutes(self.more_minutes)} more.",
                details={"vehicles": self.vehicles, "more_minutes": self.more_minutes},
            )
        ]

    def require_any(self) -> None:
        """Refuse to train on nothing.

        Raises:
            NoMultiViewVehicles: with the minutes in the hint.
        """
        if not self.vehicles:
            raise NoMultiViewVehicles(
                f"{minutes(math.ceil(self.footage_s / 60))} of footage gave no vehicle for the training part",
                hint=f"{NoMultiViewVehicles.default_hint} If traffic is sparse, record at least "
                f"{minutes(self.more_minutes)} more: {MIN_VEHICLES} vehicles should be seen by two cameras.",
                more_minutes=self.more_minutes,
            )


def training_sufficiency(
    method: str, instants: Sequence[AnnotatedInstant], lifts: Sequence[Vehicles3D], split: Split
) -> Sufficiency:
    """Whether the training part teaches from enough distinct vehicles.

    Args:
        method: as ``finetune.method``: 'paper' learns from 2D boxes of vehicles that two cameras see, the others from
            fits.
        instants: all of the recordings.
        lifts: the fits, which are pseudo-labels.
        split: which of them are the training part.
    """
    vehicles = paired_vehicles(instants, split) if method == "paper" else taught_vehicles(lifts, split)
    return sufficiency(vehicles, footage_s(instants))


def sufficiency(vehicles: int, footage_s: float) -> Sufficiency:
    """Whether so many distinct vehicles are enough.

    As many a minute as in the footage so far are expected in more of it; where there was none, one is taken to be just
    about to come.
    """
    if vehicles >= MIN_VEHICLES:
        return Sufficiency(vehicles, footage_s, 0)
    needed_s = footage_s * MIN_VEHICLES / max(vehicles, 1)
    return Sufficiency(vehicles, footage_s, max(math.ceil((needed_s - footage_s) / 60), 1))


def taught_vehicles(lifts: Sequence[Vehicles3D], split: Split) -> int:
    """Distinct vehicles of the training part with a fit that counts."""
    times, left_out = set(split.times_ns["train"]), split.left_out_tracks["train"]
    tracks = {
        track
        for vehicles in lifts
        if vehicles.time_ns in times
        for track, confidence in zip(vehicles.ids.tolist(), vehicles.scores.tolist(), strict=True)
        if confidence > 0
    }
    return len(tracks - left_out)


def paired_vehicles(instants: Sequence[AnnotatedInstant], split: Split) -> int:
    """Distinct vehicles of the training part that two cameras see; all that could not be linked over time are one."""
    times = set(split.times_ns["train"])
    return len(
        {
            vehicle.track_id
            for instant in instants
            if instant.time_ns in times
            for vehicle in split.may_teach("train", instant)
            if len(vehicle.views) > 1
        }
    )


def footage_s(instants: Sequence[AnnotatedInstant]) -> float:
    """Time from the first to the last instant, s."""
    times = [instant.time_ns for instant in instants]
    return (max(times) - min(times)) * 1e-9 if times else 0.0


def minutes(count: int) -> str:
    """E.g. "1 minute", "12 minutes"."""
    return f"{count} minute{'' if count == 1 else 's'}"
