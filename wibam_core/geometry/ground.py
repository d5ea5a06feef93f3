"""The ground plane Z = 0, and planes parallel to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.geometry.camera import Camera

Array = NDArray[np.float64]


def intersect_plane(camera: Camera, uv: ArrayLike, height_m: ArrayLike = 0.0) -> Array:
    """Where the rays through pixels (..., 2) meet the horizontal plane z = ``height_m`` (broadcast to (...)).

    Returns:
        World points (..., 3) in m; NaN where the ray does not meet the plane in front of the camera.
    """
    rays = camera.rays(uv)
    height = np.broadcast_to(np.asarray(height_m, dtype=np.float64), rays.shape[:-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (height - camera.centre_m[2]) / rays[..., 2]
    hit = np.isfinite(distance) & (distance > 0)
    points = camera.centre_m + rays * np.where(hit, distance, np.nan)[..., None]
    return np.asarray(points)
