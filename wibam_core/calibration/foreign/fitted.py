"""Wide lenses of other models, as the fisheye that is nearest to them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wibam_core.calibration.foreign.base import Array, Intrinsics
from wibam_core.errors import InputError

#: A lens is taken for another model's where no pixel is off by more than this.
_NEAR_PX = 0.25
_ANGLES = 400


def as_fisheye(
    radius: Callable[[Array], Array],
    widest_rad: float,
    focal_px: tuple[float, float],
    middle_px: tuple[float, float],
    size_px: tuple[int, int],
    model: str,
) -> tuple[Intrinsics, float]:
    """The equidistant fisheye (`cv2.fisheye`) that a lens looks like within its picture.

    Args:
        radius: how far from the middle of the lens plane directions (N,) are seen, by their angles to the axis, rad; it
            grows with them.
        widest_rad: up to this angle.
        focal_px: in x and y.
        middle_px: the principal point.
        size_px: width and height of the picture.
        model: what the lens is called.

    Returns:
        the lens, and by how many pixels it is off at most.

    Raises:
        InputError: no fisheye comes near to it.
    """
    corners = np.array([[x, y] for x in (-0.5, size_px[0] - 0.5) for y in (-0.5, size_px[1] - 0.5)])
    farthest = float(np.linalg.norm((corners - middle_px) / focal_px, axis=1).max())
    angles = np.linspace(0.0, widest_rad, _ANGLES + 1)[1:]
    seen = radius(angles)
    angles, seen = angles[seen <= farthest], seen[seen <= farthest]
    terms = angles[:, None] ** np.array([1, 3, 5, 7, 9])
    scale = np.abs(terms).max(axis=0)
    found = np.linalg.lstsq(terms / scale, seen, rcond=None)[0] / scale
    off_px = float(np.abs(terms @ found - seen).max()) * max(focal_px)
    if not (off_px <= _NEAR_PX and found[0] > 0):
        raise InputError(
            f"a lens of the model {model} is not read where it differs from cv2.fisheye by more than {_NEAR_PX} px, "
            f"here {off_px:.2g} px",
            hint="Calibrate with pinhole-equi or omni-radtan.",
        )
    fx, fy = found[0] * np.array(focal_px)
    K = np.array([[fx, 0, middle_px[0]], [0, fy, middle_px[1]], [0, 0, 1.0]])
    return Intrinsics(K, found[1:] / found[0], "fisheye", size_px=size_px), off_px
