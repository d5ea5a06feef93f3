"""Surveyed points as a table: a line of names, then a point and its pixel a row, as surveyors and spreadsheets write.

Columns are known by their names, letter case and units aside: x and y, easting and northing, or longitude and latitude;
u and v of the recording. There may be heights above the road, altitudes, and the camera that the pixel is of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from wibam_core.calibration.foreign.base import FoundCamera, Reader, SurveyedPoints, short_crs, unknown_crs
from wibam_core.calibration.foreign.rows import header_of, read_rows
from wibam_core.errors import InputError

_X = ("x", "easting", "east", "e", "rechtswert", "x_world", "world_x")
_Y = ("y", "northing", "north", "n", "hochwert", "y_world", "world_y")
_LONGITUDE, _LATITUDE = ("longitude", "lon", "lng", "long"), ("latitude", "lat")
_HEIGHT, _ALTITUDE = ("z", "height", "height above the road"), ("altitude", "alt", "elevation")
_U = ("u", "pixel_x", "pixelx", "px", "column", "col", "x_image", "image_x", "x_img", "img_x", "pixel", "sample")
_V = ("v", "pixel_y", "pixely", "py", "row", "y_image", "image_y", "y_img", "img_y", "line")
#: Pixels in a table whose places are called otherwise.
_BARE = ("x", "y")
_PLACES = ((_X, _Y), (_LONGITUDE, _LATITUDE))
_CAMERA = ("camera", "camera_id", "cam")
_WGS84 = "EPSG:4326"
#: Units of length that people write behind names, in metres.
_METRES = {
    **dict.fromkeys(("ft", "feet", "foot", "ift"), 0.3048),
    **dict.fromkeys(("ftus", "us-ft", "us ft", "usft", "us survey ft", "us survey feet"), 1200 / 3937),
    **dict.fromkeys(("yd", "yards"), 0.9144),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("km", "kilometres", "kilometers"), 1000.0),
    **dict.fromkeys(("dm", "decimetres", "decimeters"), 0.1),
    **dict.fromkeys(("cm", "centimetres", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimetres", "millimeters"), 0.001),
}


def _recognises(name: str, text: str) -> bool:
    if not name.endswith((".csv", ".tsv", ".txt")):
        return False
    names = header_of(text[:4096])
    if None not in _pixels(names):
        return True
    return len(names) > 3 and any(None not in (_one_of(x, names), _one_of(y, names)) for x, y in _PLACES)


def _pixels(names: Sequence[str]) -> tuple[str | None, str | None]:
    """The columns of the pixel; x and y where these are not the places."""
    found = (_one_of(_U, names), _one_of(_V, names))
    others = [name for name in names if name not in _BARE]
    if found == (None, None) and any(None not in (_one_of(x, others), _one_of(y, others)) for x, y in _PLACES):
        return (_one_of(_BARE[:1], names), _one_of(_BARE[1:], names))
    return found


def _one_of(wanted: Sequence[str], names: Sequence[str]) -> str | None:
    return next((name for name in wanted if name in names), None)


def _read(text: str) -> Sequence[FoundCamera]:
    table = read_rows(text)
    pixel = _pixels(table.names)
    places, crs, notes = _places(table.crs, [name for name in table.names if name not in pixel])
    x, y, u, v = (*places, *pixel)
    if u is None or v is None:
        raise InputError(
            "the table has no two columns of pixels in the recording",
            hint="Call them u and v in the first line: to the right, and down.",
        )
    if x is None or y is None:
        raise InputError(
            "the table has no two columns of places: x and y, easting and northing, or longitude and latitude",
            hint="Name them in the first line, beside u and v, the pixel in the recording.",
        )
    twice = [name for name in (x, y, u, v) if table.names.count(name) > 1]
    if twice:
        raise InputError(f"the table has two columns {twice[0]}", hint="Leave the one out that is not meant.")
    height, altitude, camera = (_one_of(wanted, table.names) for wanted in (_HEIGHT, _ALTITUDE, _CAMERA))
    _check_units(table.units, [height, altitude] if crs else [x, y, height, altitude])
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


def _check_units(units: Mapping[str, str], names: Sequence[str | None]) -> None:
    """Raises:
    InputError: a column is said to be in another unit than metres.
    """
    for name in names:
        unit = units.get(name or "", "")
        if unit in _METRES:
            raise InputError(
                f"the column {name} is in {unit}, and places and heights are in metres",
                hint=f"Multiply it by {_METRES[unit]:.10g}, and call it {name} [m]; coordinates in feet of a named "
                "system may stay with a line #CRS.",
            )


def _places(said_crs: str, names: Sequence[str]) -> tuple[tuple[str | None, str | None], str | None, tuple[str, ...]]:
    """The two columns that say where points are, the system that they are in, and what a person should know of it.

    Longitude and latitude come first, unless the table names a system of another kind: that is of x and y.

    Raises:
        InputError: there are longitude and latitude alone, and the table names a system that has none.
    """
    earth = (_one_of(_LONGITUDE, names), _one_of(_LATITUDE, names))
    plane = (_one_of(_X, names), _one_of(_Y, names))
    if None in earth:
        return plane, said_crs or None, ()
    of_earth = not said_crs or _has_longitudes(said_crs)
    if None in plane:
        if not of_earth:
            raise InputError(
                f"the table has {earth[0]} and {earth[1]}, but names {short_crs(said_crs)}, which has neither",
                hint="Leave the line #CRS out where they are in WGS 84, or call the columns easting and northing.",
            )
        return earth, said_crs or _WGS84, ()
    used, left, crs = (earth, plane, said_crs or _WGS84) if of_earth else (plane, earth, said_crs)
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
