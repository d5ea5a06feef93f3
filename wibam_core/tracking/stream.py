"""Tracks of footage without end: given out piece by piece, while those still in view are followed on.

A road user's track is smoothed when it has left. One that stays, at a red light or at the kerb, is smoothed once it
has been in view for long, and given out up to some time ago; what comes then is a piece with the same id. So memory
depends on how many are in view, not on how long the footage is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wibam_core.config import TrackConfig
from wibam_core.errors import InputError
from wibam_core.geometry.box3d import SIZE, YAW, Z
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import Track, Vehicles3D
from wibam_core.tracking.tracker import Tracker
from wibam_core.tracking.trajectory import Hit, to_tracks

Array = NDArray[np.float64]

#: States are given out once so much more was seen after them: later measurements change them no more.
LAG_S = 60.0
#: One slower than this stands, m/s: its front is where it was in the piece before.
_STANDING_MPS = 1.0
_NONE = np.iinfo(np.int64).min


@dataclass(frozen=True, eq=False)
class _Said:
    """What was given out of a track that goes on: its id, up to when, and what it was then said to be."""

    track_id: int
    until_ns: int
    number: int
    size: Array
    yaw: float

    @property
    def road_user_class(self) -> RoadUserClass:
        return CLASSES[self.number]


class TrackStream:
    """Feed it instant by instant with `step`, ask now and then for what is `settled`, and at last for all `ended`.

    Ids rise in the order in which tracks are first given out.

    Args:
        config: thresholds.
        lag_s: how much is seen after a state before it is given out.
    """

    def __init__(self, config: TrackConfig, lag_s: float = LAG_S) -> None:
        self._tracker = Tracker(config)
        self._lag_ns = round(lag_s * 1e9)
        self._next_id = 0
        #: What was given out of those still followed, by the identity of the list of what was seen of them.
        self._said: dict[int, _Said] = {}

    def step(
        self, time_ns: int, detections: Sequence[Vehicles3D], frame_times_ns: Mapping[str, int] | None = None
    ) -> None:
        """Take in one instant: see `Tracker.step`."""
        self._tracker.step(time_ns, detections, frame_times_ns)

    def settled(self) -> list[Track]:
        """What is new and changes no more: whole tracks, and pieces of those that go on.

        The pieces of a track have the same id, class and size, and ascend in time.
        """
        found = self._pieces(self._tracker.take_ended(), whole=True)
        instants = self._tracker.instants
        if not len(instants):
            return found
        settled_ns = int(instants[-1]) - self._lag_ns
        long = [hits for hits in self._tracker.active if hits[0].time_ns < settled_ns - self._lag_ns]
        found += self._pieces(long, whole=False, until_ns=settled_ns)
        for hits in long:
            # what is kept of it warms the smoother up for the next piece
            old = sum(hit.time_ns < settled_ns - self._lag_ns // 2 for hit in hits)
            del hits[: min(old, len(hits) - 1)]
        begun = [hits[0].time_ns for hits in self._tracker.active]
        self._tracker.forget_instants(min([settled_ns, *begun]))
        return found

    @property
    def pending_ns(self) -> int:
        """No state before this time is still to come."""
        instants, active = self._tracker.instants, self._tracker.active
        if not len(instants):
            return _NONE
        begun = [self._said[id(hits)].until_ns + 1 if id(hits) in self._said else hits[0].time_ns for hits in active]
        return min([int(instants[-1]) + 1, *begun])

    @property
    def last_ns(self) -> int | None:
        """The last instant that was taken in; None before the first."""
        instants = self._tracker.instants
        return int(instants[-1]) if len(instants) else None

    def ended(self) -> list[Track]:
        """What is still to be said of all tracks, as if there were no more footage.

        Where there is more, a stream that goes on (`of_arrays`) from what this one says afterwards (`to_arrays`) gives
        the same road users the same ids.
        """
        found = self._pieces(self._tracker.take_ended(), whole=True)
        return found + self._pieces(list(self._tracker.active), whole=False)

    # --- going on ------------------------------------------------------------------------------
    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """All that another stream needs to go on with the same tracks: arrays by name."""
        said = [self._said.get(id(hits)) for hits in self._tracker.active]
        nobody = _Said(-1, _NONE, 0, np.zeros(3), 0.0)
        rows = [one or nobody for one in said]
        return {
            **self._tracker.to_arrays(),
            "next_id": np.array([self._next_id], np.int64),
            "said_ids": np.array([one.track_id for one in rows], np.int64),
            "said_until_ns": np.array([one.until_ns for one in rows], np.int64),
            "said_classes": np.array([one.number for one in rows], np.int64),
            "said_sizes": np.array([one.size for one in rows], np.float64).reshape(len(rows), 3),
            "said_yaws": np.array([one.yaw for one in rows], np.float64),
        }

    def go_on(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Follow on those that another stream followed when it gave these arrays, under their ids.

        Raises:
            ValueError: they have another shape than this version's.
        """
        self._tracker.go_on(arrays)
        self._next_id = int(arrays["next_id"][0])
        self._said = {
            id(hits): _Said(int(track_id), int(until_ns), int(number), size, float(yaw))
            for hits, track_id, until_ns, number, size, yaw in zip(
                self._tracker.active,
                *(arrays[f"said_{name}"] for name in ("ids", "until_ns", "classes", "sizes", "yaws")),
                strict=True,
            )
            if track_id >= 0
        }

    # --- pieces --------------------------------------------------------------------------------
    def _pieces(self, seen: Sequence[list[Hit]], *, whole: bool, until_ns: int | None = None) -> list[Track]:
        """What is new of road users, up to a time; of those of which nothing was said yet, if they are proven."""
        kept = [hits for hits in seen if id(hits) in self._said or self._tracker.is_proven(hits)]
        found = []
        for hits, track in zip(kept, to_tracks(kept, self._tracker.instants), strict=True):
            before = self._said.get(id(hits))
            piece = self._piece(track, before, until_ns)
            if piece is not None:
                found.append(piece)
                last = _Said(
                    piece.track_id,
                    int(piece.times_ns[-1]),
                    piece.vehicle_class.number,
                    piece.boxes[-1, SIZE].copy(),
                    float(piece.boxes[-1, YAW]),
                )
                self._said[id(hits)] = last
        if whole:
            for hits in seen:
                self._said.pop(id(hits), None)
        return found

    def _piece(self, track: Track, before: _Said | None, until_ns: int | None) -> Track | None:
        """A track's states after those that were given out, and up to a time."""
        new = np.ones(len(track), bool) if until_ns is None else track.times_ns <= until_ns
        if before is not None:
            new &= track.times_ns > before.until_ns
        if not new.any():
            return None
        boxes = track.boxes[new].copy()
        if before is None:
            track_id, road_user = self._next_id, track.vehicle_class
            self._next_id += 1
        else:
            track_id, road_user = before.track_id, before.road_user_class
            boxes[:, SIZE], boxes[:, Z] = before.size, before.size[2] / 2
            stands = np.hypot(*track.velocities_mps[new].T).max() < _STANDING_MPS
            if stands and np.cos(boxes[0, YAW] - before.yaw) < 0:
                boxes[:, YAW] = normalise_angle(boxes[:, YAW] + np.pi)
        return replace(
            track,
            track_id=track_id,
            vehicle_class=road_user,
            times_ns=track.times_ns[new],
            boxes=boxes,
            sd=track.sd[new],
            velocities_mps=track.velocities_mps[new],
            yaw_rates_radps=track.yaw_rates_radps[new],
        )


def write_stream(path: Path, stream: TrackStream) -> None:
    """Write what another stream needs to go on: an ``.npz`` of arrays, whole or not at all."""
    partial = path.with_name(path.name + ".tmp")
    with partial.open("wb") as file:
        np.savez(file, **stream.to_arrays())  # type: ignore[arg-type]  # names are the arrays'
    partial.replace(path)


def read_stream(path: Path, config: TrackConfig, lag_s: float = LAG_S) -> TrackStream:
    """A stream that goes on where the written one was, with the thresholds and the lag of a `TrackStream`.

    Raises:
        InputError: the file is not of this kind, or another version wrote it.
    """
    stream = TrackStream(config, lag_s)
    try:
        with np.load(path, allow_pickle=False) as arrays:
            stream.go_on(dict(arrays))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"{path.name} does not hold tracks to go on with: {error}",
            hint="Start the run without a run that it continues; its tracks then have ids of their own.",
        ) from error
    return stream
