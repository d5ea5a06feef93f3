"""Where the bodies of vehicles lie in an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import SIZE, vehicle_to_world
from wibam_core.geometry.boxes2d import clipped_to_image, sides_px
from wibam_core.geometry.camera import Camera

Array = NDArray[np.float64]

#: Nothing is said of a vehicle with a body point nearer than this along the optical axis, m.
NEAREST_M = 0.5


@dataclass(frozen=True, eq=False)
class Outlines:
    """Boxes around the bodies of M vehicles in an image.

    Attributes:
        whole: (M, 4) xyxy, px, as if the image had no border. shown: (M, 4) within the image.
        in_image: (M,) whether a part of it lies within the image, and all of the body before the camera.
        distance_m: (M,) along the optical axis; infinite for those that are not in the image.
    """

    whole: Array
    shown: Array
    in_image: NDArray[np.bool_]
    distance_m: Array


def outlines(camera: Camera, vehicles: Array, bodies: Array) -> Outlines:
    """Of vehicles in the world.

    Args:
        camera: of the image.
        vehicles: (M, 7).
        bodies: (M, P, 3) points of each body in lengths, widths and heights.
    """
    pixels, depths = camera.project(vehicle_to_world(vehicles, bodies * vehicles[:, None, SIZE]))
    ahead = depths.min(axis=1, initial=np.inf) > NEAREST_M
    pixels = np.where(ahead[:, None, None], pixels, 0.0)
    whole = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
    shown = clipped_to_image(whole, camera.width_px, camera.height_px)
    in_image = ahead & (sides_px(shown).min(axis=1, initial=np.inf) > 0)
    return Outlines(whole, shown, in_image, np.where(in_image, depths.mean(axis=1), np.inf))
