"""Vehicles whose boxes somebody else has put together at each instant, followed over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from wibam_core.association.associate import associate
from wibam_core.config import AssociateConfig
from wibam_core.progress import Progress, silent
from wibam_core.scene import AnnotatedInstant, CameraRig, MultiViewVehicle


def linked_over_time(
    instants: Sequence[AnnotatedInstant], rig: CameraRig, config: AssociateConfig, progress: Progress = silent
) -> list[AnnotatedInstant]:
    """The same vehicles of the same boxes, with track ids.

    The boxes are associated anew; a given vehicle is the track that most of its boxes belong to, and has that track's
    class. Of two vehicles at one instant that are the same track, the one with more of its boxes has it.

    Args:
        instants: in order of time, with vehicles; their track ids are replaced.
        rig: calibrated cameras.
        config: radius, range and speed limits.
        progress: told now and then.

    Raises:
        NoVehicles: no box in range at any instant.
        NoMultiViewVehicles: no box of one camera meets another camera's on the ground.
    """
    associated = associate(instants, rig, config, progress)
    return [
        replace(given, vehicles=_linked(given.vehicles, found.vehicles))
        for given, found in zip(instants, associated, strict=True)
    ]


def _linked(given: Sequence[MultiViewVehicle], found: Sequence[MultiViewVehicle]) -> tuple[MultiViewVehicle, ...]:
    track_of = {box: vehicle for vehicle in found if vehicle.track_id >= 0 for box in vehicle.views.items()}
    shared = Counter(
        (number, track_of[box].track_id)
        for number, vehicle in enumerate(given)
        for box in vehicle.views.items()
        if box in track_of
    )
    tracks: dict[int, int] = {}
    for (number, track_id), _ in shared.most_common():
        if number not in tracks and track_id not in tracks.values():
            tracks[number] = track_id
    classes = {vehicle.track_id: vehicle.vehicle_class for vehicle in found}
    return tuple(
        replace(vehicle, track_id=tracks[number], vehicle_class=classes[tracks[number]])
        if number in tracks
        else replace(vehicle, track_id=-1)
        for number, vehicle in enumerate(given)
    )
