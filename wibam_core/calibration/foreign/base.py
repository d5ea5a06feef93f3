"""What a file of another program says of a camera, in our conventions."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wibam_core.errors import InputError
from wibam_core.site import Lens

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """A lens.

    Attributes:
        K: (3, 3) px; pixel (0, 0) is the centre of the top-left pixel.
        dist: (n,) in OpenCV's order for the lens.
        lens, xi: see `wibam_core.geometry.camera.Camera`.
        size_px: width and height of the picture, where the file says it.
    """

    K: Array
    dist: Array
    lens: Lens = "pinhole"
    xi: float = 0.0
    size_px: tuple[int, int] | None = None


@dataclass(frozen=True, eq=False)
class SurveyedPoints:
    """Places on the ground or above it, and where a camera sees them.

    Attributes:
        coordinates: (N, 3) x, y, z in the coordinate reference system, easting or longitude first; z is the height
            above the road (m), or NaN where only the place is known.
        altitudes_m: (N,) above the ellipsoid, or NaN.
        pixels: (N, 2) u, v of the recording.
        crs: of the coordinates, as pyproj reads it; None: metres of the site's own world.
    """

    coordinates: Array
    altitudes_m: Array
    pixels: Array
    crs: str | None


@dataclass(frozen=True, eq=False)
class FoundCamera:
    """What a file says of one camera.

    Attributes:
        name: as the file calls it; "" where it does not.
        intrinsics: of the lens.
        rvec, tvec: (3,) OpenCV's pose, world to camera, in the file's world, m.
        points: surveyed ones.
        notes: what a person should know: what was left out or taken for granted.
    """

    name: str = ""
    intrinsics: Intrinsics | None = None
    rvec: Array | None = None
    tvec: Array | None = None
    points: SurveyedPoints | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reader:
    """One format.

    Attributes:
        name: as a person says it.
        recognises: whether a file is one, by its name (lower case) and text.
        read: the cameras of a file.
    """

    name: str
    recognises: Callable[[str, str], bool]
    read: Callable[[str], Sequence[FoundCamera]]


def matrix(value: Any, rows: int, columns: int, what: str) -> Array:
    """A matrix of numbers, nested or in one row, or as OpenCV and ROS write it, with ``data``.

    Raises:
        InputError: it is none, or of another size.
    """
    numbers = value.get("data") if isinstance(value, Mapping) else value
    try:
        found = np.array(numbers, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} is no matrix of numbers") from error
    if found.size != rows * columns or not np.isfinite(found).all():
        raise InputError(f"{what} must have {rows} x {columns} finite numbers, not {found.size}")
    return found.reshape(rows, columns)


def vector(value: Any, what: str) -> Array:
    """Numbers in a row, nested or with ``data``.

    Raises:
        InputError: they are none.
    """
    numbers = value.get("data") if isinstance(value, Mapping) else value
    try:
        found = np.array([] if numbers is None else numbers, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} is no row of numbers") from error
    if not np.isfinite(found).all():
        raise InputError(f"{what} must be finite")
    return found


def json_object(text: str) -> Mapping[str, Any] | None:
    """The object that a JSON file holds; None where it holds anything else."""
    try:
        found = json.loads(text)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def first(values: Mapping[str, Any], names: Sequence[str]) -> Any:
    """The value of the first of the names that there is, letter case and underscores aside; None without."""
    plain = {key.lower().replace("_", ""): value for key, value in values.items() if isinstance(key, str)}
    return next((plain[name] for name in names if name in plain), None)


def short_crs(crs: str) -> str:
    """A coordinate reference system, for a sentence: its beginning where it is written at length."""
    return crs if len(crs) <= 40 else f"{crs[:37]}..."


def unknown_crs(crs: str) -> InputError:
    """The refusal of a coordinate reference system that PROJ does not know."""
    return InputError(
        f"the coordinate reference system {short_crs(crs)} is not known", hint="Name it by its code, as EPSG:25832."
    )
