"""What of a site a network can be taught: road users of the classes that it knows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.warnings import Caution
from wibam_core.road_users import CLASSES, VULNERABLE, RoadUserClass
from wibam_core.scene import AnnotatedInstant, Vehicles3D


@dataclass(frozen=True, eq=False)
class Teachable:
    """A site's automatic boxes and fits without what a network does not know.

    Attributes:
        instants: associated 2D boxes.
        fits: in the world.
        left_out: name of a class -> how many 2D boxes of its road users were left out.
    """

    instants: list[AnnotatedInstant]
    fits: list[Vehicles3D]
    left_out: Mapping[str, int]

    @classmethod
    def of(
        cls, instants: Sequence[AnnotatedInstant], fits: Sequence[Vehicles3D], known: Set[RoadUserClass]
    ) -> Teachable:
        """What is left of them; images show the others as background.

        A box is left out if either it or the road user that it was linked to is of another class.

        Args:
            instants: associated 2D boxes.
            fits: in the world.
            known: what the network knows.
        """
        numbers = np.array([road_user.number for road_user in known], dtype=np.int64)
        left_out: Counter[str] = Counter()
        kept = []
        for instant in instants:
            out = {id_: ~np.isin(seen.classes, numbers) for id_, seen in instant.detections.items()}
            for vehicle in instant.vehicles:
                if vehicle.vehicle_class not in known:
                    for camera_id, row in vehicle.views.items():
                        out[camera_id][row] = True
            for camera_id, rows in out.items():
                left_out.update(CLASSES[number].value for number in instant.detections[camera_id].classes[rows])
            kept.append(without(instant, out))
        return cls(kept, [fit.where(np.isin(fit.classes, numbers)) for fit in fits], dict(sorted(left_out.items())))

    @property
    def not_looked_for(self) -> frozenset[RoadUserClass]:
        """People on foot and on two wheels, where no box shows any: a detector of vehicles says nothing of them.

        A van that a detector does not know is taken for a car. Nobody on foot is.
        """
        boxes = (seen.classes for instant in self.instants for seen in instant.detections.values())
        if any(VULNERABLE[classes].any() for classes in boxes):
            return frozenset()
        return frozenset(road_user for road_user in CLASSES if road_user.traits.vulnerable)

    def cautions(self) -> list[Caution]:
        """What a person should know of it."""
        if not self.left_out:
            return []
        counts = ", ".join(f"{name} {count}" for name, count in self.left_out.items())
        return [
            Caution(
                code="classes_not_taught",
                message=f"the network does not know every class that was found; 2D boxes not taught: {counts}",
                hint="No result shows these road users. Give the site a network that knows them, if there is one.",
                details={"boxes_2d": dict(self.left_out)},
            )
        ]


def without(instant: AnnotatedInstant, out: Mapping[str, NDArray[np.bool_]]) -> AnnotatedInstant:
    """An instant without some of its 2D boxes, and without the views of vehicles that these were.

    Args:
        instant: with vehicles.
        out: camera -> (N,) which of its boxes go.
    """
    row_of = {camera_id: np.cumsum(~gone) - 1 for camera_id, gone in out.items()}
    vehicles = []
    for vehicle in instant.vehicles:
        views = {id_: int(row_of[id_][row]) for id_, row in vehicle.views.items() if not out[id_][row]}
        if views:
            vehicles.append(replace(vehicle, views=views))
    detections = {camera_id: seen.where(~out[camera_id]) for camera_id, seen in instant.detections.items()}
    return AnnotatedInstant(instant.time_ns, detections, tuple(vehicles))
