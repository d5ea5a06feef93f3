"""HTTP connections that do not wait for ever: who is too slow to ask, or to take the answer, is let go."""

from __future__ import annotations

import asyncio

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

#: How long a request's head may take, from the connection or from its first byte on.
HEAD_S = 20.0
#: How long a client may take none of an answer that waits for it.
TAKE_S = 60.0
_TOO_SLOW = b"HTTP/1.1 408 Request Timeout\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


class PatientProtocol(H11Protocol):
    """uvicorn's, which waits for a request's head for as long as a client likes, and for a client to read.

    Bodies have bounds of their own: `api.security` for small ones, `api.routes.uploads` for pieces of uploads.
    """

    head_s = HEAD_S
    take_s = TAKE_S
    _head_timer: asyncio.TimerHandle | None = None
    _take_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._head_timer = self.loop.call_later(self.head_s, self._too_slow_to_ask)

    def connection_lost(self, exc: Exception | None) -> None:
        self._disarm_head()
        self.resume_writing()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._disarm_head()
        elif self._head_timer is None:  # the next request on a connection that was kept has begun
            self._head_timer = self.loop.call_later(self.head_s, self._too_slow_to_ask)

    def pause_writing(self) -> None:
        super().pause_writing()
        if self._take_timer is None:
            self._take_timer = self.loop.call_later(self.take_s, self.transport.abort)

    def resume_writing(self) -> None:
        if self._take_timer is not None:
            self._take_timer.cancel()
            self._take_timer = None
        super().resume_writing()

    def _disarm_head(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _too_slow_to_ask(self) -> None:
        self._head_timer = None
        if not self.transport.is_closing():
            self.transport.write(_TOO_SLOW)
            self.transport.close()
