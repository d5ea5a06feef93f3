"""Which instants are shown: spread evenly over time and busy, never chosen for how well they came out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from wibam_core.scene import AnnotatedInstant


@dataclass(frozen=True)
class Choice:
    """A frame to show, and another view of the same instant, if any camera shares a vehicle with it."""

    instant: AnnotatedInstant
    camera_id: str
    other_id: str | None


def stretches(instants: Sequence[AnnotatedInstant], count: int) -> list[list[AnnotatedInstant]]:
    """``instants`` in up to ``count`` stretches of nearly equal length, none empty."""
    parts = min(count, len(instants))
    bounds = [round(k * len(instants) / parts) for k in range(parts + 1)] if parts else []
    return [list(instants[a:b]) for a, b in pairwise(bounds)]


def busiest(instants: Sequence[AnnotatedInstant], count: int) -> list[AnnotatedInstant]:
    """Of each stretch the instant with most multi-view vehicles, the earliest of equals."""
    return [max(stretch, key=_multi_view) for stretch in stretches(instants, count)]


def choose_examples(instants: Sequence[AnnotatedInstant], camera_ids: Sequence[str], count: int) -> list[Choice]:
    """One frame of each stretch, cameras in turn: the one in which that camera sees most vehicles.

    Stretches in which no camera sees a vehicle are left out.

    Args:
        instants: in order of time.
        camera_ids: of the rig, in order.
        count: how many frames, at most.
    """
    chosen = []
    for turn, stretch in enumerate(stretches(instants, count)):
        in_turn = [camera_ids[(turn + k) % len(camera_ids)] for k in range(len(camera_ids))]
        for camera_id in in_turn:
            best = max(stretch, key=lambda instant: _seen_by(instant, camera_id))
            if _seen_by(best, camera_id) > (0, 0):
                chosen.append(Choice(best, camera_id, _partner(best, camera_id, camera_ids)))
                break
    return chosen


def _multi_view(instant: AnnotatedInstant) -> tuple[int, int]:
    several = sum(len(vehicle.views) > 1 for vehicle in instant.vehicles)
    return several, sum(len(seen) for seen in instant.detections.values())


def _seen_by(instant: AnnotatedInstant, camera_id: str) -> tuple[int, int]:
    """Vehicles shared with another camera, and all boxes."""
    shared = sum(camera_id in vehicle.views and len(vehicle.views) > 1 for vehicle in instant.vehicles)
    return shared, len(instant.detections[camera_id]) if camera_id in instant.detections else 0


def _partner(instant: AnnotatedInstant, camera_id: str, camera_ids: Sequence[str]) -> str | None:
    together = [vehicle.views for vehicle in instant.vehicles if camera_id in vehicle.views]
    shared = Counter(other for views in together for other in views if other != camera_id)
    if not shared:
        return None
    return max((c for c in camera_ids if c in shared), key=lambda c: shared[c])
