"""Points of QGIS's georeferencer (``.points``): map coordinates, and pixels from the top-left corner, v upwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wibam_core.calibration.foreign.base import FoundCamera, Reader, SurveyedPoints
from wibam_core.calibration.foreign.rows import header_of, read_rows
from wibam_core.errors import InputError

_PIXELS = (("sourcex", "sourcey"), ("pixelx", "pixely"))


def _recognises(name: str, text: str) -> bool:
    return name.endswith(".points") or header_of(text[:4096])[:2] == ("mapx", "mapy")


def _read(text: str) -> Sequence[FoundCamera]:
    table = read_rows(text)
    pixel = next((pair for pair in _PIXELS if set(pair) <= set(table.names)), None)
    if pixel is None or not {"mapx", "mapy"} <= set(table.names):
        raise InputError("the columns mapX, mapY, sourceX, sourceY are missing", hint="Save the points in QGIS again.")
    places, pixels, off = [], [], 0
    for line, row in table.rows:
        if (row.get("enable") or "1").strip() == "0":
            off += 1
            continue
        x, y, u, v = (table.number(line, row, name) for name in ("mapx", "mapy", *pixel))
        places.append([x, y, np.nan])
        pixels.append([u - 0.5, -v - 0.5])
    downwards = len(pixels) > 0 and all(v < -0.5 for _, v in pixels)
    if downwards:  # what other programs write in this form; none of a picture's own pixels lies above it
        pixels = [[u, -v - 1.0] for u, v in pixels]
    notes = ["Heights are not in the file: all points are taken to lie on the road."]
    if downwards:
        notes.append("Its pixels count downwards, as QGIS's own do not: they were taken so.")
    if off:
        notes.append(f"{off} points that are switched off were left out.")
    points = SurveyedPoints(
        np.array(places, dtype=np.float64).reshape(-1, 3),
        np.full(len(places), np.nan),
        np.array(pixels, dtype=np.float64).reshape(-1, 2),
        table.crs or None,
    )
    return [FoundCamera(points=points, notes=tuple(notes))]


QGIS = Reader("QGIS points", _recognises, _read)
