"""Tables on their way to a client, block by block."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from wibam_core.formats.outlet import Outlet

Opened = AbstractContextManager[pa.RecordBatchReader]


def as_csv(opened: Opened) -> Iterator[bytes]:
    """Batches of a query as CSV; the query is opened when the first block is asked for."""
    with opened as batches:
        header = io.BytesIO()
        pyarrow.csv.write_csv(batches.schema.empty_table(), header)
        yield header.getvalue()
        for batch in batches:
            buffer = io.BytesIO()
            pyarrow.csv.write_csv(batch, buffer, pyarrow.csv.WriteOptions(include_header=False))
            yield buffer.getvalue()


def as_parquet(opened: Opened) -> Iterator[bytes]:
    """The same as Parquet."""
    outlet = Outlet()
    with opened as batches:
        with pyarrow.parquet.ParquetWriter(outlet, batches.schema, compression="zstd") as writer:
            for batch in batches:
                writer.write_batch(batch)
                yield outlet.take()
        yield outlet.take()


#: Name of a format -> how it is written, and its media type.
STREAMS: dict[str, tuple[Callable[[Opened], Iterator[bytes]], str]] = {
    "csv": (as_csv, "text/csv; charset=utf-8"),
    "parquet": (as_parquet, "application/vnd.apache.parquet"),
}
