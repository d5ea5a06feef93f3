"""Points of QGIS's georeferencer (``.points``): map coordinates, and pixels from the top-left corner, v upwards."""

from __future__ import annotations

import csv
from collections.abc import Sequence

import numpy as np

from wibam_core.calibration.foreign.base import FoundCamera, Reader, SurveyedPoints
from wibam_core.errors import InputError

_CRS = "#CRS:"
_PIXELS = (("sourcex", "sourcey"), ("pixelx", "pixely"))


def _recognises(name: str, text: str) -> bool:
    return name.endswith(".points") or any(line.lower().startswith("mapx,mapy") for line in text.splitlines()[:3])


def _read(text: str) -> Sequence[FoundCamera]:
    lines = text.splitlines()
    crs = next((line[len(_CRS) :].strip() for line in lines if line.startswith(_CRS)), None)
    table = csv.DictReader(line for line in lines if line.strip() and not line.startswith("#"))
    names = [name.strip().lower() for name in table.fieldnames or ()]
    pixel = next((pair for pair in _PIXELS if set(pair) <= set(names)), None)
    if pixel is None or not {"mapx", "mapy"} <= set(names):
        raise InputError("the columns mapX, mapY, sourceX, sourceY are missing", hint="Save the points in QGIS again.")
    table.fieldnames = names
    places, pixels, off = [], [], 0
    for number, row in enumerate(table, 1):
        if (row.get("enable") or "1").strip() == "0":
            off += 1
            continue
        try:
            x, y, u, v = (float(row[name]) for name in ("mapx", "mapy", *pixel))
        except (TypeError, ValueError) as error:
            raise InputError(f"point {number} is not of numbers") from error
        places.append([x, y, np.nan])
        pixels.append([u - 0.5, -v - 0.5])
    notes = ["Heights are not in the file: all points are taken to lie on the road."]
    if off:
        notes.append(f"{off} points that are switched off were left out.")
    points = SurveyedPoints(
        np.array(places, dtype=np.float64).reshape(-1, 3),
        np.full(len(places), np.nan),
        np.array(pixels, dtype=np.float64).reshape(-1, 2),
        crs or None,
    )
    return [FoundCamera(points=points, notes=tuple(notes))]


QGIS = Reader("QGIS points", _recognises, _read)
