"""Labelled views of two known vehicles, for tests of training and of the networks' decoders."""

from __future__ import annotations

import numpy as np

from wibam_core.geometry.box3d import corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.training.views import LabelledView

#: Camera axes of a level camera that looks along world +X.
LEVEL_FORWARD = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])

VEHICLES = np.array([[16.0, 1.0, 0.75, 4.4, 1.8, 1.5, 0.4], [24.0, -6.0, 1.0, 5.2, 2.0, 2.0, -2.6]])


def camera(dist: tuple[float, ...] = (), height_m: float = 1.6, pitch_down_rad: float = 0.0) -> Camera:
    """A camera at (1, −2, height) that looks along +X and down."""
    c, s = np.cos(pitch_down_rad), np.sin(pitch_down_rad)
    rotation = LEVEL_FORWARD @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    K = np.array([[420.0, 0, 250.0], [0, 415.0, 140.0], [0, 0, 1]])
    return Camera(K, np.array(dist), SE3(rotation, np.array([1.0, -2.0, height_m])), 512, 288)


def tight_boxes(boxes3d: np.ndarray, cam: Camera) -> np.ndarray:
    """(N, 4) boxes around the projected corners."""
    uv, _ = cam.project(corners(boxes3d))
    return np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)


def view_of(boxes3d: np.ndarray, cam: Camera) -> LabelledView:
    """A grey image in which ``boxes3d`` are labelled, all as cars."""
    n = len(boxes3d)
    image = np.full((cam.height_px, cam.width_px, 3), 90, np.uint8)
    return LabelledView(
        image=image,
        camera=cam,
        boxes2d=tight_boxes(boxes3d, cam),
        classes=np.zeros(n, np.int64),
        boxes3d=boxes3d,
        confidence=np.ones(n),
        front_known=np.ones(n, bool),
        ignored=np.zeros((0, 4)),
    )
