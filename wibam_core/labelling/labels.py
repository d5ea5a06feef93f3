"""From what people labelled to what evaluates and is exported."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.hand_labels import HandLabels, HandRegion, HandVehicle
from wibam_core.exchange.base import Content
from wibam_core.geometry.box3d import XY
from wibam_core.geometry.polygons import inside_any
from wibam_core.geometry.projection import project_boxes
from wibam_core.labelling.seen import seen_by_hand, seen_shares
from wibam_core.road_users import CLASSES
from wibam_core.scene import (
    AnnotatedInstant,
    CameraRig,
    Detections2D,
    FloatArray,
    FrameSet,
    LabelledInstant,
    MultiViewVehicle,
    Vehicles3D,
)
from wibam_core.site import Site


def boxes_of(labels: HandLabels) -> FloatArray:
    """(N, 7) the boxes of an instant's vehicles."""
    return np.array([vehicle.box for vehicle in labels.vehicles], np.float64).reshape(-1, 7)


def visibility_of(labels: HandLabels, rig: CameraRig) -> dict[str, FloatArray]:
    """Camera id -> (N,) share that it sees of each vehicle: as given by hand, else as estimated."""
    hidden: dict[str, list[FloatArray]] = {}
    for region in labels.regions:
        if region.camera is not None:
            hidden.setdefault(region.camera, []).append(np.array(region.polygon))
    return seen_by_hand(seen_shares(boxes_of(labels), rig, hidden), [vehicle.visibility for vehicle in labels.vehicles])


def do_not_care(labels: HandLabels) -> tuple[FloatArray, ...]:
    """Polygons (K, 2) on the ground in which nobody looked closely."""
    return tuple(np.array(region.polygon) for region in labels.regions if region.kind == "do_not_care")


def asked_for(labels: HandLabels) -> NDArray[np.bool_]:
    """(N,) which vehicles one must find: not those that are ignored, or stand where nobody looked closely."""
    wanted = np.array([not vehicle.ignored for vehicle in labels.vehicles], bool)
    return wanted & ~inside_any(boxes_of(labels)[:, XY], do_not_care(labels))


def labelled_instant(labels: HandLabels, rig: CameraRig) -> LabelledInstant:
    """An instant as evaluations take it: whom nobody is asked for no camera sees."""
    wanted = asked_for(labels)
    classes = np.array([CLASSES.index(vehicle.vehicle_class) for vehicle in labels.vehicles], np.int64)
    ids = np.array([vehicle.id for vehicle in labels.vehicles], np.int64)
    return LabelledInstant(
        Vehicles3D.of(labels.time_ns, boxes_of(labels), classes, ids),
        {camera_id: shares * wanted for camera_id, shares in visibility_of(labels, rig).items()},
        np.array([vehicle.velocity_mps for vehicle in labels.vehicles], np.float64).reshape(-1, 2),
        do_not_care(labels),
    )


def labelled_instants(labels: Iterable[HandLabels], rig: CameraRig) -> list[LabelledInstant]:
    """The finished ones, in order of time."""
    finished = sorted((one for one in labels if one.finished), key=lambda one: one.time_ns)
    return [labelled_instant(one, rig) for one in finished]


def hand_labels(instant: LabelledInstant) -> HandLabels:
    """An instant of a labels file as if somebody had labelled and finished it, the inverse of `labelled_instant`.

    Whom no camera sees is ignored. Vehicles whose id is unknown are numbered after the largest that is known, and a
    velocity that is unknown is none.
    """
    vehicles, known = instant.vehicles, max([-1, *instant.vehicles.ids.tolist()])
    found = []
    for row in range(len(vehicles)):
        number = int(vehicles.ids[row])
        if number < 0:
            known = number = known + 1
        seen = {camera_id: float(shares[row]) for camera_id, shares in instant.visibility.items()}
        velocity = np.nan_to_num(instant.velocities_mps[row])
        found.append(
            HandVehicle(
                id=number,
                vehicle_class=CLASSES[int(vehicles.classes[row])],
                box=tuple(vehicles.boxes[row].tolist()),
                velocity_mps=(float(velocity[0]), float(velocity[1])),
                visibility={camera_id: share for camera_id, share in seen.items() if share > 0},
                ignored=bool(seen) and not any(seen.values()),
            )
        )
    regions = tuple(
        HandRegion(kind="do_not_care", polygon=tuple((float(x), float(y)) for x, y in polygon))
        for polygon in instant.do_not_care
    )
    return HandLabels(time_ns=vehicles.time_ns, vehicles=tuple(found), regions=regions, finished=True)


def content_of(
    site: Site,
    rig: CameraRig,
    labels: Sequence[LabelledInstant],
    frames: Mapping[int, FrameSet],
    jpeg: Callable[[str, int], bytes] | None = None,
) -> Content:
    """Labels as exchange formats take them; their 2D boxes are those of the labels, reprojected.

    Args:
        site: whose.
        rig: its cameras.
        labels: in order of time.
        frames: by instant.
        jpeg: frames as files, see `Content`.
    """
    instants = [_reprojected(one, frames[one.vehicles.time_ns], rig) for one in labels]
    return Content(site=site, rig=rig, instants=instants, labels=labels, jpeg=jpeg)


def _reprojected(labels: LabelledInstant, frames: FrameSet, rig: CameraRig) -> AnnotatedInstant:
    vehicles = labels.vehicles
    views: list[dict[str, int]] = [{} for _ in range(len(vehicles))]
    detections = {}
    for camera_id, frame_time_ns in frames.frame_times_ns.items():
        boxes = project_boxes(rig[camera_id], vehicles.boxes)
        rows = np.flatnonzero(np.isfinite(boxes).all(axis=1) & (labels.visibility[camera_id] > 0))
        detections[camera_id] = Detections2D(
            camera_id, frame_time_ns, boxes[rows], np.ones(len(rows)), vehicles.classes[rows]
        )
        for number, row in enumerate(rows.tolist()):
            views[row][camera_id] = number
    return AnnotatedInstant(
        vehicles.time_ns,
        detections,
        tuple(
            MultiViewVehicle(
                row,
                int(vehicles.ids[row]),
                CLASSES[int(vehicles.classes[row])],
                float(vehicles.boxes[row, 0]),
                float(vehicles.boxes[row, 1]),
                seen,
            )
            for row, seen in enumerate(views)
            if seen
        ),
    )
