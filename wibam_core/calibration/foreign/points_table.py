"""Surveyed points as a table: a line of names, then a point and its pixel a row, as surveyors and spreadsheets write.

Columns are known by their names, letter case and units aside: x and y, easting and northing, or longitude and latitude;
u and v of the recording. There may be heights above the road, altitudes, and the camera that the pixel is of.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wibam_core.calibration.foreign.base import FoundCamera, Reader, SurveyedPoints, short_crs, unknown_crs
from wibam_core.calibration.foreign.rows import Rows, header_of, read_rows
from wibam_core.errors import InputError

_X, _Y = ("x", "easting", "east", "e"), ("y", "northing", "north", "n")
_LONGITUDE, _LATITUDE = ("longitude", "lon", "lng", "long"), ("latitude", "lat")
_HEIGHT, _ALTITUDE = ("z", "height", "height above the road"), ("altitude", "alt", "elevation")
_U, _V = ("u", "pixel_x", "pixelx", "px", "column"), ("v", "pixel_y", "pixely", "py", "row")
_CAMERA = ("camera", "camera_id", "cam")
_WGS84 = "EPSG:4326"


def _recognises(name: str, text: str) -> bool:
    names = header_of(text[:4096])
    return name.endswith((".csv", ".tsv", ".txt")) and _one_of(_U, names) is not None and _one_of(_V, names) is not None


def _one_of(wanted: Sequence[str], names: Sequence[str]) -> str | None:
    return next((name for name in wanted if name in names), None)


def _read(text: str) -> Sequence[FoundCamera]:
    table = read_rows(text)
    places, crs, notes = _places(table)
    pixel = (_one_of(_U, table.names), _one_of(_V, table.names))
    x, y, u, v = (*places, *pixel)
    if x is None or y is None or u is None or v is None:
        raise InputError(
            "the table has no two columns of places: x and y, easting and northing, or longitude and latitude",
            hint="Name them in the first line, beside u and v, the pixel in the recording.",
        )
    twice = [name for name in (x, y, u, v) if table.names.count(name) > 1]
    if twice:
        raise InputError(f"the table has two columns {twice[0]}", hint="Leave the one out that is not meant.")
    height, altitude, camera = (_one_of(wanted, table.names) for wanted in (_HEIGHT, _ALTITUDE, _CAMERA))
    found: dict[str, list[list[float]]] = {}
    unseen = 0
    for line, row in table.rows:
        if not row.get(u, "").strip() and not row.get(v, "").strip():
            unseen += 1
            continue
        optional = [
            table.number(line, row, name) if name is not None and row.get(name, "").strip() else np.nan
            for name in (height, altitude)
        ]
        numbers = [table.number(line, row, name) for name in (x, y, u, v)]
        if not np.isfinite(numbers).all():
            raise InputError(f"line {line} has a number that is not finite", hint="Correct it, or leave the row out.")
        found.setdefault(row.get(camera, "").strip() if camera else "", []).append([*numbers, *optional])
    if not found:
        raise InputError("no row has a pixel", hint="Give u and v, in pixels of the recording.")
    if unseen:
        notes = (*notes, f"{unseen} points without a pixel were left out.")
    return [_camera(name, np.array(rows), crs, notes) for name, rows in found.items()]


def _places(table: Rows) -> tuple[tuple[str | None, str | None], str | None, tuple[str, ...]]:
    """The two columns that say where points are, the system that they are in, and what a person should know of it.

    Longitude and latitude come first, unless the table names a system of another kind: that is of x and y.

    Raises:
        InputError: there are longitude and latitude alone, and the table names a system that has none.
    """
    earth = (_one_of(_LONGITUDE, table.names), _one_of(_LATITUDE, table.names))
    plane = (_one_of(_X, table.names), _one_of(_Y, table.names))
    if None in earth:
        return plane, table.crs or None, ()
    of_earth = not table.crs or _has_longitudes(table.crs)
    if None in plane:
        if not of_earth:
            raise InputError(
                f"the table has {earth[0]} and {earth[1]}, but names {short_crs(table.crs)}, which has neither",
                hint="Leave the line #CRS out where they are in WGS 84, or call the columns easting and northing.",
            )
        return earth, table.crs or _WGS84, ()
    used, left, crs = (earth, plane, table.crs or _WGS84) if of_earth else (plane, earth, table.crs)
    note = f"Places are {used[0]} and {used[1]} in {short_crs(crs)}; {left[0]} and {left[1]} were left out."
    return used, crs, (note,)


def _has_longitudes(crs: str) -> bool:
    """Whether a coordinate reference system is one of longitude and latitude.

    Raises:
        InputError: it is not known.
    """
    from pyproj import CRS  # takes longer to import than all else here
    from pyproj.exceptions import CRSError

    try:
        return bool(CRS.from_user_input(crs).is_geographic)
    except CRSError as error:
        raise unknown_crs(crs) from error


def _camera(name: str, rows: np.ndarray, crs: str | None, notes: tuple[str, ...]) -> FoundCamera:
    """Of rows x, y, u, v, height, altitude."""
    points = SurveyedPoints(rows[:, [0, 1, 4]], rows[:, 5], rows[:, 2:4], crs)
    return FoundCamera(name, points=points, notes=notes)


POINTS_TABLE = Reader("table of points", _recognises, _read)
