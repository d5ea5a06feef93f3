"""Ready matrices, looked at before they are believed."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wibam_core.calibration.poses import meant_by, rotation_meant_by
from wibam_core.calibration.view import check_view, is_plausible
from wibam_core.documents.warnings import Caution
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.site import Lens

Array = NDArray[np.float64]

#: A rotation vector is at most half a turn long; some write up to a whole one.
_LONGEST_ROTATION_RAD = 2 * np.pi
#: Focal lengths beyond these multiples of the image's longer side are no traffic camera's.
_FOCAL_RANGE = (0.2, 30.0)
#: The same of wide lenses: a fisheye whose circle fills a third of the picture, and one that is cut from its middle.
_WIDE_FOCAL_RANGE = (0.05, 30.0)
#: How far off the middle of the image principal points are, at most, as shares of its width and height.
_OFF_CENTRE = 0.1
#: Sizes of pictures are multiples of this.
_SIZE_STEP_PX = 4
#: How far width and height of pixels may differ before it is worth a word.
_SQUARE = 1.25
#: Tangential coefficients (p1, p2) of lenses are smaller; of pinholes that show more than 90 degrees they are smaller
#: than the second, and lines bend, unless the first coefficient is about zero.
_TANGENTIAL, _FISHEYE_TANGENTIAL, _LEAST_BARREL = 0.01, 0.0015, -0.05
#: A pixel must come back to within this of itself once its distortion is undone and done again, as far out as this
#: share of the image's half diagonal. Published coefficients of wide lenses often fold back beyond it, in the very
#: corners, where no board was seen; there the lens is continued (`wibam_core.geometry.distortion`).
_ROUND_TRIP_PX = 0.5
_TRUSTED_RADIUS = 0.75


def camera_from_matrices(
    K: ArrayLike,
    dist: ArrayLike,
    rvec: ArrayLike,
    tvec: ArrayLike,
    width_px: int,
    height_px: int,
    lens: Lens = "pinhole",
    xi: float = 0.0,
) -> Camera:
    """A camera from OpenCV's matrices.

    Args:
        K: (3, 3).
        dist: (n,) in OpenCV order for the lens.
        rvec: (3,) Rodrigues vector, world to camera.
        tvec: (3,) m, world to camera.
        width_px: image width.
        height_px: image height.
        lens: see `Camera`.
        xi: see `Camera`.

    Raises:
        CalibrationError: if they make no camera, or none that looks at the ground from above.
    """
    length_rad = float(np.linalg.norm(np.asarray(rvec, dtype=np.float64)))
    if length_rad > _LONGEST_ROTATION_RAD:
        raise CalibrationError(
            f"rvec is {length_rad:.1f} long, but a rotation vector in radians is at most half a turn, 3.14",
            hint="rvec is OpenCV's Rodrigues vector in radians: are these degrees, or angles about single axes?",
        )
    T_cam_world = SE3.from_rvec_tvec(rvec, tvec)
    camera = build_camera(K, dist, T_cam_world.inverse(), width_px, height_px, lens, xi)
    if is_plausible(camera):
        return camera
    meant = [sentence for sentence, _ in meant_by({"": camera})]
    hint = " Or: ".join(filter(None, [*meant, rotation_meant_by(camera, rvec, tvec)])) or None
    try:
        check_view(camera)
    except CalibrationError as error:
        raise CalibrationError(error.message, hint=hint or error.hint) from error
    if hint is not None:
        raise CalibrationError("rvec and tvec make a camera that is not upright", hint=hint)
    return camera


def build_camera(
    K: ArrayLike,
    dist: ArrayLike,
    T_world_cam: SE3,
    width_px: int,
    height_px: int,
    lens: Lens = "pinhole",
    xi: float = 0.0,
) -> Camera:
    """A `Camera`, with the user's mistakes as `CalibrationError`.

    Raises:
        CalibrationError: if K or dist make no camera, the principal point lies far outside the image, the sensor is
            tilted against the lens, or the distortion cannot be undone in all of the image.
    """
    coefficients = np.asarray(dist, dtype=np.float64).reshape(-1)
    if lens == "pinhole" and coefficients.size == 14 and coefficients[12:].any():
        raise CalibrationError(
            "the lens model has a tilted sensor (distortion coefficients 13 and 14), which is not supported",
            hint="Calibrate again without cv2.CALIB_TILTED_MODEL, or undistort the recording first.",
        )
    _check_layout(
        np.asarray(K, dtype=np.float64),
        width_px,
        height_px,
        _FOCAL_RANGE if lens == "pinhole" else _WIDE_FOCAL_RANGE,
    )
    try:
        camera = Camera(np.asarray(K), coefficients, T_world_cam, width_px, height_px, lens, xi)
    except ValueError as error:
        raise CalibrationError(f"the intrinsics make no camera: {error}", hint=_INTRINSICS_HINT) from error
    cx, cy = camera.K[0, 2] / width_px, camera.K[1, 2] / height_px
    if not (-0.5 <= cx <= 1.5 and -0.5 <= cy <= 1.5):
        raise CalibrationError(
            f"the principal point ({camera.K[0, 2]:.0f}, {camera.K[1, 2]:.0f}) lies far outside the image of "
            f"{width_px}x{height_px} px",
            hint=f"{_INTRINSICS_HINT} By its principal point, K is that of about {2 * camera.K[0, 2]:.0f}x"
            f"{2 * camera.K[1, 2]:.0f} px, such as a sensor's full size, of which a video may show a part.",
        )
    if camera.is_wide:
        _check_wide_lens(camera)
    else:
        _check_lens(camera)
    return camera


def _check_layout(K: Array, width_px: int, height_px: int, focal_range: tuple[float, float]) -> None:
    """Raises:
    CalibrationError: K is transposed, or its focal lengths are in another unit than pixels.
    """
    if K.shape == (3, 3) and K[2, :2].any() and not K[:2, 2].any():
        raise CalibrationError(
            "K is transposed", hint=f"Its rows and columns are swapped, as MATLAB has them. {_INTRINSICS_HINT}"
        )
    longer = max(width_px, height_px)
    focal = np.diagonal(K)[:2]
    if ((focal > 0) & (focal < focal_range[0] * longer)).any() or (focal > focal_range[1] * longer).any():
        raise CalibrationError(
            f"the focal lengths in K, {focal[0]:g} and {focal[1]:g}, are no traffic camera's at {width_px}x{height_px} "
            "px",
            hint="They are in pixels of the recording: multiply millimetres by the image's width in pixels over the "
            f"sensor's in millimetres, and shares of the width by {width_px}.",
        )


def size_of_intrinsics(K: Array, width_px: int, height_px: int) -> tuple[int, int] | None:
    """About the size of the picture that K looks made for, by its principal point; None where that is the given one."""
    ratios = np.array([(K[0, 2] + 0.5) / (width_px / 2), (K[1, 2] + 0.5) / (height_px / 2)])
    ratio = float(ratios.mean())
    if np.abs(ratios - 1).max() <= 2 * _OFF_CENTRE or np.abs(ratios / ratio - 1).max() > _OFF_CENTRE:
        return None
    width, height = (_SIZE_STEP_PX * round(size * ratio / _SIZE_STEP_PX) for size in (width_px, height_px))
    return width, height


def intrinsics_cautions(camera: Camera, *, solved: bool = False) -> list[Caution]:
    """What is unusual about a camera's intrinsics, whether they were given or ``solved`` from points on the ground."""
    K, width_px, height_px = camera.K, camera.width_px, camera.height_px
    found = []
    off = np.array([(K[0, 2] + 0.5) / width_px - 0.5, (K[1, 2] + 0.5) / height_px - 0.5])
    if np.abs(off).max() > _OFF_CENTRE:
        size = size_of_intrinsics(K, width_px, height_px)
        guess = "" if size is None else f" It would be in the middle of about {size[0]}x{size[1]} px."
        if np.abs([(K[1, 2] + 0.5) / width_px - 0.5, (K[0, 2] + 0.5) / height_px - 0.5]).max() <= _OFF_CENTRE:
            guess = " cx and cy look swapped."
        elif not K[:2, 2].any():
            guess = f" In the middle it would be ({(width_px - 1) / 2:g}, {(height_px - 1) / 2:g}), not (0, 0)."
        hint = f"Is K that of another resolution or crop? It must be that of the recording.{guess}"
        if solved:
            hint = (
                "Either the points lie off one plane, or the lens bends the picture, or the pixels are those of a "
                "picture of another size. Take points on the level part of the road, or give K and use calibration "
                "kind 'pnp'."
            )
        found.append(
            Caution(
                code="principal_point",
                message=f"the principal point ({K[0, 2]:.0f}, {K[1, 2]:.0f}) lies far from the middle of "
                f"{width_px}x{height_px} px",
                hint=hint,
                details={"principal_point_px": [float(K[0, 2]), float(K[1, 2])]},
            )
        )
    found += distortion_cautions(camera)
    ratio = float(K[0, 0] / K[1, 1])
    if not solved and not 1 / _SQUARE <= ratio <= _SQUARE:
        found.append(
            Caution(
                code="focal_ratio",
                message=f"the focal lengths in K, {K[0, 0]:.0f} and {K[1, 1]:.0f} px, differ as if pixels were not "
                "square",
                hint="Does the recording show circles as circles? If so, K is that of another picture.",
                details={"focal_px": [float(K[0, 0]), float(K[1, 1])]},
            )
        )
    return found


def distortion_cautions(camera: Camera) -> list[Caution]:
    """Coefficients that no pinhole has whose order and lens model are as stated."""
    if camera.lens != "pinhole" or camera.dist.size < 4:
        return []
    tangential = float(np.abs(camera.dist[2:4]).max())
    details = {"dist": camera.dist.tolist()}
    half = np.hypot(camera.width_px, camera.height_px) / 2 / min(camera.K[0, 0], camera.K[1, 1])
    if tangential > _FISHEYE_TANGENTIAL and not camera.dist[4:].any() and half > 1 and camera.dist[0] > _LEAST_BARREL:
        return [
            Caution(
                code="lens_model",
                message=f"the lens sees {2 * np.degrees(np.arctan(half)):.0f}° from corner to corner and hardly bends "
                "straight lines by dist, whose last two coefficients are large: they look like those of cv2.fisheye",
                hint='Say "lens": "fisheye" beside K and dist if cv2.fisheye made them. If they are k1, k2, p1, p2 of '
                "cv2.calibrateCamera, all is well.",
                details=details,
            )
        ]
    if tangential > _TANGENTIAL:
        return [
            Caution(
                code="distortion_order",
                message=f"the tangential coefficients in dist, {camera.dist[2]:g} and {camera.dist[3]:g}, are larger "
                "than those of lenses",
                hint="The order is k1, k2, p1, p2, k3: radial ones alone are k1, k2, 0, 0, k3.",
                details=details,
            )
        ]
    return []


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
    back = back.reshape(-1, 2)
    back[:, 0] += camera.K[0, 1] / camera.K[1, 1] * (back[:, 1] - camera.K[1, 2])  # OpenCV's formula has no skew
    error_px = np.linalg.norm(back - pixels, axis=1)
    bad = ~(error_px <= _ROUND_TRIP_PX)
    middle = np.array([camera.width_px - 1, camera.height_px - 1]) / 2
    share = np.linalg.norm(pixels - middle, axis=1) / np.hypot(camera.width_px / 2, camera.height_px / 2)
    if (bad & (share <= _TRUSTED_RADIUS)).any():
        worst = int(np.nan_to_num(error_px, nan=np.inf).argmax())
        other = ' If these are coefficients of cv2.fisheye, say "lens": "fisheye".' if camera.dist.size == 4 else ""
        raise CalibrationError(
            f"the distortion cannot be undone in {np.ceil(100 * bad.mean()):.0f}% of the image: pixel "
            f"({pixels[worst, 0]:.1f}, {pixels[worst, 1]:.1f}) comes back {error_px[worst]:.1f} px away",
            hint="Give coefficients that are valid over the whole image (calibrate with points out to its corners), "
            f"undistort the recording first, or crop it to the part they are valid for.{other}",
            pixel=pixels[worst].tolist(),
        )


def _check_wide_lens(camera: Camera, steps: int = 41) -> None:
    """Refuse a wide lens that folds back within the circle that touches the image's nearer borders.

    The picture of a fisheye often ends before the image's corners do.

    Raises:
        CalibrationError: naming the angle at which it does.
    """
    half = min(camera.width_px, camera.height_px) / 2
    angles = np.linspace(0, 2 * np.pi, steps)
    middle = np.array([camera.width_px - 1, camera.height_px - 1]) / 2
    circle = middle + _TRUSTED_RADIUS * half * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    shown = np.isfinite(camera.rays(circle)).all(axis=1)
    if not shown.all():
        u, v = circle[~shown][0]
        raise CalibrationError(
            f"the lens model ends {np.degrees(camera.wide_lens.limit_rad):.0f}° from its axis, and shows nothing at "
            f"{int((~shown).sum())} of {steps} places around the middle of the image, e.g. ({u:.0f}, {v:.0f})",
            hint="Are K, dist and xi those of this lens model, and K that of the recording's size? dist of a fisheye "
            "is k1, k2, k3, k4, of an omnidirectional lens k1, k2, p1, p2.",
            pixel=[float(u), float(v)],
        )
