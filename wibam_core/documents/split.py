"""The split of the instants in time."""

from __future__ import annotations

from typing import Self

from pydantic import field_serializer, model_validator

from wibam_core.documents.base import Document
from wibam_core.scene import AnnotatedInstant, MultiViewVehicle

SUBSETS = ("train", "val", "test")


class Split(Document):
    """Which instants belong to which subset."""

    times_ns: dict[str, tuple[int, ...]]
    """Subset -> instants in order of time, at the rate of the dataset."""
    left_out_tracks: dict[str, frozenset[int]]
    """Subset -> vehicles that a later subset sees, too. They teach nothing in this subset: the later one keeps them,
    so that the test subset loses none."""

    @model_validator(mode="after")
    def _no_instant_twice(self) -> Self:
        times = [set(self.times_ns[name]) for name in SUBSETS]
        if sum(map(len, times)) != len(set().union(*times)):
            raise ValueError("an instant belongs to two subsets")
        return self

    @field_serializer("left_out_tracks")
    def _sorted(self, value: dict[str, frozenset[int]]) -> dict[str, list[int]]:
        return {name: sorted(tracks) for name, tracks in value.items()}

    def subset_of(self) -> dict[int, str]:
        """Subset of every instant that is in one, by time."""
        return {time: name for name in SUBSETS for time in self.times_ns[name]}

    def may_teach(self, subset: str, instant: AnnotatedInstant) -> tuple[MultiViewVehicle, ...]:
        """The vehicles of an instant of ``subset`` that are not left out of it."""
        left_out = self.left_out_tracks[subset]
        return tuple(vehicle for vehicle in instant.vehicles if vehicle.track_id not in left_out)
