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
from wibam_core.calibration.homography import GroundFit, solve_ground_camera
from wibam_core.calibration.matrices import build_camera, size_of_intrinsics
from wibam_core.calibration.pnp import solve_pose, solve_wide_pose
from wibam_core.calibration.points import ROAD_M
from wibam_core.calibration.unknown_lens import LEAST_CLICK_PX, LensFit, solve_unknown_lens
from wibam_core.calibration.view import is_plausible
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.pixels import resized_intrinsics, resized_px, scale_of
from wibam_core.geometry.se3 import SE3
from wibam_core.site import Lens

Array = NDArray[np.float64]

#: Another reading is the right one where it fits this many times better than the given one; clicks are never better
#: than `_CLICK_PX`, and a wrong one counts as `_GROSS_PX` at most.
_GAIN = 4.0
_CLICK_PX = 0.5
_GROSS_PX = 50.0
#: What fits worse is no reading, however badly the points fit as they were given.
_FITTING_PX = 3.0
#: Ratios of picture sizes that people use side by side, and widths of pixels that are not square.
_SIZE_RATIOS = (1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0)
_PIXEL_WIDTHS = (0.75, 4 / 3, 45 / 64, 64 / 45)
#: Widths of pixels over their heights, with which cameras store pictures, and 1 where another one was said in vain.
_PIXEL_ASPECTS = (1.0, 0.75, 4 / 3, 9 / 16, 16 / 9, 15 / 16, 16 / 15, 45 / 64, 64 / 45)
#: Units that heights are given in beside metres on the ground.
_HEIGHTS_M = (("feet", 0.3048), ("centimetres", 0.01), ("millimetres", 0.001))
#: Focal lengths closer than this to that of K are not called another one.
_OTHER_FOCAL = 0.03
#: From worlds whose Y points up, and whose Y points down, to one whose Z points up.
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_Y_DOWN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
#: Web Mercator (EPSG:3857) is a sphere of this radius, m, and as wide and high as its circumference.
_SPHERE_M = 6_378_137.0


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
        pixel_aspect: without K, the width of a pixel over its height.
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
    pixel_aspect: float = 1.0

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
        if self.K is None:
            return self._solved_with_lens(search=search)
        lens = self.lens(self.K)
        if lens.is_wide:
            pose = solve_wide_pose(self.world, self.pixels, lens)
        else:
            pose = solve_pose(self.world, self.pixels, lens.K, lens.dist)
        return replace(lens, T_world_cam=pose.T_world_cam), pose.used

    def _solved_with_lens(self, *, search: bool) -> tuple[Camera, NDArray[np.bool_]]:
        """The lens with the pose: in a picture of square pixels, brought back to the recording's."""
        size_px = self.width_px, self.height_px
        wide_px = (max(round(self.width_px * self.pixel_aspect), 1), self.height_px)
        scale = scale_of(size_px, wide_px)
        pixels = resized_px(self.pixels, scale)
        fit: LensFit | GroundFit
        if self.solves_lens:
            fit = solve_unknown_lens(self.world, pixels, *wide_px, search=search)
        else:
            fit = solve_ground_camera(self.world[:, :2], pixels, *wide_px)
        if wide_px == size_px:
            return fit.camera, fit.used
        K = resized_intrinsics(fit.camera.K, 1 / scale)
        return replace(fit.camera, K=K, width_px=self.width_px, height_px=self.height_px), fit.used

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
    best, best_px = None, max(min(misfit_px / _GAIN, _FITTING_PX), _CLICK_PX)
    for reading, sighting in _readings(given):
        try:
            camera, _ = sighting.solve(search=False)
        except CalibrationError:
            continue
        found_px = sighting.misfit_px(camera)
        if found_px < best_px and is_plausible(camera):
            best, best_px = reading, found_px
    return best or _of_focal_length(given, best_px)


def _of_focal_length(given: Sighting, misfit_px: float) -> Reading | None:
    """That points fit another focal length than that of K; not asked where a simpler reading fits.

    Args:
        given: as the user gave it.
        misfit_px: what it has to fall below.
    """
    if given.K is None or given.lens_model != "pinhole":
        return None
    flat = not given.world[:, 2].any()
    try:
        camera, _ = replace(given, K=None, dist=np.zeros(0), solves_lens=not flat).solve(search=False)
    except CalibrationError:
        return None
    ratio = float(camera.K[0, 0] / given.K[0, 0])
    if given.misfit_px(camera) >= misfit_px or not is_plausible(camera) or abs(ratio - 1) < _OTHER_FOCAL:
        return None
    kind = "homography" if flat else "points"
    return Reading(
        f"the points fit a focal length of about {camera.K[0, 0]:.0f} px, {ratio:.2f} times that of K",
        "Is K that of another zoom, video mode or lens? Video is often cut from the middle of what a photograph shows. "
        f"Calibrate as it records, or leave K out and use calibration kind '{kind}'.",
    )


def turned_world(camera: Camera, world: Array) -> Reading | None:
    """How a world stands that makes a camera lie on its side; None where turning it does not help.

    Points fit a camera as well however the world they are counted in is turned. But half of them lie on the road.

    Args:
        camera: as solved.
        world: (N, 3) the points, m.
    """
    if _on_road(world):
        return None
    for axis, turn in (("Y axis points up", _Y_UP), ("Y axis points down", _Y_DOWN)):
        turned = replace(camera, T_world_cam=SE3(turn, np.zeros(3)) @ camera.T_world_cam)
        if is_plausible(turned) and _on_road(world @ turn.T):
            return Reading(f"the world's {axis}", "Z is up: turn the coordinates, so that the road lies at Z = 0.")
    return None


MIRRORED = Reading(
    "the world axes look mirrored: the points fit a left-handed system",
    "World axes must be right-handed with Z up: swap X and Y, or flip the sign of one of them. Longitude and latitude "
    "that were exchanged, and a picture that is mirrored, look the same.",
)


def _on_road(world: Array) -> bool:
    return bool(np.median(np.abs(world[:, 2])) <= ROAD_M)


def _readings(given: Sighting) -> Iterator[tuple[Reading, Sighting]]:
    yield MIRRORED, replace(given, world=given.world * [-1.0, 1.0, 1.0])
    if given.world[:, 2].any():
        down = Reading("the world's Z axis points down", "Z is up: flip the sign of z, and of y or of x.")
        yield down, replace(given, world=given.world * [1.0, -1.0, -1.0])
        heights = Reading("heights count downwards", "Z is up: flip the sign of every z.")
        yield heights, replace(given, world=given.world * [1.0, 1.0, -1.0])
        yield from _of_heights(given)
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
    elif given.solves_lens:
        for aspect in _PIXEL_ASPECTS:
            if abs(aspect - given.pixel_aspect) < 0.01 * aspect:
                continue
            yield (
                Reading(
                    f"the points fit pixels that are {aspect:.3g} times as wide as high",
                    f'Say "pixel_aspect": {aspect:.4g} in the calibration if the recording is squeezed so, or give the '
                    "size that players show, and pixels as clicked there.",
                ),
                replace(given, pixel_aspect=aspect),
            )


def _of_heights(given: Sighting) -> Iterator[tuple[Reading, Sighting]]:
    """Heights in another unit than places on the ground."""
    for unit, metres in _HEIGHTS_M:
        heights = Reading(
            f"heights look like {unit}, and places on the ground like metres",
            f"All coordinates are in metres: multiply every z by {metres:g}.",
        )
        yield heights, replace(given, world=given.world * [1.0, 1.0, metres])
    northing_m = float(np.median(given.world[:, 1]))
    if 1e5 < abs(northing_m) < np.pi * _SPHERE_M:
        shorter = 1.0 / np.cosh(northing_m / _SPHERE_M)  # the cosine of the latitude
        mercator = Reading(
            f"places on the ground look like Web Mercator (EPSG:3857), in which a metre is {1 / shorter:.2f} m long "
            "here, and heights like metres",
            "Project the points to metres that are metres, e.g. to the UTM zone of the site.",
        )
        yield mercator, replace(given, world=given.world * [shorter, shorter, 1.0])


def _of_intrinsics(given: Sighting, K: Array) -> Iterator[tuple[Reading, Sighting]]:
    size = f"{given.width_px}x{given.height_px} px"
    of_K = size_of_intrinsics(K, given.width_px, given.height_px)
    if np.abs(K[:2, 2]).max() < 1:
        middle = np.array([given.width_px - 1, given.height_px - 1]) / 2
        yield (
            Reading(
                "cx and cy in K count from the middle of the picture",
                f"They count from its top left pixel: add {middle[0]:g} to cx and {middle[1]:g} to cy.",
            ),
            replace(given, K=K + np.array([[0, 0, middle[0]], [0, 0, middle[1]], [0, 0, 0]])),
        )
    swapped = K.copy()
    swapped[:2, 2] = K[1, 2], K[0, 2]
    yield (
        Reading("cx and cy look swapped in K", "K is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], cx along the width."),
        replace(given, K=swapped),
    )
    for ratio in _SIZE_RATIOS:
        shown = "" if of_K is None else f"; by its principal point, K is that of about {of_K[0]}x{of_K[1]} px"
        yield (
            Reading(
                f"K fits a picture {ratio:.3g} times the size of the one that the pixels are of",
                f"Both must be those of the recording, {size}: scale K, or pixels clicked in a resized picture{shown}.",
            ),
            replace(given, pixels=(given.pixels + 0.5) * ratio - 0.5),
        )
    for axis, extent, numbers in ((0, "wide", "fx and cx"), (1, "high", "fy and cy")):
        for ratio in _PIXEL_WIDTHS:
            scale = np.where(np.arange(2) == axis, ratio, 1.0)
            yield (
                Reading(
                    f"the pixels fit a picture {ratio:.3g} times as {extent}: it was squeezed or stretched, and K "
                    "was not",
                    f"K must be that of the recording as it is, {size}: scale {numbers}.",
                ),
                replace(given, pixels=resized_px(given.pixels, scale)),
            )
    if given.dist.any() or given.lens_model != "pinhole":
        yield (
            Reading(
                "the points fit a lens without distortion",
                "Leave dist out, and lens: the recording seems undistorted already.",
            ),
            replace(given, dist=np.zeros(0), lens_model="pinhole", xi=0.0),
        )
    if given.dist.any():
        yield (
            Reading(
                "the points fit a lens that bends lines the other way: dist with all its signs changed",
                "dist says how the lens bends the picture, as cv2.calibrateCamera gives it, not how to undo that.",
            ),
            replace(given, dist=-given.dist),
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
