"""Agreement of each camera with what the others place, on traffic with exact geometry."""

from dataclasses import replace

import numpy as np
import pytest

from tests.multiview import crossing
from wibam_core.config import LiftConfig
from wibam_core.documents.rounds import HeldOutAgreement
from wibam_core.rounds.agreement import held_out_agreement
from wibam_core.scene import AnnotatedInstant

CAMERA = "cam2"


def scene_instants() -> list[AnnotatedInstant]:
    return crossing(duration_s=4.0, jitter=0.01).instants[::2]


def agreement(instants: list[AnnotatedInstant]) -> HeldOutAgreement:
    return held_out_agreement(instants, crossing(duration_s=4.0, jitter=0.01).rig, LiftConfig())


@pytest.fixture(scope="module")
def exact() -> HeldOutAgreement:
    return agreement(scene_instants())


def shifted(instant: AnnotatedInstant, px: float) -> AnnotatedInstant:
    seen = instant.detections[CAMERA]
    moved = replace(seen, boxes=seen.boxes + px, amodal_boxes=(), amodal_sd=())
    return replace(instant, detections={**instant.detections, CAMERA: moved})


def blind(instant: AnnotatedInstant, every: int) -> AnnotatedInstant:
    """Without every so many'th box of the camera."""
    kept = np.arange(len(instant.detections[CAMERA])) % every > 0
    number = np.cumsum(kept) - 1
    vehicles = []
    for vehicle in instant.vehicles:
        views = {c: row for c, row in vehicle.views.items() if c != CAMERA or kept[row]}
        if CAMERA in views:
            views[CAMERA] = int(number[views[CAMERA]])
        if views:
            vehicles.append(replace(vehicle, views=views))
    detections = {**instant.detections, CAMERA: instant.detections[CAMERA].where(kept)}
    return replace(instant, detections=detections, vehicles=tuple(vehicles))


def test_cameras_that_see_the_same_agree(exact: HeldOutAgreement) -> None:
    assert exact.sightings > 100
    assert exact.iou is not None and exact.iou > 0.75
    assert exact.found is not None and exact.found > 0.85
    assert exact.an_instant == pytest.approx(exact.iou * exact.sightings / exact.instants)


def test_a_camera_that_overlooks_vehicles_is_seen_to(exact: HeldOutAgreement) -> None:
    worse = agreement([blind(instant, 2) for instant in scene_instants()])
    assert worse.missed > exact.missed + 10
    assert worse.found is not None and exact.found is not None and worse.found < exact.found - 0.05
    assert worse.an_instant < exact.an_instant


def test_a_camera_whose_boxes_lie_off_agrees_less(exact: HeldOutAgreement) -> None:
    worse = agreement([shifted(instant, 8.0) for instant in scene_instants()])
    assert worse.iou is not None and exact.iou is not None and worse.iou < exact.iou - 0.05


def test_nothing_agrees_with_nothing() -> None:
    nothing = agreement([replace(instant, vehicles=()) for instant in scene_instants()])
    assert (nothing.sightings, nothing.missed, nothing.iou, nothing.found) == (0, 0, None, None)
    assert nothing.an_instant == 0.0
