"""How fast questions about many tracks are answered, and in how much memory.

``python -m benchmarks.queries --rows 10000000``: makes a file of so many states, as the service keeps them, and asks
for a minute in a box, for one track, for the first page and a deep one; beside it, duckdb alone on the same file. Then
it takes all states, as a download does. Times are CPU seconds of this process (user and system), which other work on
the machine does not change.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from wibam_core.adapters.track_query import TrackQuery, query_tracks
from wibam_core.formats.tracks import GROUP_ROWS, SCHEMA

_AT_ONCE = 50  # road users in view
_LIFE = 200  # instants of a track
_PERIOD_NS = 100_000_000
_MINUTE_NS = 60 * 10**9


def write(path: Path, rows: int) -> None:
    """States of vehicles that drive around within 60 m, ten a second."""
    rng = np.random.default_rng(0)
    with pq.ParquetWriter(path, SCHEMA, compression="zstd") as writer:
        for start in range(0, rows, GROUP_ROWS):
            index = np.arange(start, min(start + GROUP_ROWS, rows))
            instant, slot = np.divmod(index, _AT_ONCE)
            columns: dict[str, pa.Array] = {}
            for field in SCHEMA:
                if field.name == "time_ns":
                    columns[field.name] = pa.array(instant * _PERIOD_NS)
                elif field.name == "track_id":
                    columns[field.name] = pa.array(instant // _LIFE * _AT_ONCE + slot)
                elif field.name == "class":
                    columns[field.name] = pa.array(np.where(slot % 5, "car", "truck")).cast(field.type)
                else:
                    columns[field.name] = pa.array(rng.normal(0.0, 30.0, len(index)).round(3))
            writer.write_table(pa.table(columns, schema=SCHEMA), row_group_size=GROUP_ROWS)


def p95_ms(act: Callable[[], object], rounds: int) -> float:
    """The 95th percentile of the CPU time (ms); the first call, which opens files, does not count."""
    act()
    taken = []
    for _ in range(rounds):
        started = time.process_time()
        act()
        taken.append(1000.0 * (time.process_time() - started))
    return float(np.percentile(taken, 95))


def count(path: Path, query: TrackQuery) -> int:
    with query_tracks(path, query) as batches:
        return sum(len(batch) for batch in batches)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--rounds", type=int, default=20)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tracks.parquet"
        write(path, arguments.rows)
        middle = arguments.rows // _AT_ONCE // 2 * _PERIOD_NS
        track = arguments.rows // _AT_ONCE // _LIFE // 2 * _AT_ONCE
        print(f"{arguments.rows:,} rows, {path.stat().st_size / 1e6:.0f} MB")
        raw = duckdb.connect()
        box = "x_m BETWEEN -10 AND 10 AND y_m BETWEEN -10 AND 10"
        minute = f"time_ns >= {middle} AND time_ns < {middle + _MINUTE_NS}"
        beside = {
            "a minute in a box": f"{minute} AND {box}",
            "one track": f"track_id = {track}",
        }
        queries = {
            "a minute in a box": TrackQuery(
                start_ns=middle, end_ns=middle + _MINUTE_NS, bounds=(-10.0, -10.0, 10.0, 10.0)
            ),
            "one track": TrackQuery(track_ids=(track,)),
            "first page": TrackQuery(limit=1000),
            "deep page": TrackQuery(limit=1000, after=(2 * middle - _MINUTE_NS, 0)),
        }
        print("| question | states | p95, CPU ms | duckdb alone |\n|---|---|---|---|")
        for name, query in queries.items():
            ours = p95_ms(lambda query=query: count(path, query), arguments.rounds)  # type: ignore[misc]
            alone = "–"
            if name in beside:
                sql = f"SELECT * FROM '{path}' WHERE {beside[name]} ORDER BY time_ns, track_id"
                alone = f"{p95_ms(lambda sql=sql: raw.sql(sql).to_arrow_table(), arguments.rounds):.0f}"  # type: ignore[misc]
            print(f"| {name} | {count(path, query):,} | {ours:.0f} | {alone} |", flush=True)
        raw.close()
        before = _peak_mb()
        started = time.process_time()
        taken = count(path, TrackQuery())
        print(
            f"all {taken:,}: {time.process_time() - started:.1f} s CPU, peak memory {before:.0f} -> {_peak_mb():.0f} MB"
        )


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


if __name__ == "__main__":
    main()
