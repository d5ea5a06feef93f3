"""Colours of road users in a clip: those of the player."""

from __future__ import annotations

from colorsys import hls_to_rgb

from wibam_core.documents.clips import ClipSpec
from wibam_core.report.style import bgr
from wibam_core.scene import Track

Bgr = tuple[int, int, int]

#: A speed from which on the colour stays, m/s.
FASTEST_MPS = 20.0
_TRACKS = tuple(
    bgr(colour)
    for colour in (
        "#0072b2",
        "#d55e00",
        "#009e73",
        "#cc79a7",
        "#e69f00",
        "#56b4e9",
        "#7a5195",
        "#8a6d3b",
        "#c0392b",
        "#2c7873",
    )
)


def colour_of(track: Track, speed_mps: float, spec: ClipSpec) -> Bgr:
    """Of a road user that goes at a speed, m/s."""
    if spec.colour == "speed":
        return speed_colour(speed_mps)
    if spec.colour == "track":
        return _TRACKS[track.track_id % len(_TRACKS)]
    return bgr(track.vehicle_class.traits.colour)


def speed_colour(speed_mps: float) -> Bgr:
    """Blue (standing) through green and yellow to red (fast): lightness rises with speed, too."""
    share = min(1.0, speed_mps / FASTEST_MPS)
    red, green, blue = hls_to_rgb((230 - 230 * share) / 360, (42 + 14 * share) / 100, 0.85)
    return round(255 * blue), round(255 * green), round(255 * red)
