"""What is drawn or said of many tracks, in less than all their states: a summary, compact states, paths."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from wibam_core.adapters.track_query import TrackQuery, cursor_of, query_tracks
from wibam_core.documents.tracks import (
    ClassTracks,
    CompactTrack,
    CompactTracks,
    TrackPath,
    TrackPaths,
    TracksSummary,
)

#: Decimals of what is drawn: 1 cm, 1 mrad, 1 cm/s. Speeds are rounded down: as many pass a limit as without rounding.
_DECIMALS: Final = {
    **dict.fromkeys(("x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "speed_mps"), 2),
    "yaw_rad": 3,
}
#: Of how many states paths are made at most, how many corners they have together, and how many paths there are.
_PATH_STATES, _PATH_CORNERS, _PATHS = 400_000, 6_000, 1_500
#: Paths begin with the first tolerance; it is doubled while they have too many corners, up to the second.
_TOLERANCES_M: Final = (0.2, 6.4)


def summary(path: Path, query: TrackQuery) -> TracksSummary:
    """What can be said of the states that match.

    Args:
        path: a file of `wibam_core.formats.tracks`.
        query: which states; it has no limit.
    """
    classes: dict[int, str] = {}
    states: Counter[str] = Counter()
    times = [np.empty(0, np.int64)]
    low, high, fastest = np.full(2, np.inf), np.full(2, -np.inf), 0.0
    with query_tracks(path, query, ("time_ns", "track_id", "class", "x_m", "y_m", "speed_mps")) as batches:
        for batch in batches:
            times.append(np.unique(batch["time_ns"].to_numpy()))
            classes |= _classes(batch)
            for one in batch["class"].value_counts().to_pylist():
                states[one["values"]] += one["counts"]
            places = np.stack([batch["x_m"].to_numpy(), batch["y_m"].to_numpy()])
            low, high = np.minimum(low, places.min(axis=1)), np.maximum(high, places.max(axis=1))
            fastest = max(fastest, float(batch["speed_mps"].to_numpy().max()))
    instants, tracks = np.unique(np.concatenate(times)), Counter(classes.values())
    there = len(instants) > 0
    return TracksSummary(
        states=states.total(),
        tracks=len(classes),
        first_ns=int(instants[0]) if there else None,
        last_ns=int(instants[-1]) if there else None,
        period_ns=_period_ns(instants),
        fastest_mps=round(fastest, 2) if there else None,
        bounds_m=tuple(np.round([*low, *high], 2).tolist()) if there else None,
        classes=[ClassTracks(road_user_class=cls, tracks=tracks[cls], states=count) for cls, count in _most(states)],
    )


def compact(path: Path, query: TrackQuery) -> CompactTracks:
    """States that match, by track, rounded.

    Args:
        path: a file of `wibam_core.formats.tracks`.
        query: which states; it has a limit.
    """
    with query_tracks(path, query, ("time_ns", "track_id", "class", *_DECIMALS)) as batches:
        table = batches.read_all().combine_chunks()
    times = table["time_ns"].to_numpy()
    instants, at = np.unique(times, return_inverse=True)
    ids = table["track_id"].to_numpy()
    columns = {name: np.round(table[name].to_numpy(), digits) for name, digits in _DECIMALS.items()}
    columns["speed_mps"] = _rounded_down(table["speed_mps"].to_numpy(), _DECIMALS["speed_mps"])
    names = table["class"].to_pylist()
    tracks = [
        CompactTrack(
            track_id=int(ids[rows[0]]),
            road_user_class=names[rows[0]],
            at=at[rows].tolist(),
            **{name: _listed(values[rows]) for name, values in columns.items()},
        )
        for rows in _by_track(ids)
    ]
    whole = len(times) < (query.limit or np.inf)
    return CompactTracks(
        times_ns=instants.tolist(),
        tracks=tracks,
        next=None if whole else cursor_of(int(times[-1]), int(ids[-1])),
    )


def paths(path: Path, query: TrackQuery) -> TrackPaths:
    """Where those of the states that match were, as lines that can be drawn together, however many there are.

    Args:
        path: a file of `wibam_core.formats.tracks`.
        query: which states; it has no limit.
    """
    tracks, states = _counts(path, query)
    table, instants = _every(path, query, max(1, -(-states // _PATH_STATES)))
    ids = table["track_id"].to_numpy()
    places = np.stack([table["x_m"].to_numpy(), table["y_m"].to_numpy()], axis=1)
    rows = _by_track(ids)
    shown = rows[:: 1 + (len(rows) - 1) // _PATHS] if rows else []
    classes, tolerance_m = table["class"], _TOLERANCES_M[0]
    lines = [corners_of(places[of], tolerance_m) for of in shown]
    while sum(map(len, lines)) > _PATH_CORNERS and tolerance_m < _TOLERANCES_M[1]:
        tolerance_m *= 2
        lines = [corners_of(places[of], tolerance_m) for of in shown]
    return TrackPaths(
        tracks=tracks,
        tolerance_m=tolerance_m,
        period_ns=_period_ns(instants),
        paths=[
            TrackPath(
                track_id=int(ids[of[0]]),
                road_user_class=classes[of[0]].as_py(),
                x_m=line[:, 0].tolist(),
                y_m=line[:, 1].tolist(),
            )
            for of, line in zip(shown, lines, strict=True)
        ],
    )


def _counts(path: Path, query: TrackQuery) -> tuple[int, int]:
    """How many tracks match, and how many states."""
    tracks, states = np.empty(0, np.int64), 0
    with query_tracks(path, replace(query, limit=None), ("track_id",)) as batches:
        for batch in batches:
            tracks = np.union1d(tracks, batch["track_id"].to_numpy())
            states += len(batch)
    return len(tracks), states


def _every(path: Path, query: TrackQuery, step: int) -> tuple[pa.Table, np.ndarray]:
    """States of every so many-th instant, and these instants."""
    parts, instants, before, number = [], [], None, -1
    with query_tracks(path, replace(query, limit=None), ("time_ns", "track_id", "class", "x_m", "y_m")) as batches:
        schema = batches.schema
        for batch in batches:
            times, at = np.unique(batch["time_ns"].to_numpy(), return_inverse=True)
            first = number if before == times[0] else number + 1  # a batch may go on with an instant
            taken = (first + np.arange(len(times))) % step == 0
            parts.append(batch.filter(pa.array(taken[at])))
            instants.append(times[taken])
            before, number = times[-1], first + len(times) - 1
    table = pa.Table.from_batches(parts, schema).combine_chunks()
    return table, np.unique(np.concatenate([np.empty(0, np.int64), *instants]))


def corners_of(line: np.ndarray, tolerance_m: float) -> np.ndarray:
    """Few of the points of a line, rounded to 1 cm, with no point farther than the tolerance from what connects them.

    From both ends on, the point that lies farthest from the straight piece beside it becomes a corner, until none lies
    too far (D. H. Douglas and T. K. Peucker, 1973). Distances are from pieces and not from endless lines: a line may
    turn back, or end where it began.

    Args:
        line: (N, 2) m, N ≥ 1.
        tolerance_m: at least 0.01, since corners are rounded.

    Returns:
        (K, 2) m, in their order; one corner where the whole line is as near as that to where it begins.
    """
    rounded = np.round(line, 2)
    if np.hypot(*(line - rounded[0]).T).max() <= min(tolerance_m, _TOLERANCES_M[0]):
        return rounded[:1]
    kept, pieces = {0, len(line) - 1}, [(0, len(line) - 1)]
    while pieces:
        first, last = pieces.pop()
        between = line[first + 1 : last] - rounded[first]
        if not len(between):
            continue
        along = rounded[last] - rounded[first]
        share = np.clip(between @ along / max(along @ along, 1e-9), 0.0, 1.0)
        off = np.hypot(*(between - share[:, None] * along).T)
        if off.max() > tolerance_m:
            middle = first + 1 + int(off.argmax())
            kept.add(middle)
            pieces += [(first, middle), (middle, last)]
    return rounded[sorted(kept)]


def _by_track(ids: np.ndarray) -> list[np.ndarray]:
    """Rows of each track, ascending; tracks by id."""
    order = np.argsort(ids, kind="stable")
    return [rows for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1) if len(rows)]


def _classes(batch: pa.RecordBatch) -> dict[int, str]:
    """Track -> class."""
    pairs = (
        pa.table({name: batch[name] for name in ("track_id", "class")}).group_by(["track_id", "class"]).aggregate([])
    )
    return dict(zip(pairs["track_id"].to_pylist(), pairs["class"].to_pylist(), strict=True))


def _most(counts: Counter[str]) -> list[tuple[str, int]]:
    return sorted(counts.items(), key=lambda one: (-one[1], one[0]))


def _period_ns(instants: np.ndarray) -> int | None:
    return int(np.median(np.diff(instants))) if len(instants) > 1 else None


def _rounded_down(values: np.ndarray, digits: int) -> np.ndarray:
    nearest = np.round(values, digits)
    return np.where(nearest > values, np.round(nearest - 10.0**-digits, digits), nearest)


def _listed(values: np.ndarray) -> list[Any]:
    return values[:1].tolist() if (values == values[0]).all() else values.tolist()
