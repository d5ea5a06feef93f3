"""What a 3D network sees, as 2D boxes beside those of a detector."""

from __future__ import annotations

import numpy as np

from wibam_core.detection.boxes import Found
from wibam_core.geometry.boxes2d import image_iou, non_maximum_suppression, sides_px
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.outlines import outlines
from wibam_core.road_users import BODIES, VULNERABLE
from wibam_core.scene import Boxes2D, Vehicles3D

#: Outlines narrower or lower than this, px, say nothing.
_LEAST_PX = 4.0
#: A box of the detector that overlaps one of the network by more (IoU) shows the same vehicle.
SAME_IOU = 0.4


def outlines_of(vehicles: Vehicles3D, camera: Camera, max_iou: float) -> Found:
    """Boxes around the bodies of vehicles that a network detected in an image, within it, best first.

    Args:
        vehicles: of one image, in the world.
        camera: of that image; px are its own.
        max_iou: of two that overlap more, the weaker is left out.
    """
    seen = outlines(camera, vehicles.boxes, BODIES[vehicles.classes])
    rows = np.flatnonzero(seen.in_image & (sides_px(seen.shown).min(axis=1, initial=np.inf) >= _LEAST_PX))
    kept = rows[non_maximum_suppression(seen.shown[rows], vehicles.scores[rows], max_iou)]
    return Found(seen.shown[kept], vehicles.scores[kept], vehicles.classes[kept])


def beside(network: Found, detector: Boxes2D) -> Found:
    """The network's boxes, and those of the detector that it has none for.

    Those of people on foot and on two wheels stay as they are: a vehicle does not stand for one.
    """
    overlaps = image_iou(detector.boxes, network.boxes)
    overlaps[VULNERABLE[detector.classes][:, None] != VULNERABLE[network.classes][None, :]] = 0.0
    alone = np.flatnonzero(overlaps.max(axis=1, initial=0.0) <= SAME_IOU)
    return Found(
        np.concatenate([network.boxes, detector.boxes[alone]]),
        np.concatenate([network.scores, detector.scores[alone]]),
        np.concatenate([network.classes, detector.classes[alone]]),
    )
