"""Ground control points as GeoJSON: point features with the pixel in their properties.

Longitude and latitude are WGS 84 (RFC 7946), unless the file names another system (``crs``, as the 2008 format did). A
feature's pixel is ``"pixel": [u, v]``, or ``"u"`` and ``"v"`` (``"px"``, ``"pixel_x"``, ``"col"``); ``"height_m"``, the
height above the road, may be left out, and ``"camera"`` says whose pixel it is where a file holds several cameras'.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wibam_core.calibration.foreign.base import FoundCamera, Reader, SurveyedPoints, json_object
from wibam_core.errors import InputError

_WGS84 = "EPSG:4326"
_PIXELS = (("u", "v"), ("px", "py"), ("pixel_x", "pixel_y"), ("col", "row"))


def _recognises(name: str, text: str) -> bool:
    content = json_object(text) if name.endswith((".geojson", ".json")) else None
    return content is not None and content.get("type") == "FeatureCollection"


def _read(text: str) -> Sequence[FoundCamera]:
    content = json_object(text)
    assert content is not None
    crs = _crs(content)
    rows: dict[str, list[tuple[list[float], float, list[float]]]] = {}
    others = 0
    features = content.get("features")
    for number, feature in enumerate(features if isinstance(features, list) else [], 1):
        geometry = feature.get("geometry") if isinstance(feature, dict) else None
        properties = feature.get("properties") if isinstance(feature, dict) else None
        properties = properties if isinstance(properties, dict) else {}
        pixel = _pixel(properties)
        if not isinstance(geometry, dict) or geometry.get("type") != "Point" or pixel is None:
            others += 1
            continue
        try:
            x, y, *altitude = (float(value) for value in geometry["coordinates"])
            u, v = (float(value) for value in pixel)
            height = float(properties.get("height_m", np.nan))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"feature {number} has no coordinates and pixel of numbers") from error
        row = ([x, y, height], altitude[0] if altitude else np.nan, [u, v])
        rows.setdefault(str(properties.get("camera", "")), []).append(row)
    if not rows:
        raise InputError(
            "no point feature has a pixel", hint='Give each a property "pixel": [u, v], in pixels of the recording.'
        )
    notes = (f"{others} features that are no points with a pixel were left out.",) if others else ()
    found = []
    for camera, of_camera in rows.items():
        places, altitudes, pixels = (np.array(column, dtype=np.float64) for column in zip(*of_camera, strict=True))
        found.append(FoundCamera(camera, points=SurveyedPoints(places, altitudes, pixels, crs), notes=notes))
    return found


def _pixel(properties: Mapping[str, Any]) -> Sequence[Any] | None:
    """What stands for the pixel, in an array, a text (as map programs keep arrays) or two numbers; None without."""
    pixel = properties.get("pixel")
    if isinstance(pixel, str):
        return [part for part in re.split(r"[\s,;\[\]()]+", pixel) if part]
    if pixel is not None:
        return pixel if isinstance(pixel, list) else [pixel]
    for names in _PIXELS:
        found = [properties.get(name) for name in names]
        if None not in found:
            return found
    return None


def _crs(content: Mapping[str, Any]) -> str:
    named = content.get("crs")
    try:
        return str(named["properties"]["name"]) if named is not None else _WGS84
    except (KeyError, TypeError) as error:
        raise InputError("crs names no coordinate reference system") from error


GEOJSON = Reader("GeoJSON control points", _recognises, _read)
