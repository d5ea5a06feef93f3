"""Where a 2D box says its vehicle stands: one ray per box, met with a plane at the height of the body's middle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane
from wibam_core.road_users import CLASSES
from wibam_core.scene import CameraRig, FloatArray, IntArray

#: (classes,) in the order of `CLASSES`: height of the plane that the ray is met with, m.
PLANE_HEIGHTS_M: FloatArray = np.array([c.traits.plane_height_m for c in CLASSES])
#: How far a ground point of a usual car near the camera lies off, m: perspective, taper and jitter together.
POINT_SD_M = 0.5
_PLACE_SCALES: FloatArray = np.array([c.traits.place_scale for c in CLASSES])
#: Two errors move a ground point along its ray, the farther the flatter that is. Standard deviation of the row that the
#: ray goes through: this many px, and this share of the box's height, added in squares.
_ROW_SD_PX = 1.0
_ROW_SD_SHARE = 0.03
#: Standard deviation of the height of the vehicle's middle, as a share of the plane's height.
_HEIGHT_SD_SHARE = 0.2
#: No ground point is taken to be less certain than this: rays near the horizon would reach across the whole site.
LARGEST_SD_M = 6.0


def ground_points(camera: Camera, boxes: FloatArray, classes: IntArray) -> FloatArray:
    """Ground position (N, 2) in m of each of N detections; NaN where its ray never meets the plane.

    The ray goes through the middle of the image box. A cuboid is symmetric about its centre, so that (perspective
    within the vehicle aside) the middle of its image box shows that centre from every side and at every pitch; a
    body that narrows upwards has it somewhat lower. A row nearer to the bottom would be biased towards the camera,
    and cameras on opposite sides would disagree by twice the bias.

    Args:
        camera: that detected them.
        boxes: (N, 4) xyxy, px, around whole vehicles where that is known (`Detections2D.whole_boxes`).
        classes: (N,).
    """
    middles = 0.5 * (boxes[:, :2] + boxes[:, 2:])
    return intersect_plane(camera, middles, PLANE_HEIGHTS_M[classes])[:, :2]


def ground_covariances(camera: Camera, boxes: FloatArray, classes: IntArray, points: FloatArray) -> FloatArray:
    """(N, 2, 2) covariances, m², of finite `ground_points` (N, 2) of N detections.

    They are long along the ray where it is flat: a pixel, or a vehicle taller than usual, then means metres.
    """
    offset = points - camera.centre_m[:2]
    distance = np.maximum(np.linalg.norm(offset, axis=-1), 1e-6)
    plane = PLANE_HEIGHTS_M[classes]
    above = np.maximum(camera.centre_m[2] - plane, 0.5)
    row_px = np.hypot(_ROW_SD_PX, _ROW_SD_SHARE * (boxes[:, 3] - boxes[:, 1]))
    by_row = (distance**2 + above**2) / above * row_px / camera.K[1, 1]
    by_height = distance / above * _HEIGHT_SD_SHARE * plane
    base = POINT_SD_M * _PLACE_SCALES[classes]
    along = np.minimum(np.sqrt(base**2 + by_row**2 + by_height**2), np.maximum(LARGEST_SD_M, base))
    direction = offset / distance[:, None]
    outer = direction[:, :, None] * direction[:, None, :]
    return np.asarray(base[:, None, None] ** 2 * np.eye(2) + (along**2 - base**2)[:, None, None] * outer)


def rig_centre(rig: CameraRig) -> FloatArray:
    """(2,) mean ground position of the cameras, m: ranges are counted from here."""
    return np.asarray(np.mean([camera.centre_m[:2] for camera in rig.values()], axis=0))


def within_range(points: FloatArray, centre: FloatArray, range_m: float) -> NDArray[np.bool_]:
    """Which ground points (N, 2) lie within ``range_m`` of ``centre`` (2,); NaN does not."""
    return np.asarray(np.linalg.norm(points - centre, axis=-1) <= range_m)
