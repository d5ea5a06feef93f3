"""Trajectories for the Surrogate Safety Assessment Model of the FHWA: one binary ``.trj`` file.

Open Source SSAM File Format v3.0. A file is a FORMAT record (byte order, version, whether z counts), a DIMENSIONS
record (units, scale, bounds of the observed area) and, for each instant, a TIMESTEP record followed by a VEHICLE record
for each road user: the middles of its front and of its rear bumper, its size, speed and acceleration. Everything is
packed without gaps; ours is little-endian and metric.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wibam_core.exchange import motion
from wibam_core.exchange.base import Content, Part, require_parts
from wibam_core.geometry.box3d import HEIGHT, LENGTH, WIDTH, XY, YAW, Z
from wibam_core.scene import Track

_FORMAT, _DIMENSIONS, _TIMESTEP, _VEHICLE = range(4)
_VERSION = 3.0
#: The traffic of one level alone is compared, so that heights need not count.
_WITHOUT_Z = 0
_METRIC = 1
_SCALE = 1.0

_VEHICLES = np.dtype(
    [
        ("record", "u1"),
        ("vehicle_id", "<i4"),
        ("link_id", "<i4"),
        ("lane_id", "u1"),
        ("front_m", "<f4", 2),
        ("rear_m", "<f4", 2),
        ("length_m", "<f4"),
        ("width_m", "<f4"),
        ("speed_mps", "<f4"),
        ("acceleration_mps2", "<f4"),
        ("front_z_m", "<f4"),
        ("rear_z_m", "<f4"),
    ]
)


class Ssam:
    """The format, for the registry."""

    name = "ssam"
    title = "SSAM trajectories (.trj)"
    writes = frozenset({Part.TRACKS})
    needs = frozenset({Part.TRACKS})
    loses = (
        "Classes, heights of boxes and standard deviations; there is one link and one lane. Numbers have single "
        "precision. SSAM projects along the path that was driven, and takes every gap in a track for its end."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """See `wibam_core.exchange.base.ExchangeFormat.write`."""
        require_parts(self, content)
        tracks = content.tracks or ()
        times_ns = np.concatenate([np.empty(0, np.int64), *(track.times_ns for track in tracks)])
        records = np.concatenate([np.empty(0, _VEHICLES), *(_records(track) for track in tracks)])
        order = np.lexsort((records["vehicle_id"], times_ns))
        instants, starts = np.unique(times_ns[order], return_index=True)
        path = folder / "tracks.trj"
        with path.open("wb") as file:
            file.write(struct.pack("<Bcfb", _FORMAT, b"L", _VERSION, _WITHOUT_Z))
            file.write(struct.pack("<BBf4i", _DIMENSIONS, _METRIC, _SCALE, *_bounds_m(tracks)))
            for time_ns, seen in zip(instants.tolist(), np.split(records[order], starts[1:]), strict=False):
                file.write(struct.pack("<Bf", _TIMESTEP, time_ns * 1e-9))
                file.write(seen.tobytes())
        return [path]


def _records(track: Track) -> np.ndarray:
    """A VEHICLE record for each state (T,)."""
    boxes, yaw_rad = track.boxes, track.boxes[:, YAW]
    half_m = boxes[:, LENGTH, None] / 2 * np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=1)
    records = np.zeros(len(track), _VEHICLES)
    records["record"] = _VEHICLE
    records["vehicle_id"] = track.track_id
    records["front_m"], records["rear_m"] = boxes[:, XY] + half_m, boxes[:, XY] - half_m
    records["length_m"], records["width_m"] = boxes[:, LENGTH], boxes[:, WIDTH]
    records["speed_mps"] = np.hypot(*track.velocities_mps.T)
    records["acceleration_mps2"] = motion.along_and_across(motion.accelerations_mps2(track), yaw_rad)[:, 0]
    records["front_z_m"] = records["rear_z_m"] = boxes[:, Z] - boxes[:, HEIGHT] / 2
    return records


def _bounds_m(tracks: Sequence[Track]) -> tuple[int, int, int, int]:
    """Smallest x and y, largest x and y in whole metres; SSAM passes over road users whose middle lies outside."""
    centres = np.concatenate([np.zeros((1, 2)), *(track.boxes[:, XY] for track in tracks)])
    low, high = centres.min(axis=0).tolist(), centres.max(axis=0).tolist()
    return math.floor(low[0]) - 1, math.floor(low[1]) - 1, math.ceil(high[0]) + 1, math.ceil(high[1]) + 1
