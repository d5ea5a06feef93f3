"""One table of tracks per site: those of all its runs, and of its jobs, on the one clock that all share.

Only dated tracks are in it: those of footage of which it is known when it began. The table is a folder of Parquet files
by day (UTC) and camera, ``<site>/day=2026-07-01/camera=north/<run>-<address>.parquet``, each sorted by time; a row in
the database says that a run's part is whole.
"""

from __future__ import annotations

import logging
import secrets
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from sqlalchemy import delete, select

from wibam_core.adapters.database import Database
from wibam_core.adapters.files import DataFolder, unchanged_since
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.models import JobRow, SiteTracksRow, StageRow
from wibam_core.adapters.planning import are_dated
from wibam_core.adapters.results import JobResults
from wibam_core.adapters.track_query import TrackQuery, conditions
from wibam_core.artifacts.catalogue import TRACKS
from wibam_core.errors import WibamError
from wibam_core.formats.tracks import SCHEMA
from wibam_core.jobs.records import Job
from wibam_core.jobs.states import StageState

_log = logging.getLogger(__name__)
_DAY_NS = 86_400_000_000_000
_BATCH_ROWS = 65_536
_WITH_OUTPUTS = [state.value for state in StageState if state.has_outputs]
_LONGEST_LABEL = 100
#: How folders of what is being made begin: of a table's files, of what a question sorts on the disk.
_PARTIAL = ".partial-"
_ID = pa.dictionary(pa.int32(), pa.string())
#: The columns of a job's tracks, and whose they are. ``first_run_id`` and ``track_id`` together name a road user.
SITE_SCHEMA = pa.schema(
    [*SCHEMA, *(pa.field(name, _ID, nullable=False) for name in ("run_id", "first_run_id", "camera"))]
)

Bin = Literal["hour", "day", "month"]


@dataclass(frozen=True)
class SitePart:
    """What one run, or job, has in its site's table.

    Attributes:
        run_id: which. first_run_id: the first of the runs that go on with each other; with it, a track's id names one
            road user.
        model_id: the network; None: the job's own.
        cameras: whose footage it is. camera: these as the table names them.
        start_ns, end_ns: first and last state, Unix time. states: how many there are.
    """

    run_id: str
    first_run_id: str
    model_id: str | None
    cameras: tuple[str, ...]
    camera: str
    start_ns: int
    end_ns: int
    states: int
    stage_hash: str


@dataclass(frozen=True)
class SiteQuery:
    """Which states of a site's table; what is left out does not restrict.

    Attributes:
        states: as in a job's own tracks; its cursor is not used.
        cameras: tracks of footage of one of these, alone or with others.
        runs, models: of these.
        after: the (time, run, track) of the last state that was seen already.
    """

    states: TrackQuery
    cameras: tuple[str, ...] = ()
    runs: tuple[str, ...] = ()
    models: tuple[str, ...] = ()
    after: tuple[int, str, int] | None = None


@dataclass(frozen=True)
class Count:
    """Road users of one class in one hour, day or month: how many, and how fast on average (m/s)."""

    start: datetime
    road_user_class: str
    road_users: int
    mean_speed_mps: float


class SiteTracks:
    """The tables of all sites.

    Args:
        database: migrated.
        jobs, results, folder: of the service.
    """

    def __init__(self, database: Database, jobs: JobStore, results: JobResults, folder: DataFolder) -> None:
        self._database = database
        self._jobs = jobs
        self._results = results
        self._root = folder.site_tracks
        self._given_up: set[tuple[str, str]] = set()

    # --- what is in it -------------------------------------------------------------------------
    def parts(self, site_id: str) -> list[SitePart]:
        """All that a site's table consists of, by time."""
        ordered = select(SiteTracksRow).where(SiteTracksRow.site_id == site_id).order_by(SiteTracksRow.start_ns)
        with self._database.reading() as session:
            return [_part(row) for row in session.scalars(ordered)]

    def take_in_all(self) -> None:
        """Take in the tracks of all runs and jobs that have some on the one clock, and forget those that are gone."""
        for job_id, stage_hash in self._to_take_in():
            try:
                self.take_in(self._jobs.job(job_id))
            except OSError as error:  # the next round tries again
                _log.warning("the tracks of %s could not be taken into the site's table: %s", job_id, error)
            except (WibamError, pa.ArrowException) as error:
                _log.warning("the tracks of %s cannot be taken into the site's table: %s", job_id, error)
                self._given_up.add((job_id, stage_hash))

    def take_in(self, job: Job) -> None:
        """Take the tracks of a run or job into its site's table, in place of those that it had there."""
        stage = job.stage(TRACKS.stage)
        assert stage is not None
        camera, first = _label(job.site.camera_ids), self._first_of(job)
        span: tuple[int, int] | None = None
        states = 0
        if are_dated(job.files):
            source = self._results.file(job, TRACKS).path
            whose = {"run_id": job.id, "first_run_id": first, "camera": camera}
            span, states = self._write(job, stage.hash, source, whose)
        with self._database.writing(exclusive=True) as session:
            if session.get(JobRow, job.id) is None:
                return
            session.execute(delete(SiteTracksRow).where(SiteTracksRow.job_id == job.id))
            session.add(
                SiteTracksRow(
                    job_id=job.id,
                    site_id=job.site_id,
                    stage_hash=stage.hash,
                    first_run_id=first,
                    model_id=job.model_id,
                    cameras=list(job.site.camera_ids),
                    start_ns=span[0] if span is not None else 0,
                    end_ns=span[1] if span is not None else -1,
                    states=states,
                )
            )

    def tidy(self, older_than_s: float = 3600.0) -> None:
        """Remove the files of runs and jobs that are gone, of tracks that were made anew, and of killed attempts.

        Args:
            older_than_s: a younger file may be on its way into the table.
        """
        limit = time.time() - older_than_s
        files = [path for path in self._root.glob("*/day=*/camera=*/*.parquet") if unchanged_since(path, limit)]
        attempts = [path for path in self._root.glob(f"{_PARTIAL}*") if unchanged_since(path, limit)]
        with self._database.reading() as session:
            known = {(row.job_id, row.stage_hash) for row in session.scalars(select(SiteTracksRow))}
        names = {_file_name(job_id, stage_hash) for job_id, stage_hash in known}
        for path in files:
            if path.name not in names:
                path.unlink(missing_ok=True)
        for path in attempts:
            if all(unchanged_since(file, limit) for file in path.glob("*")):
                shutil.rmtree(path, ignore_errors=True)

    def _to_take_in(self, limit: int = 20) -> list[tuple[str, str]]:
        """Id, and address of the tracks."""
        tracked = (
            select(StageRow.job_id, StageRow.hash)
            .outerjoin(
                SiteTracksRow,
                (SiteTracksRow.job_id == StageRow.job_id) & (SiteTracksRow.stage_hash == StageRow.hash),
            )
            .where(StageRow.name == TRACKS.stage, StageRow.state.in_(_WITH_OUTPUTS), SiteTracksRow.job_id.is_(None))
            .limit(limit + len(self._given_up))
        )
        with self._database.reading() as session:
            found = [(job_id, stage_hash) for job_id, stage_hash in session.execute(tracked)]
        return [one for one in found if one not in self._given_up][:limit]

    def _first_of(self, job: Job) -> str:
        """The first of the runs that go on with each other; the oldest that is still known."""
        seen = {job.id}
        while job.continues is not None and job.continues not in seen:
            seen.add(job.continues)
            with self._database.reading() as session:
                row = session.get(SiteTracksRow, job.continues)
                if row is not None:
                    return row.first_run_id
            try:
                job = self._jobs.job(job.continues)
            except WibamError:
                return str(job.continues)
        return job.id

    def _write(
        self, job: Job, stage_hash: str, source: Path, whose: Mapping[str, str]
    ) -> tuple[tuple[int, int] | None, int]:
        """One file a day; returns the first and last time, and how many states there are."""
        file_name = _file_name(job.id, stage_hash)
        writers: dict[int, pq.ParquetWriter] = {}
        partial = self._root / f"{_PARTIAL}{secrets.token_hex(8)}"
        partial.mkdir(parents=True)
        first = last = None
        states = 0
        try:
            for batch in pq.ParquetFile(source).iter_batches(_BATCH_ROWS):
                table = pa.Table.from_batches([batch]).cast(SCHEMA)
                for name, value in whose.items():
                    codes = pa.array(np.zeros(table.num_rows, np.int32))
                    column = pa.DictionaryArray.from_arrays(codes, pa.array([value]))
                    table = table.append_column(SITE_SCHEMA.field(name), column)
                times = table["time_ns"]
                states += table.num_rows
                if not table.num_rows:
                    continue
                first = times[0].as_py() if first is None else first
                last = times[-1].as_py()
                days = pc.divide(times, _DAY_NS)
                for day in pc.unique(days).to_pylist():
                    if day not in writers:
                        writers[day] = pq.ParquetWriter(partial / f"{day}.parquet", SITE_SCHEMA, compression="zstd")
                    writers[day].write_table(table.filter(pc.equal(days, day)))
            for writer in writers.values():
                writer.close()
            for day in writers:
                folder = self._root / job.site_id / f"day={_date_of(day)}" / f"camera={whose['camera']}"
                folder.mkdir(parents=True, exist_ok=True)
                (partial / f"{day}.parquet").replace(folder / file_name)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        return (None if first is None or last is None else (first, last)), states

    # --- questions -----------------------------------------------------------------------------
    @contextmanager
    def query(self, site_id: str, query: SiteQuery) -> Iterator[pa.RecordBatchReader]:
        """The states that match, sorted by time, run and track, in batches of bounded size.

        The columns are those of a job's tracks, then ``run_id``, ``first_run_id`` and ``camera``.
        """
        matching = self._matching(site_id, query)
        if matching is None:
            yield pa.RecordBatchReader.from_batches(SITE_SCHEMA, [])
            return
        limit = f" LIMIT {int(query.states.limit)}" if query.states.limit is not None else ""
        with self._connection() as connection:
            ordered = f"{matching[0]} ORDER BY time_ns, run_id, track_id{limit}"
            yield connection.sql(ordered, params=matching[1]).to_arrow_reader(_BATCH_ROWS)

    def counts(self, site_id: str, query: SiteQuery, by: Bin) -> list[Count]:
        """Road users by class in each hour, day or month (UTC) in which any was seen, in order."""
        matching = self._matching(site_id, query)
        if matching is None:
            return []
        counted = (
            f"SELECT date_trunc('{by}', make_timestamp(time_ns // 1000)) AS start, class::VARCHAR AS class, "
            "count(DISTINCT (first_run_id, track_id)) AS users, avg(speed_mps) AS speed "
            f"FROM ({matching[0]}) GROUP BY ALL ORDER BY ALL"
        )
        with self._connection() as connection:
            rows = connection.execute(counted, matching[1]).fetchall()
        return [
            Count(start.replace(tzinfo=UTC), str(name), int(users), float(speed)) for start, name, users, speed in rows
        ]

    def _matching(self, site_id: str, query: SiteQuery) -> tuple[str, list[Any]] | None:
        """SQL for the states that match, and its parameters; None where no file has any."""
        paths = [
            str(path)
            for part in self.parts(site_id)
            if _may_match(part, query)
            for path in self._files(site_id, part, query.states)
        ]
        if not paths:
            return None
        where, values = conditions(replace(query.states, after=None))
        if query.after is not None:
            where.append("(time_ns, run_id, track_id) > (?, ?, ?)")
            values += query.after
        sql = "SELECT * FROM read_parquet(?, hive_partitioning = false)"
        return f"{sql} WHERE {' AND '.join(where)}" if where else sql, [paths, *values]

    @contextmanager
    def _connection(self) -> Iterator[duckdb.DuckDBPyConnection]:
        """Of its own, in bounded memory; what does not fit is sorted on the data folder's disk."""
        spilled = self._root / f"{_PARTIAL}{secrets.token_hex(8)}"
        try:
            config = {"threads": 1, "memory_limit": "512MB", "temp_directory": str(spilled)}
            with duckdb.connect(":memory:", config=config) as connection:
                yield connection
        finally:
            shutil.rmtree(spilled, ignore_errors=True)

    def _files(self, site_id: str, part: SitePart, states: TrackQuery) -> Iterator[Path]:
        first = max(part.start_ns, states.start_ns if states.start_ns is not None else part.start_ns)
        last = min(part.end_ns, states.end_ns - 1 if states.end_ns is not None else part.end_ns)
        name = _file_name(part.run_id, part.stage_hash)
        for day in range(first // _DAY_NS, last // _DAY_NS + 1):
            path = self._root / site_id / f"day={_date_of(day)}" / f"camera={part.camera}" / name
            if path.is_file():
                yield path


def _part(row: SiteTracksRow) -> SitePart:
    return SitePart(
        row.job_id,
        row.first_run_id,
        row.model_id,
        tuple(row.cameras),
        _label(row.cameras),
        row.start_ns,
        row.end_ns,
        row.states,
        row.stage_hash,
    )


def _may_match(part: SitePart, query: SiteQuery) -> bool:
    states = query.states
    return (
        part.states > 0
        and (states.start_ns is None or part.end_ns >= states.start_ns)
        and (states.end_ns is None or part.start_ns < states.end_ns)
        and (not query.cameras or bool(set(query.cameras) & set(part.cameras)))
        and (not query.runs or part.run_id in query.runs)
        and (not query.models or part.model_id in query.models)
    )


def _label(cameras: Sequence[str]) -> str:
    """What the table calls the cameras of fused tracks."""
    label = "+".join(sorted(cameras))
    return label if len(label) <= _LONGEST_LABEL else f"{len(cameras)}-cameras"


def _file_name(job_id: str, stage_hash: str) -> str:
    return f"{job_id}-{stage_hash[:16]}.parquet"


def _date_of(day: int) -> str:
    return (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(days=day)).date().isoformat()
