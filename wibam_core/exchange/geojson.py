"""GeoJSON (RFC 7946), in WGS 84: the paths of all tracks, and their states one by one.

``tracks.geojson`` has a line a track, whose ``time_ns``, ``speed_mps`` and ``bearing_deg`` are lists as long as its
coordinates; ``states.geojson`` a point a state, for maps that move. Positions are those on the ground below the middle
of a box.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wibam_core.exchange.base import Content, Part, require_parts
from wibam_core.exchange.earth import Earth
from wibam_core.geometry.box3d import HEIGHT, SIZE, XY, XYZ, YAW
from wibam_core.scene import FloatArray, Track

#: Decimals of degrees: a tenth of a millimetre.
_DEGREE_DECIMALS = 9
_METRE_DECIMALS = 4


class GeoJson:
    """The format, for the registry."""

    name = "geojson"
    title = "GeoJSON (WGS 84)"
    writes = frozenset({Part.TRACKS, Part.ORIGIN})
    needs = frozenset({Part.TRACKS, Part.ORIGIN})
    loses = (
        "Rates of turning and standard deviations, but for the place's; heights, where the site does not say its "
        "altitude. Times are nanoseconds on the site's clock, since its date is not known."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """See `wibam_core.exchange.base.ExchangeFormat.write`."""
        require_parts(self, content)
        assert content.site is not None and content.site.origin is not None
        earth = Earth(content.site.origin)
        tracks = content.tracks or ()
        paths = [folder / "tracks.geojson", folder / "states.geojson"]
        _write(paths[0], (_line(earth, track) for track in tracks))
        _write(paths[1], (point for track in tracks for point in _points(earth, track)))
        return paths


def _write(path: Path, features: Iterable[dict[str, Any]]) -> None:
    """Write a feature collection, a feature a line."""
    with path.open("w", encoding="utf-8") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for number, feature in enumerate(features):
            file.write(",\n" if number else "\n")
            json.dump(feature, file, allow_nan=False)
        file.write("\n]}\n")


def _line(earth: Earth, track: Track) -> dict[str, Any]:
    positions = _positions(earth, track)
    length_m, width_m, height_m = np.median(track.boxes[:, SIZE], axis=0).round(_METRE_DECIMALS).tolist()
    return {
        "type": "Feature",
        "id": track.track_id,
        # a line has two positions or more (RFC 7946, section 3.1.4)
        "geometry": {"type": "LineString", "coordinates": positions} if len(track) > 1 else _point(positions[0]),
        "properties": {
            "track_id": track.track_id,
            "class": track.vehicle_class.value,
            "length_m": length_m,
            "width_m": width_m,
            "height_m": height_m,
            "time_ns": track.times_ns.tolist(),
            "speed_mps": _speeds_mps(track).tolist(),
            "bearing_deg": _bearings_deg(earth, track).tolist(),
        },
    }


def _points(earth: Earth, track: Track) -> Iterator[dict[str, Any]]:
    places_sd_m = np.sqrt((track.sd[:, XY] ** 2).mean(axis=1))
    columns = zip(
        _positions(earth, track),
        track.times_ns.tolist(),
        _speeds_mps(track).tolist(),
        _bearings_deg(earth, track).tolist(),
        track.boxes[:, SIZE].round(_METRE_DECIMALS).tolist(),
        places_sd_m.round(_METRE_DECIMALS).tolist(),
        strict=True,
    )
    for position, time_ns, speed_mps, bearing_deg, (length_m, width_m, height_m), place_sd_m in columns:
        yield {
            "type": "Feature",
            "geometry": _point(position),
            "properties": {
                "track_id": track.track_id,
                "class": track.vehicle_class.value,
                "time_ns": time_ns,
                "speed_mps": speed_mps,
                "bearing_deg": bearing_deg,
                "length_m": length_m,
                "width_m": width_m,
                "height_m": height_m,
                "place_sd_m": None if np.isnan(place_sd_m) else place_sd_m,
            },
        }


def _point(position: Sequence[float]) -> dict[str, Any]:
    return {"type": "Point", "coordinates": position}


def _positions(earth: Earth, track: Track) -> list[list[float]]:
    ground = track.boxes[:, XYZ] - track.boxes[:, HEIGHT, None] * [0.0, 0.0, 0.5]
    positions = earth.geographic(ground)
    positions[:, :2] = positions[:, :2].round(_DEGREE_DECIMALS)
    positions[:, 2:] = positions[:, 2:].round(_METRE_DECIMALS)
    return positions.tolist()


def _speeds_mps(track: Track) -> FloatArray:
    return np.hypot(*track.velocities_mps.T).round(_METRE_DECIMALS)


def _bearings_deg(earth: Earth, track: Track) -> FloatArray:
    return earth.bearing_deg(track.boxes[:, YAW]).round(_METRE_DECIMALS)
