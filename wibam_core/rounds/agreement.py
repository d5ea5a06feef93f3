"""How well boxes of one camera agree with vehicles that the other cameras' boxes place: a measure without labels.

Every camera is left out in turn. What the others see is fitted, and its outline is compared with the box that the
camera has of the same vehicle. A vehicle that the camera should show and has no box of agrees by nothing. An error that
all cameras share stays hidden, and so does a vehicle that fewer than two of the others see.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace

import numpy as np

from wibam_core.config import LiftConfig
from wibam_core.documents.rounds import HeldOutAgreement
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.geometry.outlines import outlines
from wibam_core.lifting.lift import lift
from wibam_core.progress import Progress, part, silent
from wibam_core.road_users import BODIES
from wibam_core.scene import AnnotatedInstant, CameraRig, Vehicles3D
from wibam_core.training.fits import FitsByTrack
from wibam_core.training.overlooked import overlooked


def held_out_agreement(
    instants: Sequence[AnnotatedInstant],
    rig: CameraRig,
    config: LiftConfig,
    progress: Progress = silent,
    taught: Set[int] = frozenset(),
) -> HeldOutAgreement:
    """The agreement of all cameras of the rig, each with fits to the boxes of the others.

    Args:
        instants: associated, in order of time.
        rig: the cameras that the instants name.
        config: how vehicles are fitted.
        progress: told now and then.
        taught: tracks of vehicles that taught, which are not judged.
    """
    overlaps: list[float] = []
    missed = 0
    for number, camera_id in enumerate(rig):
        own = part(progress, number / len(rig), (number + 1) / len(rig))
        fits = lift([_without(instant, camera_id, taught) for instant in instants], rig, config, own).vehicles
        found, lacking = _compared(instants, fits, rig, camera_id)
        overlaps += found
        missed += lacking
    count = len(overlaps)
    return HeldOutAgreement(
        instants=len(instants),
        sightings=count,
        iou=float(np.mean(overlaps)) if count else None,
        missed=missed,
        found=count / (count + missed) if count + missed else None,
        an_instant=float(np.sum(overlaps)) / max(len(instants), 1),
    )


def _without(instant: AnnotatedInstant, camera_id: str, taught: Set[int]) -> AnnotatedInstant:
    """The instant without what one camera says of its vehicles, and without those that taught."""
    left = [
        replace(vehicle, views=views)
        for vehicle in instant.vehicles
        if vehicle.track_id not in taught
        and len(views := {other: row for other, row in vehicle.views.items() if other != camera_id}) >= 2
    ]
    return replace(instant, vehicles=tuple(left))


def _compared(
    instants: Sequence[AnnotatedInstant], fits: Sequence[Vehicles3D], rig: CameraRig, camera_id: str
) -> tuple[list[float], int]:
    """Overlaps of a camera's boxes with fits that it did not make, and how many of these it should show and lacks."""
    by_track = FitsByTrack(fits)
    overlaps: list[float] = []
    missed = 0
    for instant in instants:
        seen = instant.detections.get(camera_id)
        tracks = by_track.tracks_at(instant.time_ns)
        if seen is None or not tracks:
            continue
        row_of = {v.track_id: v.views[camera_id] for v in instant.vehicles if camera_id in v.views}
        boxes = np.array([by_track.box_at(track, instant.time_ns, seen.frame_time_ns) for track in tracks])
        classes = np.array([by_track.of(track, instant.time_ns).vehicle_class for track in tracks], dtype=np.int64)
        has = np.array([track in row_of for track in tracks], dtype=bool)
        shown = outlines(rig[camera_id], boxes, BODIES[classes])
        for place in np.flatnonzero(has & shown.in_image).tolist():
            target = seen.whole_boxes[row_of[tracks[place]]][None]
            overlaps.append(float(image_iou(shown.shown[[place]], target)[0, 0]))
        missed += len(overlooked(rig[camera_id], boxes, classes, has, seen.boxes).rows)
    return overlaps, missed
