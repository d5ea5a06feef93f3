"""A guessed camera for recordings without a calibration: directions and order are right, metres are nominal."""

from __future__ import annotations

import numpy as np

from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3

#: A common lens: 58° wide. A pole or a bridge. The horizon of a camera that looks down a little.
NOMINAL_FOCAL_WIDTHS = 0.9
NOMINAL_HEIGHT_M = 6.0
NOMINAL_HORIZON_SHARE = 0.3


def nominal_camera(width_px: int, height_px: int, *, horizon_px: float | None = None) -> Camera:
    """A level camera 6 m above the origin that looks along world +Y, with a focal length of 0.9 image widths.

    Nothing of it is measured, so that places, sizes and speeds that it gives are in nominal metres: right up to an
    unknown factor near the middle of the image at best. Never compare them with thresholds in metres or seconds.

    Args:
        width_px: of the image.
        height_px: of the image.
        horizon_px: row of the horizon, which fixes the pitch; above the image's middle the camera looks down.
            Default: 30 % from the top.
    """
    focal = NOMINAL_FOCAL_WIDTHS * width_px
    middle = (height_px - 1) / 2
    horizon = NOMINAL_HORIZON_SHARE * height_px if horizon_px is None else horizon_px
    pitch = np.arctan((middle - horizon) / focal)
    K = np.array([[focal, 0.0, (width_px - 1) / 2], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    c, s = np.cos(pitch), np.sin(pitch)
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, -s, c], [0.0, -c, -s]])
    return Camera(K, np.zeros(0), SE3(rotation, np.array([0.0, 0.0, NOMINAL_HEIGHT_M])), width_px, height_px)
