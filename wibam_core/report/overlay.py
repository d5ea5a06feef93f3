"""3D boxes drawn into camera images."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.geometry.box3d import EDGES, corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import NEAR_M

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Bgr = tuple[int, int, int]

#: Corners of the front face, in order around it.
FRONT_FACE = (0, 3, 7, 4)
#: Points per edge: with lens distortion a straight edge is a curve in the image.
_EDGE_POINTS = 9
_SUBPIXEL_BITS = 4


def draw_boxes(
    image: Image,
    camera: Camera,
    boxes: ArrayLike,
    colour_bgr: Bgr | Sequence[Bgr],
    *,
    thickness_px: int = 2,
    mark_front: bool = True,
) -> Image:
    """A copy of an image with wireframes of boxes.

    Args:
        image: (H, W, 3), BGR, uint8, of any size with the camera's aspect ratio.
        camera: of the recording; resized to the image here.
        boxes: (N, 7) in the world.
        colour_bgr: of the lines: one for all boxes, or one for each.
        thickness_px: of the lines.
        mark_front: tint the front face, so that a heading that is off by half a turn shows.
    """
    height, width = image.shape[:2]
    camera = camera.resized(width, height)
    drawn = image.copy()
    cam = camera.to_camera(corners(np.asarray(boxes, dtype=np.float64).reshape(-1, 7)))
    order = np.argsort(-np.linalg.norm(cam.mean(axis=1), axis=1), kind="stable")
    colours = np.broadcast_to(np.asarray(colour_bgr, dtype=np.int64), (len(cam), 3)).tolist()
    for number in order:
        vertices, (blue, green, red) = cam[number], colours[number]
        if mark_front:
            _tint(drawn, camera, vertices[list(FRONT_FACE)], (blue, green, red))
        for start, end in EDGES:
            for a, b in project_edge(camera, vertices[start], vertices[end]):
                _line(drawn, a, b, (blue, green, red), thickness_px)
    return drawn


def project_edge(camera: Camera, start_cam: Array, end_cam: Array) -> list[tuple[Array, Array]]:
    """An edge between two camera-frame points (3,) as pieces in the image: (2,) px to (2,) px.

    It is cut at the near plane first, then at the image border. Empty where nothing of it is seen.
    """
    z0, z1 = start_cam[2], end_cam[2]
    if z0 < NEAR_M and z1 < NEAR_M:
        return []
    if z0 < NEAR_M:
        start_cam = start_cam + (NEAR_M - z0) / (z1 - z0) * (end_cam - start_cam)
    elif z1 < NEAR_M:
        end_cam = end_cam + (NEAR_M - z1) / (z0 - z1) * (start_cam - end_cam)
    share = np.linspace(0.0, 1.0, _EDGE_POINTS if camera.has_distortion else 2)[:, None]
    line = camera.project_camera_points(start_cam + share * (end_cam - start_cam))
    pieces = (clip_segment(a, b, camera.width_px, camera.height_px) for a, b in pairwise(line))
    return [piece for piece in pieces if piece is not None]


def clip_segment(a: Array, b: Array, width_px: int, height_px: int) -> tuple[Array, Array] | None:
    """The part of the segment a–b (2,) that lies in the image (Liang–Barsky), or None."""
    low, high = 0.0, 1.0
    step = b - a
    limits = (width_px - 0.5, height_px - 0.5)
    for axis in (0, 1):
        # in Python's own floats, a quotient beyond all numbers is infinite without a warning
        along, before, room_after = float(step[axis]), float(a[axis]) + 0.5, limits[axis] - float(a[axis])
        for slope, room in ((-along, before), (along, room_after)):
            if slope == 0:
                if room < 0:
                    return None
            elif slope < 0:
                low = max(low, room / slope)
            else:
                high = min(high, room / slope)
    return None if low > high else (a + low * step, a + high * step)


def clip_near(polygon_cam: Array) -> Array:
    """The part (M, 3) of a flat polygon (N, 3) in the camera frame beyond the near plane (Sutherland–Hodgman)."""
    kept = []
    for start, end in zip(polygon_cam, np.roll(polygon_cam, -1, axis=0), strict=True):
        if start[2] >= NEAR_M:
            kept.append(start)
        if (start[2] >= NEAR_M) != (end[2] >= NEAR_M):
            kept.append(start + (NEAR_M - start[2]) / (end[2] - start[2]) * (end - start))
    return np.array(kept).reshape(-1, 3)


def _tint(image: Image, camera: Camera, face_cam: Array, colour_bgr: Bgr) -> None:
    face = clip_near(face_cam)
    if len(face) < 3:
        return
    uv = camera.project_camera_points(face)
    if np.abs(uv).max() > 8 * max(camera.width_px, camera.height_px):
        return
    low = np.clip(np.floor(uv.min(axis=0)).astype(int), 0, None)
    high = np.ceil(uv.max(axis=0)).astype(int) + 1
    around = image[low[1] : max(high[1], low[1]), low[0] : max(high[0], low[0])]
    if not around.size:
        return
    mask = np.zeros(around.shape[:2], np.uint8)
    cv2.fillPoly(mask, [_fixed_point(uv - low)], 1, lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)
    inside = mask.astype(bool)
    around[inside] = (0.5 * around[inside] + 0.5 * np.array(colour_bgr)).astype(np.uint8)


def _line(image: Image, a: Array, b: Array, colour_bgr: Bgr, thickness_px: int) -> None:
    start, end = (tuple(int(v) for v in _fixed_point(point)) for point in (a, b))
    cv2.line(image, start, end, colour_bgr, thickness_px, cv2.LINE_AA, shift=_SUBPIXEL_BITS)


def _fixed_point(uv: Array) -> NDArray[np.int32]:
    return np.rint(uv * (1 << _SUBPIXEL_BITS)).astype(np.int32)
