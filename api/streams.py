"""Tables on their way to a client, block by block."""

from __future__ import annotations

import io
import mimetypes
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

import anyio
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from wibam_core.formats.outlet import Outlet

BINARY = "application/octet-stream"
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


class BlocksResponse(StreamingResponse):
    """Sends a file block by block, and closes what makes it however the sending ends.

    Args:
        blocks: its content.
        name: of the file, for the client.
        close: called in the end, in a thread.
        size_bytes: None: unknown until it is whole.
    """

    def __init__(
        self, blocks: Iterator[bytes], name: str, close: Callable[[], None], size_bytes: int | None = None
    ) -> None:
        headers = {
            "Content-Disposition": f'attachment; filename="{name}"',
            "X-Content-Type-Options": "nosniff",
            "Content-Security-Policy": "sandbox",
            **({} if size_bytes is None else {"Content-Length": str(size_bytes)}),
        }
        super().__init__(blocks, media_type=mimetypes.guess_type(name)[0] or BINARY, headers=headers)
        self._close = close

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            with anyio.CancelScope(shield=True):
                await run_in_threadpool(self._close)


#: Name of a format -> how it is written, and its media type.
STREAMS: dict[str, tuple[Callable[[Opened], Iterator[bytes]], str]] = {
    "csv": (as_csv, "text/csv; charset=utf-8"),
    "parquet": (as_parquet, "application/vnd.apache.parquet"),
}
