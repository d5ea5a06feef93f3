"""Whether surveyed points can lie on and over a road, looked at before and after a camera is solved from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.warnings import Caution
from wibam_core.errors import CalibrationError

Array = NDArray[np.float64]

MIN_POINTS = 4
#: Points are on one line when their extent across it is smaller than this share of their extent along it.
_LINE = 0.01
#: A point is stray this many times as far out as half of the points are, and beyond the reach of any camera.
_STRAY = 50.0
_STRAY_M = 1000.0
#: Points over a road spread wider than this; narrower, they are in another unit.
_SMALLEST_EXTENT_M = 0.5
#: In degrees, a site is smaller than this.
_LARGEST_SITE_DEG = 0.01
#: Places on Earth are so far from its middle, give or take its flattening and mountains.
_EARTH_M, _CRUST_M = 6_370_000.0, 20_000.0
#: No road is higher above the sea.
_HIGHEST_M = 10_000.0
#: Half of the points lie on the road, give or take this (it is crowned and sloped).
ROAD_M = 0.5
#: Points this high above the road, half of them or more, are counted from elsewhere: nobody surveys so many roofs.
_ELSEWHERE_M = 10.0


def place(point: Array) -> str:
    """A point's coordinates (n,), to the centimetre."""
    return f"({', '.join(f'{value:.2f}' for value in point)})"


def check_points(world: Array, pixels: Array) -> None:
    """Refuse correspondences (N, 2 or 3) and (N, 2) that cannot fix a camera.

    Raises:
        CalibrationError: fewer than four, one of them far off, all of them in a unit that is not metres, or on one line
            in the world or in the image.
    """
    different = len(np.unique(np.concatenate([world, pixels], axis=1), axis=0))
    if different < MIN_POINTS:
        raise CalibrationError(f"{different} correspondences are too few; at least {MIN_POINTS} are needed")
    check_projected(world)
    _check_distances(world)
    for points, where in ((world, "world"), (pixels, "image")):
        if not np.isfinite(points).all():
            raise CalibrationError(f"a {where} coordinate is not finite")
        extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if extents[1] <= _LINE * max(extents[0], 1e-9):
            raise CalibrationError(
                f"all {len(points)} points lie on one line in the {where}",
                hint="Spread the points over the ground that vehicles use, to the left and right, near and far.",
            )


def check_projected(world: Array) -> None:
    """Refuse points (N, 2 or 3) that are counted from the middle of the Earth.

    Raises:
        CalibrationError: they are.
    """
    middle = np.median(world, axis=0)
    if len(middle) == 3 and abs(middle[2]) > _HIGHEST_M and abs(np.linalg.norm(middle) - _EARTH_M) < _CRUST_M:
        raise CalibrationError(
            f"the world points lie {np.linalg.norm(middle) / 1000:.0f} km from their origin: they look like geocentric "
            "coordinates (ECEF)",
            hint="Project them to metres with Z up, e.g. to the UTM zone of the site with heights above the road.",
        )


def _check_distances(world: Array) -> None:
    """Raises:
    CalibrationError: a stray point, or points closer together than a road is wide.
    """
    middle = np.median(world, axis=0)
    distance = np.linalg.norm((world - middle)[:, :2], axis=1)
    farthest = int(distance.argmax())
    if distance[farthest] > max(_STRAY * float(np.median(distance)), _STRAY_M):
        raise CalibrationError(
            f"the world point {place(world[farthest])} lies {distance[farthest] / 1000:.0f} km from the others",
            hint="Look for a mistyped coordinate.",
            point=world[farthest].tolist(),
        )
    extent = 2 * float(distance.max())
    if extent >= _SMALLEST_EXTENT_M:
        return
    globe = (np.abs(middle[:2]) <= [180, 180]).all() and np.abs(middle[:2]).max() > 1
    if globe and extent < _LARGEST_SITE_DEG:
        unit, hint = "longitude and latitude in degrees", "Project them to metres, e.g. to the UTM zone of the site."
    elif extent * 1000 < _SMALLEST_EXTENT_M:
        unit = "longitude and latitude in radians"
        hint = "Project them to metres, e.g. to the UTM zone of the site."
    else:
        unit, hint = "kilometres", "If these are kilometres, multiply them by 1000."
    raise CalibrationError(
        f"all {len(world)} world points lie within {extent:.2g} m of each other: they look like {unit}",
        hint=f"Positions are in metres. {hint}",
    )


def level_cautions(world: Array, height_m: float) -> list[Caution]:
    """Whether points count their heights from the road.

    Args:
        world: (N, 3) surveyed points, m.
        height_m: z of the camera that was solved from them, m.

    Raises:
        CalibrationError: they do not; the offset is in the hint.
    """
    heights = np.sort(world[:, 2])
    lower = heights[: (len(heights) + 1) // 2]
    level, spread = float(np.median(lower)), float(lower[-1] - lower[0])
    if abs(level) <= ROAD_M:
        return []
    side = "above" if level > 0 else "below"
    message = (
        f"the points lie at z = {heights[0]:.2f} to {heights[-1]:.2f} m, the lower half of them around "
        f"{abs(level):.1f} m {side} the road, which is at z = 0"
    )
    hint = (
        f"If these are points on the road, e.g. with heights above the sea, take {level:.2f} m off every z; the camera "
        f"is then {height_m - level:.1f} m above the road."
    )
    if spread < abs(level) / 4 and (level >= _ELSEWHERE_M or height_m <= 0):
        raise CalibrationError(message, hint=hint, level_m=level)
    return [Caution(code="road_level", message=message, hint=hint, details={"level_m": level})]


def repeated_point_cautions(world: Array, pixels: Array) -> list[Caution]:
    """Correspondences (N, 3) and (N, 2) that are listed twice: they fix a camera no better than once."""
    both = np.concatenate([world, pixels], axis=1)
    first = np.sort(np.unique(both, axis=0, return_index=True)[1])
    again = np.setdiff1d(np.arange(len(both)), first)
    if not len(again):
        return []
    named = ", ".join(place(world[row]) for row in again[:3])
    return [
        Caution(
            code="points_repeated",
            message=f"{len(again)} of {len(both)} points are listed twice with the same pixel, e.g. {named}",
            hint="Leave the second out, or correct it if another point was meant: it fixes the camera no better.",
            details={"points": again.tolist()},
        )
    ]


def check_on_ground(world: Array, tolerance_m: float) -> None:
    """Refuse points (N, 3) of a homography that are not on the ground.

    Raises:
        CalibrationError: with the offset where all lie on another plane, and the farthest point where they do not.
    """
    check_projected(world)
    heights = world[:, 2]
    if np.abs(heights).max(initial=0.0) <= tolerance_m:
        return
    level = float(np.median(heights))
    if np.ptp(heights) <= max(2 * ROAD_M, abs(level) / 4) and abs(level) > tolerance_m:
        raise CalibrationError(
            f"all points lie around z = {level:.2f} m, but calibration kind 'homography' takes points on the road, at "
            "z = 0",
            hint=f"Take {level:.2f} m off every z; where the road is nearly level, give z = 0.",
            level_m=level,
        )
    raised = world[int(np.abs(heights).argmax())]
    raise CalibrationError(
        "calibration kind 'homography' takes points on the ground alone (z = 0), and "
        f"{int((np.abs(heights) > tolerance_m).sum())} of {len(world)} are not, e.g. {place(raised)}",
        hint="Leave out raised points, or give the intrinsics and use calibration kind 'pnp'.",
    )
