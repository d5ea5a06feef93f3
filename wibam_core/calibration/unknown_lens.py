"""A camera of which nothing is known, from surveyed points on the road and above it: lens and pose together.

Unknown are the pose, the focal length (square pixels), the first coefficient of the distortion (k1), and the principal
point, which may leave the middle of the picture against resistance. The pose begins with SQPnP
(`wibam_core.calibration.pnp`) at each of some focal lengths; the whole ends on the reprojection error
(Levenberg-Marquardt, as in Hartley & Zisserman, Multiple View Geometry, 2nd ed., section 7.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wibam_core.calibration.homography import PRINCIPAL_POINT_COST_PX, PRINCIPAL_POINT_SD
from wibam_core.calibration.matrices import build_camera
from wibam_core.calibration.pnp import moved, near_origin, sqpnp
from wibam_core.calibration.points import check_points
from wibam_core.calibration.robust import find_inliers
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3

Array = NDArray[np.float64]

#: A point gives two numbers; pose, focal length and k1 are eight.
MIN_POINTS = 6
#: Standard deviation of k1 before points are looked at, and what one of these counts as, px.
K1_SD, K1_COST_PX = 0.25, 0.5
#: No click is better than this, px: so much at least has to leave the focal length known.
LEAST_CLICK_PX = 0.5
#: The focal length is told by the points where its standard deviation is below this share of it.
_KNOWN_FOCAL = 0.15
#: Focal lengths to begin with, as shares of the picture's width.
_STARTS = (0.4, 0.6, 0.85, 1.2, 1.7, 2.5, 4.0, 8.0)
#: Subsets that are tried where some points are wrong: each is solved by itself, which takes longer than for a pose.
_TRIALS = 60
#: Points beyond this error, and this many times the typical one, stay left out once the lens is known.
_SMALLEST_PX, _SPREAD = 3.0, 4.0
#: What a point behind the camera counts as, px.
_BEHIND_PX = 1e4


@dataclass(frozen=True, eq=False)
class LensFit:
    """A solved camera, and which of the points (N,) it rests on."""

    camera: Camera
    used: NDArray[np.bool_]


def solve_unknown_lens(world: Array, pixels: Array, width_px: int, height_px: int, *, search: bool = True) -> LensFit:
    """Camera from points, wherever the world's origin is.

    Args:
        world: (N, 3) surveyed points, m.
        pixels: (N, 2) where the camera sees them.
        width_px: image width.
        height_px: image height.
        search: for wrong points, by subsets of them.

    Raises:
        CalibrationError: too few points, or none of the cameras tried has them all in front of it.
    """
    check_points(world, pixels)
    if len(world) < MIN_POINTS:
        raise CalibrationError(
            f"{len(world)} points are too few to tell the lens as well; at least {MIN_POINTS} are needed",
            hint="Give more points, or K and calibration kind 'pnp'; kind 'homography' takes 4 points on the road.",
        )
    origin = near_origin(world)
    local = np.ascontiguousarray(world - origin)
    solver = _Solver(local, pixels, width_px, height_px)
    used = find_inliers(len(world), MIN_POINTS, solver.candidates, solver.errors_px, trials=_TRIALS if search else 0)
    best: _Guess | None = None
    for _ in range(3):
        options = solver.candidates(np.flatnonzero(used))
        if not options:
            break
        best = min(options, key=lambda guess: solver.rms_px(guess, used))
        errors = solver.errors_px(best)
        again = errors <= max(_SMALLEST_PX, _SPREAD * solver.rms_px(best, used))
        if (again == used).all() or again.sum() < MIN_POINTS:
            break
        used = again
    if best is None:
        raise CalibrationError(
            "no camera has all points in front of it",
            hint="Check that each pixel belongs to its world point, and that pixels are those of the recording's size.",
        )
    pose = moved(best.pose.inverse(), origin)
    K = np.array([[best.focal_px, 0, best.middle[0]], [0, best.focal_px, best.middle[1]], [0, 0, 1.0]])
    try:
        camera = build_camera(K, np.array([best.k1, 0.0, 0.0, 0.0]), pose, width_px, height_px)
    except CalibrationError as error:
        raise CalibrationError(
            f"the points ask for a lens that one coefficient does not describe (focal length {best.focal_px:.0f} px, "
            f"k1 {best.k1:.2f}): {error.message}",
            hint="Look for wrong clicks. A wide lens has to be calibrated, e.g. with cv2.fisheye and a chessboard: "
            "give K and dist, and calibration kind 'pnp'.",
        ) from error
    return LensFit(camera, used)


def check_told(focal_px: float, focal_sd_px: float | None) -> None:
    """Refuse a focal length that the points leave open.

    Args:
        focal_px: as solved.
        focal_sd_px: its standard deviation; None where there are too few points to say.

    Raises:
        CalibrationError: it is too uncertain.
    """
    if focal_sd_px is None or focal_sd_px <= _KNOWN_FOCAL * focal_px:
        return
    raise CalibrationError(
        f"the points do not tell the focal length: it is {focal_px:.0f} ± {focal_sd_px:.0f} px by them",
        hint="Spread them over more depth, and give raised ones: corners of roofs, tops of posts. Or give K and use "
        "calibration kind 'pnp'.",
        focal_px=focal_px,
        focal_sd_px=focal_sd_px,
    )


@dataclass(frozen=True, eq=False)
class _Guess:
    """``pose`` is T_cam_world; ``middle`` (2,) the principal point, px."""

    pose: SE3
    focal_px: float
    k1: float
    middle: Array


@dataclass(frozen=True, eq=False)
class _Solver:
    world: Array
    pixels: Array
    width_px: int
    height_px: int

    @property
    def _centre(self) -> Array:
        return np.array([self.width_px - 1, self.height_px - 1]) / 2

    def errors_px(self, guess: _Guess) -> Array:
        """(N,) reprojection errors; infinite behind the camera."""
        ahead = guess.pose.apply(self.world)[:, 2] > 0
        return np.where(ahead, np.linalg.norm(_projected(guess, self.world)[0] - self.pixels, axis=1), np.inf)

    def rms_px(self, guess: _Guess, used: NDArray[np.bool_]) -> float:
        return float(np.sqrt((self.errors_px(guess)[used] ** 2).mean()))

    def candidates(self, index: NDArray[np.int64]) -> list[_Guess]:
        """Cameras through the points of some indices: the best over focal lengths to begin with, refined."""
        world, pixels = self.world[index], self.pixels[index]
        chosen = np.zeros(len(self.world), dtype=bool)
        chosen[index] = True
        starts = []
        for share in _STARTS:
            focal = share * self.width_px
            K = np.array([[focal, 0, self._centre[0]], [0, focal, self._centre[1]], [0, 0, 1.0]])
            for pose in sqpnp(world, pixels, K, np.zeros(0)):
                guess = _Guess(pose, focal, 0.0, self._centre)
                rms = self.rms_px(guess, chosen)
                if np.isfinite(rms):
                    below = bool(pose.inverse().translation[2] <= 0)  # as good a fit, where all points are on the road
                    starts.append((below, rms, guess))
        starts.sort(key=lambda start: start[:2])
        polished = [self._polished(guess, index) for _, _, guess in starts[:1]]
        return [guess for guess in polished if np.isfinite(self.errors_px(guess)[index]).all()]

    def _polished(self, start: _Guess, index: NDArray[np.int64]) -> _Guess:
        world, pixels = np.ascontiguousarray(self.world[index]), self.pixels[index]
        scale = np.array([1.0, 1.0, 1.0, *[self._reach] * 3, 1.0, 1.0, *[PRINCIPAL_POINT_SD * self.width_px] * 2])
        begin = np.concatenate([*start.pose.to_rvec_tvec(), [np.log(start.focal_px), start.k1], start.middle])
        beside = np.concatenate([np.zeros((1, 7)), [[K1_COST_PX / K1_SD]], np.zeros((1, 2))], axis=1)
        aside = np.eye(10)[8:] * PRINCIPAL_POINT_COST_PX

        def residuals(x: Array) -> Array:
            guess = _guess(begin + scale * x)
            ahead = guess.pose.apply(world)[:, 2:] > 0
            off = np.where(ahead, _projected(guess, world)[0] - pixels, _BEHIND_PX)
            k1_off = K1_COST_PX * guess.k1 / K1_SD
            return np.concatenate([off.ravel(), [k1_off], PRINCIPAL_POINT_COST_PX * (guess.middle - self._centre) / sd])

        def slopes(x: Array) -> Array:
            return np.concatenate([_projected(_guess(begin + scale * x), world)[1] * scale, beside, aside])

        sd = PRINCIPAL_POINT_SD * self.width_px
        found = least_squares(residuals, np.zeros(10), slopes, method="lm", x_scale="jac", max_nfev=60)
        return _guess(begin + scale * found.x)

    @property
    def _reach(self) -> float:
        """A length of the scene, m, so that all unknowns are of one size."""
        return max(float(np.linalg.norm(self.world - self.world.mean(axis=0), axis=1).mean()), 1.0)


def _guess(x: Array) -> _Guess:
    """Of unknowns (10,): rvec, tvec, log focal length, k1, principal point."""
    return _Guess(SE3.from_rvec_tvec(x[:3], x[3:6]), float(np.exp(np.clip(x[6], 0.0, 20.0))), float(x[7]), x[8:10])


def _projected(guess: _Guess, world: Array) -> tuple[Array, Array]:
    """Pixels (N, 2) of points (N, 3), and their derivatives (2N, 10) by the unknowns of `_guess`."""
    K = np.array([[guess.focal_px, 0, guess.middle[0]], [0, guess.focal_px, guess.middle[1]], [0, 0, 1.0]])
    rvec, tvec = guess.pose.to_rvec_tvec()
    pixels, slopes = cv2.projectPoints(world, rvec, tvec, K, np.array([guess.k1, 0.0, 0.0, 0.0]))
    by_log_focal = guess.focal_px * (slopes[:, 6:7] + slopes[:, 7:8])
    by_unknowns = np.concatenate([slopes[:, :6], by_log_focal, slopes[:, 10:11], slopes[:, 8:10]], axis=1)
    return pixels.reshape(-1, 2), np.asarray(by_unknowns)
