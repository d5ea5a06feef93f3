"""Questions about tracks in a file of many parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from wibam_core.adapters.track_query import TrackQuery, query_tracks
from wibam_core.formats.tracks import SCHEMA
from wibam_core.road_users import RoadUserClass

ROWS, AT_ONCE, GROUP = 3000, 5, 100


@pytest.fixture(scope="module")
def table() -> pa.Table:
    rng = np.random.default_rng(0)
    instant, slot = np.divmod(np.arange(ROWS), AT_ONCE)
    known = {"time_ns": instant * 10**8, "track_id": instant // 50 * AT_ONCE + slot}
    columns = {
        field.name: pa.array(np.where(slot == 1, "truck", "car")).cast(field.type)
        if field.name == "class"
        else pa.array(known.get(field.name, rng.normal(0.0, 20.0, ROWS)))
        for field in SCHEMA
    }
    return pa.table(columns, schema=SCHEMA)


@pytest.fixture(scope="module")
def path(table: pa.Table, tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("tracks") / "tracks.parquet"
    pq.write_table(table, found, row_group_size=GROUP)
    return found


def ask(path: Path, query: TrackQuery) -> list[tuple[int, int]]:
    with query_tracks(path, query) as batches:
        return [(row["time_ns"], row["track_id"]) for batch in batches for row in batch.to_pylist()]


@pytest.mark.parametrize(
    "query",
    [
        TrackQuery(),
        TrackQuery(start_ns=10 * 10**8, end_ns=400 * 10**8),
        TrackQuery(track_ids=(0, 7, 31)),
        TrackQuery(bounds=(-5.0, -10.0, 20.0, 3.0), min_speed_mps=4.0),
        TrackQuery(classes=(RoadUserClass.TRUCK,), start_ns=590 * 10**8),
        TrackQuery(after=(123 * 10**8, 12), limit=17),
        TrackQuery(track_ids=(31,), after=(340 * 10**8, 31)),
        TrackQuery(start_ns=10**15),
        TrackQuery(limit=ROWS + 1),
    ],
    ids=str,
)
def test_the_answer_is_that_of_looking_at_every_row(path: Path, table: pa.Table, query: TrackQuery) -> None:
    rows = table.to_pylist()
    wanted = [
        (row["time_ns"], row["track_id"])
        for row in rows
        if (query.start_ns is None or row["time_ns"] >= query.start_ns)
        and (query.end_ns is None or row["time_ns"] < query.end_ns)
        and (not query.track_ids or row["track_id"] in query.track_ids)
        and (not query.classes or row["class"] in {cls.value for cls in query.classes})
        and (query.min_speed_mps is None or row["speed_mps"] >= query.min_speed_mps)
        and (query.after is None or (row["time_ns"], row["track_id"]) > query.after)
        and (
            query.bounds is None
            or (query.bounds[0] <= row["x_m"] <= query.bounds[2] and query.bounds[1] <= row["y_m"] <= query.bounds[3])
        )
    ]
    assert ask(path, query) == wanted[: query.limit]


def test_pages_are_the_whole(path: Path) -> None:
    found: list[tuple[int, int]] = []
    while page := ask(path, TrackQuery(limit=700, after=found[-1] if found else None)):
        found += page
    assert found == ask(path, TrackQuery())


def damaged_but(path: Path, folder: Path, *whole: int) -> Path:
    """A copy of which these parts alone can be read."""
    data = bytearray(path.read_bytes())
    metadata = pq.read_metadata(path)
    for group in set(range(metadata.num_row_groups)) - set(whole):
        for column in range(metadata.num_columns):
            chunk = metadata.row_group(group).column(column)
            start = chunk.dictionary_page_offset or chunk.data_page_offset
            data[start : start + chunk.total_compressed_size] = bytes(chunk.total_compressed_size)
    copy = folder / "damaged.parquet"
    copy.write_bytes(data)
    return copy


def test_parts_that_cannot_hold_an_answer_are_not_read(path: Path, tmp_path: Path) -> None:
    damaged = damaged_but(path, tmp_path, 10, 11)  # instants 200 to 239, tracks 20 to 24
    with pytest.raises(OSError, match="page header"):
        ask(damaged, TrackQuery())
    for query in (
        TrackQuery(start_ns=200 * 10**8, end_ns=240 * 10**8),
        TrackQuery(after=(200 * 10**8, 21), limit=50),
    ):
        assert ask(damaged, query) == ask(path, query)


def test_whoever_stops_taking_stops_the_reading(path: Path, tmp_path: Path) -> None:
    with query_tracks(damaged_but(path, tmp_path, 0), TrackQuery()) as batches:
        assert len(batches.read_next_batch()) == GROUP
        with pytest.raises(OSError, match="page header"):
            batches.read_next_batch()
