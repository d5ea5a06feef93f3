"""What is kept of every request: an id in logs and problems, figures, and a line of audit for every change."""

from __future__ import annotations

import logging
import re
import secrets
from collections.abc import Callable

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access import REQUEST_ID, SAFE, Visit, begin_visit, current_visit
from api.figures import Figures
from wibam_core.adapters.audit_store import AuditStore
from wibam_core.errors import WibamError

_PLAIN = re.compile(r"[A-Za-z0-9._-]{1,64}")
_PIECE_OF_AN_UPLOAD = re.compile(r"/v1/uploads/[^/]+")
_NO_CHANGE = re.compile(r"/v1/calibration/.*|/v1/(sites|jobs)/[^/]+/plan")
_log = logging.getLogger(__name__)


class Telemetry:
    """ASGI middleware, the outermost: names requests, and keeps who changed what.

    A client's ``X-Request-ID`` is kept if it is plain. Of uploads, the beginning and the deletion are changes, their
    pieces are not told one by one.

    Args:
        app: what lies behind.
        audit: where changes are written down.
        figures: where requests are counted.
    """

    def __init__(self, app: ASGIApp, audit: AuditStore, figures: Figures) -> None:
        self._app = app
        self._figures = figures
        self._audit = audit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        asked = Headers(scope=scope).get(REQUEST_ID, "")
        visit = Visit(asked if _PLAIN.fullmatch(asked) else secrets.token_hex(8))
        begin_visit(scope, visit)
        status, noted = 500, False

        async def note_once() -> None:
            nonlocal noted
            if not noted and visit.who and _changes(scope):
                noted = True
                await run_in_threadpool(self._note, scope, visit, status)

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[REQUEST_ID] = visit.request_id
            elif not message.get("more_body", False):
                await note_once()  # whoever has the answer finds the line
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            visit.problem = visit.problem or WibamError.code  # which answer is made of it, further out
            raise
        finally:
            self._figures.answered(scope["method"], status, visit.problem)
            await note_once()

    def _note(self, scope: Scope, visit: Visit, status: int) -> None:
        what = f"{scope['method']} {scope['path']}"
        peer = scope.get("client")
        try:
            self._audit.write(visit.who, what, status, visit.request_id, peer[0] if peer else "")
        except Exception:  # the change is made; that it cannot be written down is for the service's log
            _log.exception("no line of audit for %s by %s: %d", what, visit.who, status)


def name_requests_in_logs(make: Callable[..., logging.LogRecord] | None = None) -> None:
    """From now on every log record of this process has a ``request_id``, "-" outside of requests."""
    before = make or logging.getLogRecordFactory()

    def record(*arguments: object, **values: object) -> logging.LogRecord:
        found = before(*arguments, **values)
        visit = current_visit.get()
        found.request_id = visit.request_id if visit is not None else "-"
        return found

    logging.setLogRecordFactory(record)


def _changes(scope: Scope) -> bool:
    method, path = scope["method"], scope["path"]
    if method in (*SAFE, "OPTIONS") or _NO_CHANGE.fullmatch(path):
        return False
    return not (method == "PATCH" and _PIECE_OF_AN_UPLOAD.fullmatch(path))
