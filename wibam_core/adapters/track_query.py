"""Questions about tracks, answered from the Parquet file by an in-memory duckdb."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq

from wibam_core.errors import InputError
from wibam_core.road_users import RoadUserClass

_MOST_CORNERS = 100
_BATCH_ROWS = 20_000
_CONFIG: dict[str, str | bool | int | float | list[str]] = {
    "threads": 1,
    "memory_limit": "256MB",
    "temp_directory": "",
    "preserve_insertion_order": True,
    "autoload_known_extensions": False,
    "autoinstall_known_extensions": False,
}
#: What conditions look at.
_RESTRICTED = ("time_ns", "track_id", "class", "x_m", "y_m", "speed_mps")
_BOUNDS = "x_min,y_min,x_max,y_max in m, for example -10,-10,10,10"
_POLYGON = "corners x1,y1;x2,y2;x3,y3 in m, for example 0,0;10,0;10,10"
Point = tuple[float, float]


@dataclass(frozen=True)
class TrackQuery:
    """Which states of which vehicles. What is left out does not restrict; everything together must hold.

    Attributes:
        start_ns, end_ns: reference clock, the start counts in, the end does not.
        bounds: x min, y min, x max, y max in m. polygon: corners in m, in order; states inside count.
        classes: of vehicles. track_ids: which tracks. min_speed_mps: slower states are left out.
        after: the (time_ns, track_id) of the last state that was seen already.
        limit: how many states at most.
    """

    start_ns: int | None = None
    end_ns: int | None = None
    bounds: tuple[float, float, float, float] | None = None
    polygon: tuple[Point, ...] = ()
    classes: tuple[RoadUserClass, ...] = ()
    track_ids: tuple[int, ...] = ()
    min_speed_mps: float | None = None
    after: tuple[int, int] | None = None
    limit: int | None = None

    def __post_init__(self) -> None:
        if self.bounds is not None and not (self.bounds[0] < self.bounds[2] and self.bounds[1] < self.bounds[3]):
            raise InputError("the bounds are empty", hint=f"Give {_BOUNDS}.")
        if self.polygon and not 3 <= len(self.polygon) <= _MOST_CORNERS:
            raise InputError(
                f"a polygon has 3 to {_MOST_CORNERS} corners, not {len(self.polygon)}", hint=f"Give {_POLYGON}."
            )
        if self.limit is not None and self.limit < 1:
            raise InputError("the limit must be at least 1", hint="Leave it out for all states.")


def parse_bounds(text: str) -> tuple[float, float, float, float]:
    """``"x_min,y_min,x_max,y_max"`` in m.

    Raises:
        InputError: it is not four numbers.
    """
    numbers = _numbers(text, "bounds", _BOUNDS)
    if len(numbers) != 4:
        raise InputError(f"bounds are four numbers, not {len(numbers)}", hint=f"Give {_BOUNDS}.")
    return (numbers[0], numbers[1], numbers[2], numbers[3])


def parse_polygon(text: str) -> tuple[Point, ...]:
    """``"x1,y1;x2,y2;x3,y3"`` in m.

    Raises:
        InputError: it is not a list of points.
    """
    corners = [_numbers(corner, "polygon", _POLYGON) for corner in text.split(";")]
    if any(len(corner) != 2 for corner in corners):
        raise InputError("every corner of a polygon is two numbers", hint=f"Give {_POLYGON}.")
    return tuple((corner[0], corner[1]) for corner in corners)


def parse_cursor(text: str) -> tuple[int, int]:
    """What `cursor_of` made.

    Raises:
        InputError: it is something else.
    """
    found = re.fullmatch(r"(-?\d{1,19})_(-?\d{1,19})", text)
    if not found:
        raise InputError(f"{text!r} is no cursor", hint="Use the value of 'next' from the page before.")
    return int(found[1]), int(found[2])


def cursor_of(time_ns: int, track_id: int) -> str:
    """Where the next page begins."""
    return f"{time_ns}_{track_id}"


@contextmanager
def query_tracks(path: Path, query: TrackQuery, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatchReader]:
    """The states that match, sorted by time, then track, in batches of bounded size.

    They are read while they are taken: whoever stops taking them stops the query, and memory does not grow with their
    number. Of the file, the parts that cannot hold any are not read: it is sorted, and says of each what times and
    tracks are in it.

    Args:
        path: a file of `wibam_core.formats.tracks`.
        query: which states.
        columns: which of their columns, in this order; None: all.
    """
    with pq.ParquetFile(path, pre_buffer=False) as file, _engine().cursor() as connection:
        schema = _plain_schema(file.schema_arrow)
        if columns is not None:
            schema = pa.schema([schema.field(name) for name in columns])
        yield pa.RecordBatchReader.from_batches(schema, _matching(file, schema, connection, query))


def _matching(
    file: pq.ParquetFile, schema: pa.Schema, connection: duckdb.DuckDBPyConnection, query: TrackQuery
) -> Iterator[pa.RecordBatch]:
    restricting, values = conditions(query)
    where = f"WHERE {' AND '.join(restricting)}" if restricting else ""
    names = ", ".join(f'"{name}"' for name in schema.names)
    sql = f"SELECT {names} FROM states {where}"  # in the order of the file: preserve_insertion_order
    left = query.limit
    read = list(dict.fromkeys((*schema.names, *_RESTRICTED)))
    for part in _parts(file, _row_groups(file.metadata, query), read):
        connection.register("states", pa.Table.from_batches([part]))
        found = connection.sql(sql, params=values).to_arrow_table().cast(schema)
        connection.unregister("states")
        if left is not None:
            found = found.slice(0, left)
            left -= len(found)
        yield from found.to_batches()
        if left == 0:
            return


def _parts(file: pq.ParquetFile, groups: list[int], columns: list[str]) -> Iterator[pa.RecordBatch]:
    for group in groups:  # one by one: together they would be read ahead
        yield from file.iter_batches(_BATCH_ROWS, row_groups=[group], columns=columns, use_threads=False)


def _row_groups(metadata: pq.FileMetaData, query: TrackQuery) -> list[int]:
    """Those that may hold states of the query, by the statistics of the file."""
    start = max((t for t in (query.start_ns, query.after[0] if query.after else None) if t is not None), default=None)
    names = [metadata.schema.column(column).name for column in range(metadata.num_columns)]
    found = []
    for group in range(metadata.num_row_groups):
        times = metadata.row_group(group).column(names.index("time_ns")).statistics
        tracks = metadata.row_group(group).column(names.index("track_id")).statistics
        if times is not None and times.has_min_max:
            if start is not None and times.max < start:
                continue
            if query.end_ns is not None and times.min >= query.end_ns:
                continue
        among = tracks is None or not tracks.has_min_max or not query.track_ids
        if among or any(tracks.min <= track_id <= tracks.max for track_id in query.track_ids):
            found.append(group)
    return found


def _plain_schema(schema: pa.Schema) -> pa.Schema:
    """Without dictionaries, which not every reader of an answer knows."""
    plain = [field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field for field in schema]
    return pa.schema([pa.field(field.name, field.type) for field in plain])


@cache
def _engine() -> duckdb.DuckDBPyConnection:
    """One a process, for all queries: it bounds their memory together. Queries have cursors of their own."""
    return duckdb.connect(":memory:", config=_CONFIG)


def conditions(query: TrackQuery) -> tuple[list[str], list[Any]]:
    """The query as conditions in SQL, all of which must hold, and their parameters."""
    found: list[str] = []
    values: list[Any] = []

    def add(condition: str, *of: Any) -> None:
        found.append(condition)
        values.extend(of)

    if query.start_ns is not None:
        add("time_ns >= ?", query.start_ns)
    if query.end_ns is not None:
        add("time_ns < ?", query.end_ns)
    if query.bounds is not None:
        x0, y0, x1, y1 = query.bounds
        add("x_m BETWEEN ? AND ? AND y_m BETWEEN ? AND ?", x0, x1, y0, y1)
    if query.polygon:
        add(*_inside(query.polygon))
    if query.classes:
        add(f"class::VARCHAR IN ({_marks(query.classes)})", *(cls.value for cls in query.classes))
    if query.track_ids:
        add(f"track_id IN ({_marks(query.track_ids)})", *query.track_ids)
    if query.min_speed_mps is not None:
        add("speed_mps >= ?", query.min_speed_mps)
    if query.after is not None:
        add("(time_ns > ? OR (time_ns = ? AND track_id > ?))", query.after[0], query.after[0], query.after[1])
    return found, values


def _inside(polygon: tuple[Point, ...]) -> tuple[Any, ...]:
    """Even-odd rule: a ray along +X crosses the polygon's edges an odd number of times."""
    crossings, values = [], []
    for (x0, y0), (x1, y1) in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        if y0 == y1:
            continue
        crossings.append("CAST((y_m >= ?) != (y_m >= ?) AND x_m < ? + (y_m - ?) * ? AS INTEGER)")
        values += [y0, y1, x0, y0, (x1 - x0) / (y1 - y0)]
    return (f"({' + '.join(crossings) or '0'}) % 2 = 1", *values)


def _marks(items: tuple[Any, ...]) -> str:
    return ", ".join("?" * len(items))


def _numbers(text: str, what: str, form: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{what}: {text!r} is not a list of numbers", hint=f"Give {form}.") from None
    if not all(abs(number) < 1e9 for number in numbers):
        raise InputError(f"{what}: {text!r} has numbers out of range", hint=f"Give {form}.")
    return numbers
