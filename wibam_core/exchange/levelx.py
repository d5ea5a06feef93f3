"""levelXdata CSV: three tables a recording, as inD and highD publish them.

Bock et al. 2020, arXiv 1911.07602, and Krajewski et al. 2018, arXiv 1810.05642.

inD, and uniD, rounD and exiD after it: ``xCenter``, ``yCenter`` in m, y upwards; ``heading`` in degrees,
counter-clockwise from x. highD is in the coordinates of its image: ``x``, ``y`` is the upper left corner of a box
parallel to the axes, ``width`` its extent along x, which is the vehicle's length, and y points downwards;
``drivingDirection`` 1 goes to the left. Both are read, inD is written.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from wibam_core.errors import InputError
from wibam_core.exchange import csv_files, motion
from wibam_core.exchange.base import Content, Part, require_parts
from wibam_core.exchange.files import read_text, wrong
from wibam_core.exchange.names import classes_by_name
from wibam_core.geometry.box3d import LENGTH, WIDTH, YAW, X, Y
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import FloatArray, IntArray, Track
from wibam_core.site import Origin

_TABLES = ("tracks", "tracksMeta", "recordingMeta")
_PREFIX = "00"

#: Times beyond do not fit into int nanoseconds.
_LATEST_S = 4e9
#: What counts as a vulnerable road user in ``recordingMeta``.
_VULNERABLE = ("pedestrian", "bicycle")


def _schema(integers: Sequence[str], numbers: Sequence[str], texts: Sequence[str] = ()) -> pa.Schema:
    kinds = ((integers, pa.int64()), (numbers, pa.float64()), (texts, pa.string()))
    return pa.schema([pa.field(name, kind, nullable=False) for names, kind in kinds for name in names])


_RECORDING = _schema((), ("frameRate",))
_IND = _schema(("trackId", "frame"), ("xCenter", "yCenter", "heading", "length", "width", "xVelocity", "yVelocity"))
_IND_META = _schema(("trackId",), (), ("class",))
_HIGHD = _schema(("id", "frame"), ("x", "y", "width", "height", "xVelocity", "yVelocity"))
_HIGHD_META = _schema(("id", "drivingDirection"), (), ("class",))


class LevelX:
    """The format, for the registry."""

    name = "levelx"
    title = "levelXdata CSV (inD)"
    writes = frozenset({Part.TRACKS})
    needs = frozenset({Part.TRACKS})
    reads = frozenset({Part.TRACKS})
    loses = (
        "Heights above the ground, heights of boxes and standard deviations; times are those of the nearest frame, and "
        "frames in which a road user was not tracked are missing. Positions stay in the site's own world."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """See `wibam_core.exchange.base.ExchangeFormat.write`."""
        require_parts(self, content)
        tracks = content.tracks or ()
        period_ns = motion.frame_period_ns(track.times_ns for track in tracks)
        frames = [motion.frame_numbers(track.times_ns, period_ns) for track in tracks]
        paths = [folder / f"{_PREFIX}_{table}.csv" for table in _TABLES]
        csv_files.write_columns(paths[0], _track_columns(tracks, frames))
        csv_files.write_columns(paths[1], _meta_columns(tracks, frames))
        origin = content.site.origin if content.site else None
        csv_files.write_columns(paths[2], _recording_columns(tracks, frames, period_ns, origin))
        return paths

    def read(self, path: Path) -> Content:
        """Read one recording: its ``…_tracks.csv``, or a folder that holds no other.

        Boxes stand on the ground and have the usual height of their class; standard deviations are unknown (NaN).

        Raises:
            InputError: see `wibam_core.exchange.base.ExchangeFormat.read`.
        """
        tracks_path = _tracks_file(path)
        meta_path, recording_path = (
            tracks_path.with_name(tracks_path.name.replace("_tracks.csv", f"_{table}.csv")) for table in _TABLES[1:]
        )
        rates = csv_files.read_columns(recording_path, _RECORDING, "recordingMeta")["frameRate"].to_pylist()
        if len(rates) != 1 or rates[0] <= 0:
            raise wrong(recording_path, "frameRate", "one line with a positive rate is needed")
        is_ind = "xCenter" in read_text(tracks_path).partition("\n")[0]
        states, names = (_read_ind if is_ind else _read_highd)(tracks_path, meta_path)
        known = classes_by_name(lambda names: names.levelx)
        left_out = Counter(name for name in names.values() if name not in known)
        return Content(
            tracks=states.tracks(tracks_path, {i: known.get(name) for i, name in names.items()}, float(rates[0])),
            notes=tuple(f"{count} tracks of class {name!r} are left out." for name, count in sorted(left_out.items())),
        )


def _track_columns(tracks: Sequence[Track], frames: Sequence[IntArray]) -> dict[str, np.ndarray]:
    counts = [len(track) for track in tracks]
    boxes = _joined([track.boxes for track in tracks], 7)
    velocities = _joined([track.velocities_mps for track in tracks], 2)
    accelerations = _joined([motion.accelerations_mps2(track) for track in tracks], 2)
    speeds = motion.along_and_across(velocities, boxes[:, YAW])
    forces = motion.along_and_across(accelerations, boxes[:, YAW])
    return {
        "recordingId": np.zeros(sum(counts), np.int64),
        "trackId": np.repeat(np.array([track.track_id for track in tracks], np.int64), counts),
        "frame": np.concatenate([np.empty(0, np.int64), *frames]),
        "trackLifetime": np.concatenate([np.empty(0, np.int64), *(f - f[0] for f in frames)]),
        "xCenter": boxes[:, X],
        "yCenter": boxes[:, Y],
        "heading": np.degrees(boxes[:, YAW]) % 360.0,
        "width": boxes[:, WIDTH],
        "length": boxes[:, LENGTH],
        "xVelocity": velocities[:, 0],
        "yVelocity": velocities[:, 1],
        "xAcceleration": accelerations[:, 0],
        "yAcceleration": accelerations[:, 1],
        "lonVelocity": speeds[:, 0],
        "latVelocity": speeds[:, 1],
        "lonAcceleration": forces[:, 0],
        "latAcceleration": forces[:, 1],
    }


def _meta_columns(tracks: Sequence[Track], frames: Sequence[IntArray]) -> dict[str, Sequence[object]]:
    return {
        "recordingId": [0] * len(tracks),
        "trackId": [track.track_id for track in tracks],
        "initialFrame": [int(f[0]) for f in frames],
        "finalFrame": [int(f[-1]) for f in frames],
        "numFrames": [len(f) for f in frames],
        "width": [float(np.median(track.boxes[:, WIDTH])) for track in tracks],
        "length": [float(np.median(track.boxes[:, LENGTH])) for track in tracks],
        "class": [track.vehicle_class.traits.elsewhere.levelx.written for track in tracks],
    }


def _recording_columns(
    tracks: Sequence[Track], frames: Sequence[IntArray], period_ns: int, origin: Origin | None
) -> dict[str, Sequence[object]]:
    rate_hz = 1e9 / period_ns
    vulnerable = sum(track.vehicle_class.traits.elsewhere.levelx.written in _VULNERABLE for track in tracks)
    last = max((int(f[-1]) for f in frames), default=0)
    return {
        "recordingId": [0],
        "locationId": [0],
        "frameRate": [rate_hz],
        "speedLimit": [-1.0],
        "weekday": [""],
        "startTime": [""],
        "duration": [last / rate_hz],
        "numTracks": [len(tracks)],
        "numVehicles": [len(tracks) - vulnerable],
        "numVRUs": [vulnerable],
        "latLocation": ["" if origin is None else origin.latitude_deg],
        "lonLocation": ["" if origin is None else origin.longitude_deg],
        "xUtmOrigin": [""],
        "yUtmOrigin": [""],
        "orthoPxToMeter": [1.0],
    }


def _joined(parts: Sequence[FloatArray], width: int) -> FloatArray:
    return np.concatenate([np.empty((0, width)), *parts])


def _tracks_file(path: Path) -> Path:
    found = sorted(path.glob("*_tracks.csv")) if path.is_dir() else [path]
    if len(found) != 1 or not found[0].name.endswith("_tracks.csv"):
        raise InputError(
            f"{path.name} holds {len(found) if path.is_dir() else 'no'} recordings, not one",
            hint="Name the …_tracks.csv of one recording; its …_tracksMeta.csv and …_recordingMeta.csv lie beside it.",
        )
    return found[0]


@dataclass(frozen=True, eq=False)
class _States:
    """What the tracks table says, in our frame.

    Attributes:
        ids, frames: (N,). centres_m: (N, 2). sizes_m: (N, 2) length and width. yaw_rad: (N,). velocities_mps: (N, 2).
    """

    ids: IntArray
    frames: IntArray
    centres_m: FloatArray
    sizes_m: FloatArray
    yaw_rad: FloatArray
    velocities_mps: FloatArray

    def tracks(self, path: Path, classes: Mapping[int, RoadUserClass | None], rate_hz: float) -> list[Track]:
        """Tracks by id, without those whose class is None."""
        order = np.lexsort((self.frames, self.ids))
        ids, starts = np.unique(self.ids[order], return_index=True)
        found = []
        for track_id, rows in zip(ids.tolist(), np.split(order, starts[1:]), strict=False):
            if track_id not in classes:
                raise wrong(path, "trackId", f"track {track_id} has no line in tracksMeta")
            if (road_user := classes[track_id]) is not None:
                found.append(self._track(path, track_id, road_user, rows, rate_hz))
        return found

    def _track(self, path: Path, track_id: int, road_user: RoadUserClass, rows: IntArray, rate_hz: float) -> Track:
        frames, yaw_rad = self.frames[rows], self.yaw_rad[rows]
        if (np.diff(frames) == 0).any():
            raise wrong(path, "frame", f"track {track_id} has two states in one frame")
        length_m, width_m, height_m = road_user.traits.size.size_m
        # inD gives pedestrians and cyclists no extent
        sizes = np.where(self.sizes_m[rows] > 0, self.sizes_m[rows], [length_m, width_m])
        stands = np.full((len(rows), 1), height_m)
        times_s = frames / rate_hz
        if np.abs(times_s).max() > _LATEST_S:
            raise wrong(path, "frame", f"track {track_id} lasts beyond {_LATEST_S:g} s")
        times_ns = np.rint(times_s * 1e9).astype(np.int64)
        return Track(
            track_id,
            road_user,
            times_ns,
            np.hstack([self.centres_m[rows], stands / 2, sizes, stands, normalise_angle(yaw_rad)[:, None]]),
            np.full((len(rows), 7), np.nan),
            self.velocities_mps[rows],
            motion.derivative(np.unwrap(yaw_rad), times_ns),
        )


def _read_ind(tracks_path: Path, meta_path: Path) -> tuple[_States, dict[int, str]]:
    """States, and the name of each track's class."""
    column = _columns(tracks_path, _IND, "tracks")
    meta = csv_files.read_columns(meta_path, _IND_META, "tracksMeta").to_pydict()
    states = _States(
        column["trackId"],
        column["frame"],
        np.stack([column["xCenter"], column["yCenter"]], axis=1),
        np.stack([column["length"], column["width"]], axis=1),
        np.radians(column["heading"]),
        np.stack([column["xVelocity"], column["yVelocity"]], axis=1),
    )
    return states, dict(zip(meta["trackId"], meta["class"], strict=True))


def _read_highd(tracks_path: Path, meta_path: Path) -> tuple[_States, dict[int, str]]:
    """States, and the name of each track's class."""
    column = _columns(tracks_path, _HIGHD, "tracks")
    meta = csv_files.read_columns(meta_path, _HIGHD_META, "tracksMeta").to_pydict()
    to_the_left = [i for i, way in zip(meta["id"], meta["drivingDirection"], strict=True) if way == 1]
    states = _States(
        column["id"],
        column["frame"],
        np.stack([column["x"] + column["width"] / 2, -(column["y"] + column["height"] / 2)], axis=1),
        np.stack([column["width"], column["height"]], axis=1),
        np.where(np.isin(column["id"], to_the_left), np.pi, 0.0),
        np.stack([column["xVelocity"], -column["yVelocity"]], axis=1),
    )
    return states, {i: name.lower() for i, name in zip(meta["id"], meta["class"], strict=True)}


def _columns(path: Path, schema: pa.Schema, what: str) -> dict[str, np.ndarray]:
    table = csv_files.read_columns(path, schema, what)
    return {name: table[name].to_numpy() for name in table.column_names}
