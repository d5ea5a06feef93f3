"""Control points of OpenDroneMap (``gcp_list.txt``): a line that names the system, then a point in a picture a row.

A row is ``x y z u v picture``, set apart by blanks or tabs, and what else the user wrote; x is easting or longitude, z
an altitude. The picture's name without its ending is the camera's.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import PureWindowsPath

import numpy as np

from wibam_core.calibration.foreign.base import FoundCamera, Reader, SurveyedPoints
from wibam_core.errors import InputError

#: The picture of a line, whose name may have blanks; a name of the point may follow.
_PICTURE = re.compile(r"(.+?\.[A-Za-z]\w{1,4})(?:\s|$)")
_SYSTEM = re.compile(r"EPSG:\d+|\+proj=.+|WGS ?84 UTM (0?[1-9]|[1-5]\d|60) ?([NS])", re.IGNORECASE)


def _recognises(name: str, text: str) -> bool:
    return name.endswith(".txt") and _SYSTEM.fullmatch(next(iter(text.split("\n", 1)), "").strip()) is not None


def _read(text: str) -> Sequence[FoundCamera]:
    system, *lines = text.splitlines()
    found: dict[str, list[list[float]]] = {}
    for number, line in enumerate(lines, 2):
        cells = line.split(maxsplit=5)
        if not cells or cells[0].startswith("#"):
            continue
        try:
            *place, u, v = (float(cell) for cell in cells[:5])
            x, y, z = place
        except ValueError as error:
            raise InputError(
                f"line {number} does not begin with five numbers: x, y, z, and the pixel's u and v",
                hint="Correct it, with blanks between the numbers, or leave it out.",
            ) from error
        if not np.isfinite([x, y, u, v]).all() or math.isinf(z):
            raise InputError(f"line {number} has a number that is not finite", hint="Correct it, or leave the row out.")
        behind = cells[5] if len(cells) > 5 else ""
        file = _PICTURE.match(behind)
        picture = PureWindowsPath(file[1] if file else behind.partition(" ")[0]).stem
        found.setdefault(picture, []).append([x, y, math.nan, z, u, v])
    if not found:
        raise InputError("no line has a point", hint="Give x, y, z, u, v and the name of the picture, a point a line.")
    named = _SYSTEM.fullmatch(system.strip())
    zone = named is not None and named[1]
    crs = f"EPSG:{(326 if named[2].upper() == 'N' else 327)}{int(zone):02d}" if named and zone else system.strip()
    cameras = []
    for picture, rows in found.items():
        table = np.array(rows)
        points = SurveyedPoints(table[:, :3], table[:, 3], table[:, 4:], crs)
        cameras.append(FoundCamera(picture, points=points))
    return cameras


ODM = Reader("OpenDroneMap gcp_list.txt", _recognises, _read)
