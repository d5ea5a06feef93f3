"""Which instants are worth labelling: spread over the test part, and more where the cameras disagree."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from wibam_core.documents.hand_labels import Suggestion
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.geometry.projection import project_boxes
from wibam_core.scene import AnnotatedInstant, CameraRig, Vehicles3D

#: Share of the suggestions that is spread evenly; the others follow the disagreement.
_EVEN = 0.5


def disagreement(instant: AnnotatedInstant, fit: Vehicles3D, rig: CameraRig) -> float | None:
    """1 − the mean IoU of what the detector saw of vehicles with their fits' reprojections, over all views.

    One box in the world cannot fit views that contradict each other: a wrong association, a wrong clock, a hidden
    vehicle. None where no fitted vehicle was seen.
    """
    rows = {int(track_id): row for row, track_id in enumerate(fit.ids)}
    overlaps: list[float] = []
    for camera_id, camera in rig.items():
        seen = instant.detections.get(camera_id)
        pairs = [
            (vehicle.views[camera_id], rows[vehicle.track_id])
            for vehicle in instant.vehicles
            if camera_id in vehicle.views and vehicle.track_id in rows
        ]
        if seen is None or not pairs:
            continue
        detected, fitted = (np.array(numbers) for numbers in zip(*pairs, strict=True))
        iou = image_iou(seen.whole_boxes[detected], project_boxes(camera, fit.boxes[fitted]))
        overlaps += np.nan_to_num(np.diagonal(iou)).tolist()
    return 1.0 - float(np.mean(overlaps)) if overlaps else None


def suggest(
    times_ns: Sequence[int],
    fits: Mapping[int, Vehicles3D],
    annotations: Mapping[int, AnnotatedInstant],
    rig: CameraRig,
    count: int,
    left_out: Collection[int] = (),
) -> list[Suggestion]:
    """Instants to label, in order of time.

    Every instant weighs the same in one half, and by how far the cameras disagree there in the other; instants are
    taken at equal steps of the weights' sum. The choice follows from the input alone.

    Args:
        times_ns: the test part, ascending.
        fits: by time.
        annotations: by time.
        rig: the cameras.
        count: how many at most.
        left_out: times that are not to be suggested, since they are labelled.
    """
    candidates = [time_ns for time_ns in times_ns if time_ns not in left_out]
    found = [
        Suggestion(
            time_ns=time_ns,
            vehicles=len(fits[time_ns]) if time_ns in fits else 0,
            disagreement=disagreement(annotations[time_ns], fits[time_ns], rig)
            if time_ns in fits and time_ns in annotations
            else None,
        )
        for time_ns in candidates
    ]
    if count >= len(found):
        return found
    doubt = np.array([one.disagreement or 0.0 for one in found])
    weights = np.full(len(found), 1.0 / len(found))
    if doubt.sum() > 0:
        weights = _EVEN * weights + (1.0 - _EVEN) * doubt / doubt.sum()
    steps = (np.arange(count) + 0.5) / count
    chosen = np.searchsorted(np.cumsum(weights) / weights.sum(), steps)
    return [found[row] for row in dict.fromkeys(chosen.tolist())]
