"""Augmentations that keep image, camera and labels consistent. All are driven by an explicit generator."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import YAW, Y
from wibam_core.geometry.boxes2d import areas_px2, clipped_to_image
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3, normalise_angle
from wibam_core.training.views import FloatArray, LabelledView

#: Mirrors the world's y axis, and an image's columns: both at once keep a rotation proper.
_MIRROR_WORLD = np.diag([1.0, -1.0, 1.0])
_MIRROR_CAMERA = np.diag([-1.0, 1.0, 1.0])

#: Vehicles of which less than this share of the 2D box stays in a warped image are ignored rather than learned.
_MIN_KEPT_SHARE = 0.4

#: `shake` multiplies the focal length by a factor whose logarithm lies between these.
_ZOOM = (-0.15, 0.25)
#: It turns the camera down and to the left by an angle each with this standard deviation.
_TURN_SD_RAD = 0.05
#: What a warped image shows where the old one ends: black.
_FILL = (0, 0, 0)


def mirror_camera(camera: Camera) -> Camera:
    """The camera that sees the world mirrored at y = 0 as the column-mirrored image."""
    T = camera.T_cam_world
    T_mirrored = SE3(_MIRROR_CAMERA @ T.rotation @ _MIRROR_WORLD, _MIRROR_CAMERA @ T.translation)
    K = camera.K.copy()
    K[0, 2] = camera.width_px - 1 - K[0, 2]
    K[0, 1] = -K[0, 1]
    dist = camera.dist.copy()
    if dist.size >= 4:
        dist[3] = -dist[3]  # p2
    if dist.size >= 12:
        dist[8:10] = -dist[8:10]  # s1, s2
    return Camera(K, dist, T_mirrored.inverse(), camera.width_px, camera.height_px)


def mirror_boxes3d(boxes: FloatArray) -> FloatArray:
    """World boxes (N, 7) mirrored at y = 0."""
    mirrored = boxes.copy()
    mirrored[:, Y] = -boxes[:, Y]
    mirrored[:, YAW] = normalise_angle(-boxes[:, YAW])
    return mirrored


def mirror(view: LabelledView) -> LabelledView:
    """The view mirrored left to right, with the world mirrored at y = 0."""

    def boxes2d(boxes: FloatArray) -> FloatArray:
        return np.stack(
            [view.camera.width_px - 1 - boxes[:, 2], boxes[:, 1], view.camera.width_px - 1 - boxes[:, 0], boxes[:, 3]],
            axis=1,
        )

    return replace(
        view,
        image=np.asarray(cv2.flip(view.image, 1), dtype=np.uint8),
        camera=mirror_camera(view.camera),
        boxes2d=boxes2d(view.boxes2d),
        boxes3d=mirror_boxes3d(view.boxes3d),
        ignored=boxes2d(view.ignored),
    )


def turn_camera(camera: Camera, pitch_down_rad: float, yaw_left_rad: float, roll_rad: float) -> SE3:
    """``T_world_cam`` of the camera turned about its own centre, in its own axes."""
    cp, sp = np.cos(pitch_down_rad), np.sin(pitch_down_rad)
    cy, sy = np.cos(yaw_left_rad), np.sin(yaw_left_rad)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    pitch = np.array([[1, 0, 0], [0, cp, sp], [0, -sp, cp]])
    yaw = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    roll = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return SE3(camera.T_world_cam.rotation @ yaw @ pitch @ roll, camera.T_world_cam.translation)


def rewarp(view: LabelledView, camera: Camera, fill: tuple[int, int, int]) -> LabelledView:
    """The view as ``camera`` would take it from the same place: ``K R K⁻¹``, exact for any scene.

    Both cameras must be free of distortion. Vehicles mostly outside the new image are dropped, and those cut by the
    border of the old image are ignored.
    """
    turn = camera.T_world_cam.rotation.T @ view.camera.T_world_cam.rotation
    H = camera.K @ turn @ np.linalg.inv(view.camera.K)
    size = (camera.width_px, camera.height_px)
    image = cv2.warpPerspective(view.image, H, size, flags=cv2.INTER_LINEAR, borderValue=fill)
    whole = _warp_boxes(H, view.boxes2d)
    inside = clipped_to_image(whole, camera.width_px, camera.height_px)
    share = areas_px2(inside) / np.maximum(areas_px2(whole), 1e-9)
    in_front = ~np.isnan(whole[:, 0])
    kept = in_front & (share >= _MIN_KEPT_SHARE)
    cut = in_front & ~kept & (share > 0.02)
    ignored = _warp_boxes(H, view.ignored)
    ignored = clipped_to_image(ignored[~np.isnan(ignored[:, 0])], camera.width_px, camera.height_px)
    return replace(
        view.where(np.flatnonzero(kept)),
        image=np.asarray(image, dtype=np.uint8),
        camera=camera,
        boxes2d=inside[kept],
        ignored=np.concatenate([ignored, inside[cut]]),
    )


def shake(view: LabelledView, rng: np.random.Generator) -> LabelledView:
    """The view of the same camera turned and zoomed a little, so that few vehicles are seen in many places.

    A view with lens distortion is returned as it is: no homography describes its turning.
    """
    camera = view.camera
    if camera.has_distortion:
        return view
    zoom = float(np.exp(rng.uniform(*_ZOOM)))
    down, left = rng.normal(0.0, _TURN_SD_RAD, 2)
    K = camera.K * np.array([[zoom, zoom, 1.0], [1.0, zoom, 1.0], [1.0, 1.0, 1.0]])
    turned = rewarp(view, replace(camera, K=K, T_world_cam=turn_camera(camera, float(down), float(left), 0.0)), _FILL)
    image = np.zeros_like(view.image)
    image[: camera.height_px] = turned.image
    return replace(turned, image=image)


def _warp_boxes(H: FloatArray, boxes: FloatArray) -> FloatArray:
    """Tight boxes (N, 4) around warped boxes (N, 4); NaN where a corner falls behind the camera."""
    corners = boxes[:, [[0, 1], [2, 1], [2, 3], [0, 3]]]
    warped = np.concatenate([corners, np.ones((len(boxes), 4, 1))], axis=2) @ H.T
    depth = warped[..., 2]
    in_front = (
        depth.min(axis=1, initial=1.0) > 1e-3
    )  # the last row of both K is 0 0 1: this is the depth of a ray of depth 1
    uv = warped[..., :2] / np.where(np.abs(depth) < 1e-9, 1e-9, depth)[..., None]
    tight = np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)
    return np.where(in_front[:, None], tight, np.nan)


def jitter_colour(image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Random gain and offset, common and per channel, and now and then blur or noise."""
    gain = np.exp(rng.normal(0.0, 0.18)) * np.exp(rng.normal(0.0, 0.05, 3))
    offset = rng.normal(0.0, 12.0) + rng.normal(0.0, 4.0, 3)
    table = np.clip(np.arange(256)[:, None] * gain + offset, 0, 255).astype(np.uint8)
    result = np.asarray(cv2.LUT(image, table[:, None, :]), dtype=np.uint8)
    kind = rng.random()
    if kind < 0.15:
        result = np.asarray(cv2.GaussianBlur(result, (3, 3), float(rng.uniform(0.4, 1.0))), dtype=np.uint8)
    elif kind < 0.35:
        noise = np.empty(result.shape, dtype=np.int8)
        cv2.setRNGSeed(int(rng.integers(2**31)))
        cv2.randn(noise, (0, 0, 0), (float(rng.uniform(2, 8)),) * 3)
        result = np.asarray(cv2.add(result, noise, dtype=cv2.CV_8U), dtype=np.uint8)
    return result


def compress(image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """The image with JPEG artefacts."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(30, 90))])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)


def cut_out(image: NDArray[np.uint8], rng: np.random.Generator, most: int = 3) -> NDArray[np.uint8]:
    """The image with a few small flat rectangles over it, as posts and leaves cover parts of vehicles."""
    result = image.copy()
    height, width = image.shape[:2]
    for _ in range(int(rng.integers(0, most + 1))):
        w, h = int(rng.integers(3, 28)), int(rng.integers(3, 28))
        x, y = int(rng.integers(0, width - w)), int(rng.integers(0, height - h))
        result[y : y + h, x : x + w] = rng.integers(0, 256, 3)
    return result
