"""What a user may have meant where points do not fit: the same numbers, read in other ways.

Each way is solved as it stands. One that fits several times better, with a camera that could look at a road so, is what
the numbers most likely mean; the user is told, and nothing is reinterpreted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.calibration.covariance import CameraCovariance, camera_covariance
from wibam_core.calibration.homography import solve_ground_camera
from wibam_core.calibration.matrices import build_camera, size_of_intrinsics
from wibam_core.calibration.pnp import solve_pose, solve_wide_pose
from wibam_core.calibration.unknown_lens import LEAST_CLICK_PX, solve_unknown_lens
from wibam_core.calibration.view import is_plausible
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.site import Lens

Array = NDArray[np.float64]

#: Another reading is the right one where it fits this many times better than the given one; clicks are never better
#: than `_CLICK_PX`, and a wrong one counts as `_GROSS_PX` at most.
_GAIN = 4.0
_CLICK_PX = 0.5
_GROSS_PX = 50.0
#: Ratios of picture sizes that people use side by side, and widths of pixels that are not square.
_SIZE_RATIOS = (1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0)
_PIXEL_WIDTHS = (0.75, 4 / 3, 45 / 64, 64 / 45)


@dataclass(frozen=True, eq=False)
class Sighting:
    """Points, and where a camera saw them.

    Attributes:
        world: (N, 3) m.
        pixels: (N, 2).
        width_px, height_px: image size.
        K: (3, 3), or None where the focal length is to be solved from points on the ground.
        dist: (n,) in OpenCV order.
        lens_model, xi: see `Camera`.
        solves_lens: without K, points may lie above the ground, and k1 is solved with the focal length.
    """

    world: Array
    pixels: Array
    width_px: int
    height_px: int
    K: Array | None
    dist: Array
    lens_model: Lens = "pinhole"
    xi: float = 0.0
    solves_lens: bool = False

    def lens(self, K: Array) -> Camera:
        """A camera with these intrinsics, at the world's origin.

        Raises:
            CalibrationError: they make none.
        """
        size_px = self.width_px, self.height_px
        return build_camera(K, self.dist, SE3.identity(), *size_px, self.lens_model, self.xi)

    def solve(self, *, search: bool = True) -> tuple[Camera, NDArray[np.bool_]]:
        """The camera, and which points (N,) it rests on.

        Args:
            search: for wrong points where the lens is solved, too, which takes a second.

        Raises:
            CalibrationError: they fix none.
        """
        if self.K is None and self.solves_lens:
            whole = solve_unknown_lens(self.world, self.pixels, self.width_px, self.height_px, search=search)
            return whole.camera, whole.used
        if self.K is None:
            fit = solve_ground_camera(self.world[:, :2], self.pixels, self.width_px, self.height_px)
            return fit.camera, fit.used
        lens = self.lens(self.K)
        if lens.is_wide:
            pose = solve_wide_pose(self.world, self.pixels, lens)
        else:
            pose = solve_pose(self.world, self.pixels, lens.K, lens.dist)
        return replace(lens, T_world_cam=pose.T_world_cam), pose.used

    def covariance(self, camera: Camera, used: NDArray[np.bool_]) -> CameraCovariance | None:
        """Of the camera that was solved from the points (N,) in use; None where they are too few to tell."""
        return camera_covariance(
            camera,
            self.world[used],
            self.pixels[used],
            solved_focal=self.K is None,
            solved_k1=self.solves_lens,
            least_click_px=LEAST_CLICK_PX if self.solves_lens else 0.0,
        )

    def misfit_px(self, camera: Camera) -> float:
        """Mean reprojection error over all points, also those left out, each counted as `_GROSS_PX` at most."""
        projected, _ = camera.project(self.world)
        errors_px = np.nan_to_num(np.linalg.norm(projected - self.pixels, axis=1), nan=_GROSS_PX)
        return float(np.minimum(errors_px, _GROSS_PX).mean())


@dataclass(frozen=True)
class Reading:
    """What the numbers most likely mean, and what to do."""

    meaning: str
    hint: str


def better_reading(given: Sighting, misfit_px: float = _GROSS_PX) -> Reading | None:
    """The reading of a sighting that fits several times better than as it was given, if there is one.

    Args:
        given: as the user gave it.
        misfit_px: how badly it fits so.
    """
    best, best_px = None, max(misfit_px / _GAIN, _CLICK_PX)
    for reading, sighting in _readings(given):
        try:
            camera, _ = sighting.solve(search=False)
        except CalibrationError:
            continue
        found_px = sighting.misfit_px(camera)
        if found_px < best_px and is_plausible(camera):
            best, best_px = reading, found_px
    return best


MIRRORED = Reading(
    "the world axes look mirrored: the points fit a left-handed system",
    "World axes must be right-handed with Z up: swap X and Y, or flip the sign of one of them. A picture that is "
    "mirrored looks the same.",
)


def _readings(given: Sighting) -> Iterator[tuple[Reading, Sighting]]:
    yield MIRRORED, replace(given, world=given.world * [-1.0, 1.0, 1.0])
    if given.world[:, 2].any():
        down = Reading("the world's Z axis points down", "Z is up: flip the sign of z, and of y or of x.")
        yield down, replace(given, world=given.world * [1.0, -1.0, -1.0])
        heights = Reading("heights count downwards", "Z is up: flip the sign of every z.")
        yield heights, replace(given, world=given.world * [1.0, 1.0, -1.0])
    u, v = given.pixels.T
    yield (
        Reading("pixels look counted from the bottom", "Pixel (0, 0) is the top left one, and v counts downwards."),
        replace(given, pixels=np.stack([u, given.height_px - 1 - v], axis=1)),
    )
    yield (
        Reading("u and v of the pixels look swapped", "A pixel is u (to the right), v (down), not row, column."),
        replace(given, pixels=np.stack([v, u], axis=1)),
    )
    if given.K is not None:
        yield from _of_intrinsics(given, given.K)


def _of_intrinsics(given: Sighting, K: Array) -> Iterator[tuple[Reading, Sighting]]:
    size = f"{given.width_px}x{given.height_px} px"
    of_K = size_of_intrinsics(K, given.width_px, given.height_px)
    for ratio in _SIZE_RATIOS:
        shown = "" if of_K is None else f"; by its principal point, K is that of about {of_K[0]}x{of_K[1]} px"
        yield (
            Reading(
                f"K fits a picture {ratio:.3g} times the size of the one that the pixels are of",
                f"Both must be those of the recording, {size}: scale K, or pixels clicked in a resized picture{shown}.",
            ),
            replace(given, pixels=(given.pixels + 0.5) * ratio - 0.5),
        )
    for width in _PIXEL_WIDTHS:
        yield (
            Reading(
                f"the pixels fit a picture {width:.3g} times as wide: it was squeezed or stretched, and K was not",
                f"K must be that of the recording as it is, {size}: scale fx and cx.",
            ),
            replace(given, pixels=np.stack([(given.pixels[:, 0] + 0.5) * width - 0.5, given.pixels[:, 1]], axis=1)),
        )
    if given.dist.any() or given.lens_model != "pinhole":
        yield (
            Reading(
                "the points fit a lens without distortion",
                "Leave dist out, and lens: the recording seems undistorted already.",
            ),
            replace(given, dist=np.zeros(0), lens_model="pinhole", xi=0.0),
        )
    if given.dist.size in (0, 4) and given.lens_model != "fisheye":
        yield (
            Reading(
                "K and dist look like those of cv2.fisheye, which is another lens model",
                'Say "lens": "fisheye" beside K and dist.',
            ),
            replace(given, lens_model="fisheye", xi=0.0),
        )
    if given.dist.size == 4 and given.dist.any() and given.lens_model == "fisheye":
        yield (
            Reading(
                "dist looks like OpenCV's coefficients for pinhole cameras, not like those of cv2.fisheye",
                "Leave lens out: dist is then read as k1, k2, p1, p2.",
            ),
            replace(given, lens_model="pinhole"),
        )
