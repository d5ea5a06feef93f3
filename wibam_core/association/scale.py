"""Whether road users look as large as they are: the check of a calibration that needs no surveyed point.

A world in feet, a road that does not lie at z = 0, or intrinsics of another picture fit their points without an error,
but show cars several times too large or too small.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wibam_core.association.rays import ground_points
from wibam_core.documents.warnings import Caution
from wibam_core.errors import CalibrationError
from wibam_core.geometry.boxes2d import sides_px
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, FloatArray, IntArray

#: (classes, 3) usual length, width and height in the order of `CLASSES`, m.
_SIZES_M: FloatArray = np.array([c.traits.size.size_m for c in CLASSES])
_HEADINGS_RAD: FloatArray = np.linspace(0.0, np.pi, 8, endpoint=False)
#: Of boxes that end this close to the border nobody knows how large they are.
_BORDER_PX = 3.0
#: So many boxes of a camera are looked at, spread over the recording, and so many are needed.
_MOST_BOXES = 400
_FEWEST_BOXES = 30
#: Of the sizes that a road user has when it is turned, its own is this quantile: most drive towards a camera or away,
#: or are hidden in part. With it the ratios are 0.8 to 1.2, in simulation and at a real roundabout.
_TYPICAL = 0.25
#: Median ratios of apparent to usual size beyond which they are doubtful, and impossible.
_DOUBTFUL = (0.6, 1.4)
_IMPOSSIBLE = (0.35, 2.2)
#: Feet are told by sizes to this share; all other units are told from metres by the height of the camera.
_FEET_PER_METRE = 1 / 0.3048
_SAME_UNIT = 0.25


def size_cautions(instants: Sequence[AnnotatedInstant], rig: CameraRig) -> list[Caution]:
    """Cameras in which road users look much larger or smaller than they are.

    Args:
        instants: with detections.
        rig: the calibrated cameras.

    Raises:
        CalibrationError: naming a camera in which they do so beyond all doubt.
    """
    found = []
    for camera_id, camera in rig.items():
        ratio = apparent_size(camera, [i.detections[camera_id] for i in instants if camera_id in i.detections])
        if ratio is None or _DOUBTFUL[0] <= ratio <= _DOUBTFUL[1]:
            continue
        message, hint = f"road users look {ratio:.2g} times as large as they are", _hint(ratio)
        if not _IMPOSSIBLE[0] <= ratio <= _IMPOSSIBLE[1]:
            raise CalibrationError(f"camera {camera_id}: {message}", hint=hint, camera=camera_id, ratio=ratio)
        caution = Caution(code="apparent_size", message=message, hint=hint, details={"ratio": ratio})
        found.append(caution.of_camera(camera_id))
    return found


def apparent_size(camera: Camera, seen: Sequence[Detections2D]) -> float | None:
    """Median size of boxes over that of usual road users of their classes at these places; None for too few boxes."""
    places, classes, sizes_px = _whole_boxes(camera, seen)
    if len(places) < _FEWEST_BOXES:
        return None
    spread = np.linspace(0, len(places) - 1, min(len(places), _MOST_BOXES)).astype(np.int64)
    places, classes, sizes_px = places[spread], classes[spread], sizes_px[spread]
    usual_m = _SIZES_M[classes]
    usual_px = []
    for heading in _HEADINGS_RAD:
        turned = np.full((len(places), 1), heading)
        boxes = np.concatenate([places, usual_m[:, 2:] / 2, usual_m, turned], axis=1)
        usual_px.append(_diagonals_px(project_boxes(camera, boxes, clamp=False)))
    ratios = sizes_px / np.quantile(usual_px, _TYPICAL, axis=0)
    return float(np.median(ratios[np.isfinite(ratios)]))


def _whole_boxes(camera: Camera, seen: Sequence[Detections2D]) -> tuple[FloatArray, IntArray, FloatArray]:
    """Ground points (N, 2), classes (N,) and sizes (N,) in px of boxes that the border does not cut."""
    places, classes, sizes_px = [np.empty((0, 2))], [np.empty(0, np.int64)], [np.empty(0)]
    limits_px = np.array(camera.size_px) - 0.5 - _BORDER_PX
    for detections in seen:
        boxes = detections.whole_boxes
        points = ground_points(camera, boxes, detections.classes)
        whole = ((boxes[:, :2] > _BORDER_PX - 0.5) & (boxes[:, 2:] < limits_px)).all(axis=1)
        good = whole & np.isfinite(points).all(axis=1)
        places.append(points[good])
        classes.append(detections.classes[good])
        sizes_px.append(_diagonals_px(boxes[good]))
    return np.concatenate(places), np.concatenate(classes), np.concatenate(sizes_px)


def _diagonals_px(boxes: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(sides_px(boxes), axis=-1))


def _hint(ratio: float) -> str:
    in_feet = abs(ratio / _FEET_PER_METRE - 1) < _SAME_UNIT
    meant = "Positions may be in feet: multiply them by 0.3048. " if in_feet else ""
    return f"{meant}Check the units of the calibration, that the road lies at z = 0, and that K is the recording's."
