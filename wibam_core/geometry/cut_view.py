"""Pinhole views that are cut from the picture of a wide lens.

Detectors and networks know pinhole pictures, in which straight things are straight and vehicles stand upright. A view
is such a picture, as a pinhole at the wide lens's own place would have taken it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Where a view shows what its lens does not see, its pixels are taken from this far beside the picture: they are black.
_NOWHERE_PX = -1e4


@dataclass(frozen=True, eq=False)
class CutView:
    """A pinhole view of a camera with a wide lens.

    Attributes:
        id: its name beside those of cameras.
        R_cam_view: (3, 3) rotation; ``x_cam = R_cam_view x_view``.
        K: (3, 3) intrinsic matrix, px.
        width_px, height_px: size of its picture.
    """

    id: str
    R_cam_view: Array
    K: Array
    width_px: int
    height_px: int

    def camera(self, mounted: Camera) -> Camera:
        """The pinhole that would take this view, at the place of the camera that it is cut from."""
        pose = SE3(mounted.T_world_cam.rotation @ self.R_cam_view, mounted.T_world_cam.translation)
        return Camera(self.K, np.zeros(0), pose, self.width_px, self.height_px)

    def cutter(self, mounted: Camera) -> Cutter:
        """How its picture is cut from one of the camera, of the camera's size."""
        u, v = np.meshgrid(np.arange(self.width_px), np.arange(self.height_px))
        pixels = np.stack([u, v, np.ones_like(u)], axis=-1).astype(np.float64)
        points_cam = pixels @ np.linalg.inv(self.K).T @ self.R_cam_view.T
        where = np.nan_to_num(mounted.project_camera_points(points_cam), nan=_NOWHERE_PX)
        return Cutter(where.astype(np.float32))


@dataclass(frozen=True, eq=False)
class Cutter:
    """Cuts pictures of one camera.

    Attributes:
        where: (H, W, 2) float32, px of the camera's picture: what each pixel of the view shows.
    """

    where: NDArray[np.float32]

    def cut(self, image: Image) -> Image:
        """The view (H, W, 3) of a picture; black where the picture ends."""
        view = cv2.remap(image, self.where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(view, dtype=np.uint8)
