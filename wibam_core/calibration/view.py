"""What a camera sees of the road, and whether one can stand there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.warnings import Caution
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane

Array = NDArray[np.float64]

#: Ground farther from a camera than this is of no use.
GROUND_RANGE_M = 200.0
#: Heights above the road that no camera over a road has, and those that few have.
_POSSIBLE_HEIGHTS_M = (0.3, 500.0)
LIKELY_HEIGHTS_M = (1.5, 60.0)
#: Poles, gantries and first floors. Coordinates in other units are told by the height that they would have in metres.
_USUAL_HEIGHTS_M = (3.0, 15.0)
_UNITS_M = (
    ("kilometres", 1000.0),
    ("feet", 0.3048),
    ("decimetres", 0.1),
    ("inches", 0.0254),
    ("centimetres", 0.01),
    ("millimetres", 0.001),
)
#: A camera that looks straight down has no upright; this is the sine of the smallest angle to it of one that has.
_LEVEL = 0.2
#: Cameras on poles are level to a few degrees.
_TURNED_DEG = 20.0


def visible_ground(camera: Camera, steps: int = 32) -> Array:
    """(N, 3) ground points in view within `GROUND_RANGE_M`, at a regular grid of pixels; N may be 0."""
    u, v = np.meshgrid(np.linspace(0, camera.width_px - 1, steps), np.linspace(0, camera.height_px - 1, steps))
    points = intersect_plane(camera, np.stack([u.ravel(), v.ravel()], axis=1))
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(points - camera.centre_m, axis=1) <= GROUND_RANGE_M
    return np.asarray(points[near])


def check_view(camera: Camera) -> None:
    """Refuse a camera that does not look at the ground from above.

    Raises:
        CalibrationError: below the ground, impossibly low or high, or with no ground in view.
    """
    height_m = float(camera.centre_m[2])
    if height_m <= 0:
        raise CalibrationError(
            f"the camera comes out {-height_m:.2f} m below the ground",
            hint="rvec and tvec are OpenCV's, world to camera; the world has Z up and the ground at Z = 0, in metres. "
            "Where Z points down, change the signs of y and z.",
        )
    sees_none = len(visible_ground(camera)) == 0
    lowest_m, highest_m = _POSSIBLE_HEIGHTS_M
    if not lowest_m <= height_m <= highest_m or (sees_none and height_m > LIKELY_HEIGHTS_M[1]):
        raise CalibrationError(f"the camera comes out {_metres(height_m)} above the ground", hint=_units_hint(height_m))
    if sees_none:
        raise CalibrationError(
            f"no ground within {GROUND_RANGE_M:.0f} m is in the camera's view",
            hint="rvec and tvec are OpenCV's, world to camera (x right, y down, z forward); is one of them inverted?",
        )


def is_plausible(camera: Camera) -> bool:
    """Whether a camera can look at a road so, and is upright. A wide lens needs not be: its views are cut upright."""
    try:
        check_view(camera)
    except CalibrationError:
        return False
    return camera.is_wide or abs(roll_rad(camera)) < np.pi / 4


def view_cautions(camera: Camera) -> list[Caution]:
    """What is unusual about where a camera stands and how it is held."""
    height_m, found = float(camera.centre_m[2]), []
    lowest_m, highest_m = LIKELY_HEIGHTS_M
    if not lowest_m <= height_m <= highest_m:
        found.append(
            Caution(
                code="camera_height",
                message=f"the camera comes out {_metres(height_m)} above the road",
                hint=_units_hint(height_m),
                details={"height_m": height_m},
            )
        )
    elif height_m > _USUAL_HEIGHTS_M[1]:
        found.append(
            Caution(
                code="check_units",
                message=f"the camera comes out {_metres(height_m)} above the road, higher than most",
                hint=f"{_units_hint(height_m)} If it is so high, all is well.",
                details={"height_m": height_m},
            )
        )
    roll_deg = float(np.degrees(roll_rad(camera)))
    if abs(roll_deg) > _TURNED_DEG and not camera.is_wide:
        found.append(
            Caution(
                code="rolled_camera",
                message=f"the picture comes out turned by {abs(roll_deg):.0f}° against the horizon",
                hint="Detectors know vehicles upright: turn the recording if the camera hangs so, or check which way "
                "pixels count, and that rvec is a Rodrigues vector, not three angles.",
                details={"roll_deg": roll_deg},
            )
        )
    return found


def _units_hint(height_m: float) -> str:
    low, high = _USUAL_HEIGHTS_M
    found = [
        f"If these are {name}, multiply them by {factor:g}: the height is then {height_m * factor:.1f} m"
        for name, factor in _UNITS_M
        if low <= height_m * factor <= high
    ]
    ending = ". ".join(found) if found else "Check both"
    return f"Positions are in metres, and heights count from the road, not from the sea. {ending}."


def _metres(height_m: float) -> str:
    return f"{height_m:.0f} m" if height_m >= 100 else f"{height_m:.3g} m"


def roll_rad(camera: Camera) -> float:
    """How far the picture is turned against the horizon; 0 for a camera that looks straight down."""
    right, down = camera.T_world_cam.rotation[2, :2]
    return float(np.arctan2(right, -down)) if np.hypot(right, down) > _LEVEL else 0.0
