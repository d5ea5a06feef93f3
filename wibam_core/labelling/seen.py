"""How much of each vehicle a camera sees, as far as the boxes of the others and the border of the image tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import EDGES, XYZ, corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import EDGE_SHARES, NEAR_M
from wibam_core.scene import CameraRig, FloatArray

#: Outlines are painted this wide at most, px.
_PAINTED_WIDTH_PX = 960


def seen_shares(
    boxes: FloatArray, rig: CameraRig, hidden: Mapping[str, Sequence[FloatArray]] = MappingProxyType({})
) -> dict[str, FloatArray]:
    """Camera id -> (N,) share in [0, 1] of each box's outline that the camera sees.

    What lies beyond the border of the image is not seen, and what lies behind the outline of a nearer box neither.
    Buildings and trees are not known of, but as far as somebody has outlined them.

    Args:
        boxes: (N, 7).
        rig: whose cameras.
        hidden: camera id -> polygons (K, 2) in its picture, px, before which something stands.
    """
    return {camera_id: _in_camera(camera, boxes, hidden.get(camera_id, ())) for camera_id, camera in rig.items()}


def seen_by_hand(estimated: Mapping[str, FloatArray], given: list[Mapping[str, float]]) -> dict[str, FloatArray]:
    """The estimates (N,) by camera, but for the vehicles and cameras for which somebody gave another share.

    Args:
        estimated: by camera, see `seen_shares`.
        given: of each of the N vehicles, camera id -> share.
    """
    return {
        camera_id: np.array([by_hand.get(camera_id, share) for by_hand, share in zip(given, shares, strict=True)])
        for camera_id, shares in estimated.items()
    }


def _in_camera(camera: Camera, boxes: FloatArray, hidden: Sequence[FloatArray]) -> FloatArray:
    scale = min(1.0, _PAINTED_WIDTH_PX / camera.width_px)
    width, height = max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale))
    border = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    outlines = [_outline(camera, box, scale) for box in boxes]
    owner = np.full((height, width), -1, np.int32)
    alone = np.zeros(len(boxes))
    within = np.zeros(len(boxes))
    distance = np.linalg.norm(boxes[:, XYZ] - camera.centre_m, axis=1)
    for row in np.argsort(-distance, kind="stable").tolist():
        outline = outlines[row]
        area = 0.0 if outline is None else float(cv2.contourArea(outline))
        if outline is None or area <= 0:
            continue
        shown, polygon = cv2.intersectConvexConvex(outline, border)
        if shown <= 0 or polygon is None:
            continue
        within[row] = shown / area
        mask = np.zeros((height, width), np.uint8)
        cv2.fillConvexPoly(mask, np.rint(polygon - 0.5).astype(np.int32), 1)
        alone[row] = mask.sum()
        owner[mask > 0] = row
    for polygon in hidden:
        mask = np.zeros((height, width), np.uint8)
        cv2.fillPoly(mask, [np.rint(np.clip((polygon + 0.5) * scale, -1e5, 1e5) - 0.5).astype(np.int32)], 1)
        owner[mask > 0] = -1
    kept = np.bincount(owner[owner >= 0], minlength=len(boxes))
    return np.asarray(np.clip(within * kept / np.maximum(alone, 1.0), 0.0, 1.0))


def _outline(camera: Camera, box: FloatArray, scale: float) -> NDArray[np.float32] | None:
    """Convex outline (K, 1, 2) of what of a box lies before the camera; px, (0, 0) the corner of the picture."""
    ends = camera.to_camera(corners(box))[EDGES]
    start, end = ends[:, 0], ends[:, 1]
    kept = (start[:, 2] >= NEAR_M) | (end[:, 2] >= NEAR_M)
    if not kept.any():
        return None
    start, end = start[kept], end[kept]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.clip((NEAR_M - start[:, 2]) / (end[:, 2] - start[:, 2]), 0.0, 1.0)[:, None]
        cut = start + at * (end - start)
    start, end = (np.where((points[:, 2] < NEAR_M)[:, None], cut, points) for points in (start, end))
    shares = EDGE_SHARES[:, None, None] if camera.has_distortion else np.array([0.0, 1.0])[:, None, None]
    points = ((1 - shares) * start + shares * end).reshape(-1, 3)
    pixels = (camera.project_camera_points(points) + 0.5) * scale
    hull: NDArray[np.float32] = cv2.convexHull(np.clip(pixels, -1e5, 1e5).astype(np.float32))
    return hull
