"""Ready matrices, looked at before they are believed."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane
from wibam_core.geometry.se3 import SE3

Array = NDArray[np.float64]

_MAX_HEIGHT_M = 500.0
#: Ground farther from a camera than this is of no use.
GROUND_RANGE_M = 200.0
#: A pixel must come back to within this of itself once its distortion is undone and done again, as far out as this
#: share of the image's half diagonal. Published coefficients of wide lenses often fold back beyond it, in the very
#: corners, where no board was seen; there the lens is continued (`wibam_core.geometry.distortion`).
_ROUND_TRIP_PX = 0.5
_TRUSTED_RADIUS = 0.75


def camera_from_matrices(
    K: ArrayLike, dist: ArrayLike, rvec: ArrayLike, tvec: ArrayLike, width_px: int, height_px: int
) -> Camera:
    """A camera from OpenCV's matrices.

    Args:
        K: (3, 3).
        dist: (n,) in OpenCV order.
        rvec: (3,) Rodrigues vector, world to camera.
        tvec: (3,) m, world to camera.
        width_px: image width.
        height_px: image height.

    Raises:
        CalibrationError: if they make no camera, or none that looks at the ground from above.
    """
    camera = build_camera(K, dist, SE3.from_rvec_tvec(rvec, tvec).inverse(), width_px, height_px)
    check_view(camera)
    return camera


def build_camera(K: ArrayLike, dist: ArrayLike, T_world_cam: SE3, width_px: int, height_px: int) -> Camera:
    """A `Camera`, with the user's mistakes as `CalibrationError`.

    Raises:
        CalibrationError: if K or dist make no camera, the principal point lies far outside the image, the sensor is
            tilted against the lens, or the distortion cannot be undone in all of the image.
    """
    coefficients = np.asarray(dist, dtype=np.float64).reshape(-1)
    if coefficients.size == 14 and coefficients[12:].any():
        raise CalibrationError(
            "the lens model has a tilted sensor (distortion coefficients 13 and 14), which is not supported",
            hint="Calibrate again without cv2.CALIB_TILTED_MODEL, or undistort the recording first.",
        )
    try:
        camera = Camera(np.asarray(K), coefficients, T_world_cam, width_px, height_px)
    except ValueError as error:
        raise CalibrationError(f"the intrinsics make no camera: {error}", hint=_INTRINSICS_HINT) from error
    cx, cy = camera.K[0, 2] / width_px, camera.K[1, 2] / height_px
    if not (-0.5 <= cx <= 1.5 and -0.5 <= cy <= 1.5):
        raise CalibrationError(
            f"the principal point ({camera.K[0, 2]:.0f}, {camera.K[1, 2]:.0f}) lies far outside the image of "
            f"{width_px}x{height_px} px",
            hint=_INTRINSICS_HINT,
        )
    _check_lens(camera)
    return camera


_INTRINSICS_HINT = "K is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels of the recording's size."


def _check_lens(camera: Camera, steps: int = 41) -> None:
    """Refuse a lens whose distortion formula folds back well inside the image: several rays then share a pixel.

    Coefficients fitted to points near the middle of the image alone do that.

    Raises:
        CalibrationError: naming the pixel that is worst off.
    """
    if not camera.has_distortion:
        return
    u, v = np.meshgrid(
        np.linspace(-0.5, camera.width_px - 0.5, steps), np.linspace(-0.5, camera.height_px - 0.5, steps)
    )
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = np.concatenate([camera.undistort(pixels), np.ones((len(pixels), 1))], axis=1)
    # OpenCV's formula as it is, which `Camera.project` follows only as far as it can be undone
    back, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.array(camera.K), np.array(camera.dist))
    error_px = np.linalg.norm(back.reshape(-1, 2) - pixels, axis=1)
    bad = ~(error_px <= _ROUND_TRIP_PX)
    middle = np.array([camera.width_px - 1, camera.height_px - 1]) / 2
    share = np.linalg.norm(pixels - middle, axis=1) / np.hypot(camera.width_px / 2, camera.height_px / 2)
    if (bad & (share <= _TRUSTED_RADIUS)).any():
        worst = int(np.nan_to_num(error_px, nan=np.inf).argmax())
        raise CalibrationError(
            f"the distortion cannot be undone in {np.ceil(100 * bad.mean()):.0f}% of the image: pixel "
            f"({pixels[worst, 0]:.1f}, {pixels[worst, 1]:.1f}) comes back {error_px[worst]:.1f} px away",
            hint="Give coefficients that are valid over the whole image (calibrate with points out to its corners), "
            "undistort the recording first, or crop it to the part they are valid for.",
            pixel=pixels[worst].tolist(),
        )


def check_view(camera: Camera) -> None:
    """Refuse a camera that does not look at the ground from above.

    Raises:
        CalibrationError: below the ground, implausibly high, or with no ground in view.
    """
    height = float(camera.centre_m[2])
    if height <= 0:
        raise CalibrationError(
            f"the camera comes out {-height:.2f} m below the ground",
            hint="rvec and tvec are OpenCV's, world to camera; the world has Z up and the ground at Z = 0, in metres.",
        )
    if height > _MAX_HEIGHT_M:
        raise CalibrationError(
            f"the camera comes out {height:.0f} m above the ground",
            hint="Positions are in metres: are these millimetres or centimetres?",
        )
    if len(visible_ground(camera)) == 0:
        raise CalibrationError(
            f"no ground within {GROUND_RANGE_M:.0f} m is in the camera's view",
            hint="rvec and tvec are OpenCV's, world to camera (x right, y down, z forward); is one of them inverted?",
        )


def visible_ground(camera: Camera, steps: int = 32) -> Array:
    """(N, 3) ground points in view within `GROUND_RANGE_M`, at a regular grid of pixels; N may be 0."""
    u, v = np.meshgrid(np.linspace(0, camera.width_px - 1, steps), np.linspace(0, camera.height_px - 1, steps))
    points = intersect_plane(camera, np.stack([u.ravel(), v.ravel()], axis=1))
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(points - camera.centre_m, axis=1) <= GROUND_RANGE_M
    return np.asarray(points[near])
