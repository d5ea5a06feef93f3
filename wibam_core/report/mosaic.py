"""The ground as all cameras see it together: an orthophoto for plan views to lie on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.box3d import XY
from wibam_core.geometry.camera import Camera
from wibam_core.scene import CameraRig, Track

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: A cell that a camera sees at a flatter angle than this is left to the others: it would be a long smear.
_MIN_ELEVATION_RAD = np.radians(7.0)
#: Frames of each camera whose median is its typical image.
_TYPICAL_FRAMES = 9
#: Tracks farther than this outside the circle of cameras do not widen the maps.
_STRAY_M = 30.0


@dataclass(frozen=True)
class Extent:
    """A rectangle of the ground plane, m."""

    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float

    @classmethod
    def around(cls, points: Array, margin_m: float = 6.0, *, least_m: float = 20.0) -> Extent:
        """The smallest square with ``margin_m`` around points (N, 2), its side at least ``least_m``."""
        finite = points[np.isfinite(points).all(axis=1)]
        if not len(finite):
            finite = np.zeros((1, 2))
        low, high = finite.min(axis=0), finite.max(axis=0)
        centre = 0.5 * (low + high)
        half = max(0.5 * float((high - low).max()) + margin_m, 0.5 * least_m)
        return cls(*(float(v) for v in (centre[0] - half, centre[0] + half, centre[1] - half, centre[1] + half)))


def typical_image(images: list[Image]) -> Image:
    """Median (H, W, 3) of images of one camera at different times: what moves vanishes."""
    return np.asarray(np.median(np.stack(images), axis=0), dtype=np.uint8)


def typical_images(store: FrameStore, rig: CameraRig) -> dict[str, Image]:
    """Camera id -> `typical_image` of frames spread over the recording; cameras without any are left out."""
    images = {}
    for camera_id in rig:
        times = [instant.time_ns for instant in store.frame_sets if camera_id in instant.frame_times_ns]
        if times:
            picks = np.unique(np.linspace(0, len(times) - 1, _TYPICAL_FRAMES).round().astype(int))
            images[camera_id] = typical_image([store.image(camera_id, times[pick]) for pick in picks])
    return images


def where_traffic_is(rig: CameraRig, tracks: Sequence[Track]) -> Array:
    """(N, 2) where the cameras and nearly all states of tracks are, without what strayed far from the cameras, m."""
    cameras = np.array([camera.centre_m[:2] for camera in rig.values()])
    states = np.concatenate([np.empty((0, 2)), *(track.boxes[:, XY] for track in tracks)])
    centre = cameras.mean(axis=0)
    reach_m = np.linalg.norm(cameras - centre, axis=1).max() + _STRAY_M
    near = states[np.linalg.norm(states - centre, axis=1) <= reach_m]
    if not len(near):
        return cameras
    low, high = np.percentile(near, [1, 99], axis=0)
    return np.concatenate([cameras, near[((near >= low) & (near <= high)).all(axis=1)]])


def ground_mosaic(rig: CameraRig, images: Mapping[str, Image], extent: Extent, cell_m: float) -> Image:
    """The ground (z = 0) seen from above.

    Args:
        rig: calibrated cameras.
        images: camera id -> (H, W, 3), BGR, of any size with the camera's aspect ratio.
        extent: what to show.
        cell_m: side of a pixel of the result, m.

    Returns:
        (rows, columns, 3), RGB, north (largest y) in the first row; each cell is the mean over the cameras that see
        it, weighted by how steeply and closely they do; white where none does.
    """
    xs = np.arange(extent.x_min_m + 0.5 * cell_m, extent.x_max_m, cell_m)
    ys = np.arange(extent.y_max_m - 0.5 * cell_m, extent.y_min_m, -cell_m)
    grid = np.stack([*np.meshgrid(xs, ys), np.zeros((len(ys), len(xs)))], axis=-1)
    total = np.zeros((len(ys), len(xs), 3))
    weight = np.zeros((len(ys), len(xs)))
    for camera_id, image in images.items():
        colour, share = _seen_by(rig[camera_id], image, grid)
        total += share[..., None] * colour
        weight += share
    mosaic = np.where(weight[..., None] > 0, total / np.maximum(weight, 1e-12)[..., None], 255.0)
    return np.asarray(mosaic[..., ::-1], dtype=np.uint8)


def _seen_by(camera: Camera, image: Image, grid: Array) -> tuple[Array, Array]:
    """Colours (rows, columns, 3) and weights (rows, columns) of ground points as one camera sees them."""
    small = camera.resized(image.shape[1], image.shape[0])
    uv, _ = small.project(grid)
    seen = small.contains(uv)
    away = grid - camera.centre_m
    distance = np.linalg.norm(away, axis=-1)
    sine = -away[..., 2] / np.maximum(distance, 1e-9)
    seen &= sine > np.sin(_MIN_ELEVATION_RAD)
    where = np.where(seen[..., None], uv, -1.0).astype(np.float32)
    colour = cv2.remap(image, where[..., 0], where[..., 1], cv2.INTER_LINEAR)
    return colour.astype(np.float64), np.where(seen, (np.maximum(sine, 0.0) / np.maximum(distance, 1.0)) ** 2, 0.0)
