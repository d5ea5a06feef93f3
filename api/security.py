"""Who may come in, and how much they may bring: decided before a byte of the body is read."""

from __future__ import annotations

import asyncio
import hmac
import time
from urllib.parse import unquote_to_bytes

from sqlalchemy.exc import OperationalError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access import GUEST, PAGE, SAFE, TOKEN, is_protected, needed_scope, visit_of
from api.problems import database_problem, problem
from api.sessions import PAGE_HEADER, Passes, parse_cookies
from wibam_core.adapters.key_store import PREFIX, KeyStore
from wibam_core.adapters.settings import token_digest
from wibam_core.errors import Forbidden, InputError, NotFound, TooLarge, Unauthorised, WibamError

_UPLOADS = "/v1/uploads/"
#: Of pieces of uploads, as tus has it.
UPLOAD_CONTENT_TYPE = "application/offset+octet-stream"
_JOBS = "/v1/jobs/"


class AmbiguousLength(InputError):
    code = "ambiguous_length"

    def __init__(self) -> None:
        super().__init__(
            "the request has both Content-Length and Transfer-Encoding", hint="Send one of the two (RFC 9112, 6.3)."
        )


class CrossSite(WibamError):
    code = "cross_site"
    default_hint = "Send the token instead: Authorization: Bearer TOKEN."


class Gate:
    """ASGI middleware: what `is_protected` needs the token, or a browser's pass in its place; bodies other than
    uploads are bounded.

    A key opens what its scopes say (`api.access`). With a session (`api.sessions`) a browser may do everything, but a
    change only from our own pages. With a link to a job it may read that job.

    Args:
        app: what lies behind.
        token_sha256: SHA-256 (hex) of the token.
        passes: of browsers.
        keys: that stand in for the token.
        max_body_bytes: of a request that is no piece of an upload.

    Attributes:
        body_s: how long such a body may take.
    """

    body_s = 60.0

    def __init__(
        self,
        app: ASGIApp,
        token_sha256: str,
        passes: Passes,
        keys: KeyStore,
        max_body_bytes: int = 4_000_000,
    ) -> None:
        self._app = app
        self._token_sha256 = token_sha256
        self._passes = passes
        self._keys = keys
        self._max_body_bytes = max_body_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if "content-length" in headers and "transfer-encoding" in headers:
            # a proxy in between may have understood another length than we do
            await problem(AmbiguousLength(), headers={"Connection": "close"})(scope, receive, send)
            return
        if is_protected(scope["method"], scope["path"]):
            try:
                who = await self._who(scope, headers)
            except WibamError as refusal:
                await problem(refusal)(scope, receive, send)
                return
            except OperationalError as error:
                await database_problem(error)(scope, receive, send)
                return
            _is(scope, who)
        if (senseless := _nul(scope)) is not None:
            await problem(senseless)(scope, receive, send)
            return
        if _brings_a_file(scope, headers):
            await self._app(scope, receive, send)
            return
        length = headers.get("content-length", "")
        if length.isdecimal() and int(length) > self._max_body_bytes:
            await problem(self._too_large())(scope, receive, send)
            return
        await self._app(scope, self._bounded(receive), send)

    async def _who(self, scope: Scope, headers: Headers) -> str:
        """Who comes in; see `api.access.Visit`.

        Raises:
            Unauthorised, Forbidden, CrossSite: they may not.
        """
        if "authorization" in headers:
            return await self._bearer(scope, headers["authorization"])
        cookies = parse_cookies(headers.get("cookie", ""))
        reads = scope["method"] in SAFE
        if self._passes.is_session(cookies):
            if not (reads or PAGE_HEADER in headers):
                raise CrossSite(f"a browser's change came without the header {PAGE_HEADER}")
            return PAGE
        job_id = scope["path"].removeprefix(_JOBS).partition("/")[0] if scope["path"].startswith(_JOBS) else ""
        if job_id and reads and self._passes.may_read(job_id, cookies):
            return GUEST
        raise Unauthorised("the API token is missing or wrong")

    async def _bearer(self, scope: Scope, authorization: str) -> str:
        scheme, _, secret = authorization.partition(" ")
        secret = secret.strip()
        if scheme.lower() == "bearer":
            if hmac.compare_digest(token_digest(secret), self._token_sha256):
                return TOKEN
            key = await run_in_threadpool(self._keys.find, secret) if secret.startswith(PREFIX) else None
            if key is not None:
                needed = needed_scope(scope["method"], scope["path"])
                if not key.may(needed):
                    _is(scope, key.id)  # what a key is refused is told, too
                    raise Forbidden(
                        f"the key {key.id} has no scope {needed}",
                        hint=f"This takes a key with the scope {needed}: {needed.meaning}.",
                        scope=needed.value,
                    )
                return key.id
        raise Unauthorised("the API token is missing or wrong")

    def _bounded(self, receive: Receive) -> Receive:
        received, more = 0, True
        deadline = time.monotonic() + self.body_s

        async def bounded() -> Message:
            nonlocal received, more
            try:
                # the last message, that the client has gone, may come at any time
                left_s = deadline - time.monotonic() if more else None
                message = await asyncio.wait_for(receive(), left_s)
            except TimeoutError:
                raise BodyTooSlow(self.body_s) from None
            received += len(message.get("body", b""))
            more = message.get("more_body", False)
            if received > self._max_body_bytes:
                raise BodyTooLarge(self._too_large())
            return message

        return bounded

    def _too_large(self) -> TooLarge:
        return TooLarge(
            f"the body is larger than {self._max_body_bytes / 1e6:g} MB",
            hint="Send files in pieces through /v1/uploads (tus); only they may be larger.",
        )


def _is(scope: Scope, who: str) -> None:
    if (visit := visit_of(scope)) is not None:
        visit.who = who


class BodyTooSlow(HTTPException):
    """As `BodyTooLarge`."""

    def __init__(self, allowed_s: float) -> None:
        super().__init__(408, f"the body did not come within {allowed_s:g} s", {"Connection": "close"})
        self.hint = "Send files in pieces through /v1/uploads (tus); only they may take longer."


class BodyTooLarge(HTTPException):
    """FastAPI hands HTTP exceptions on from the reading of a body; of all others it makes a 400."""

    def __init__(self, error: TooLarge) -> None:
        super().__init__(413, error.message)
        self.hint = error.hint


def _brings_a_file(scope: Scope, headers: Headers) -> bool:
    """Whether the body is a piece of an upload, which has bounds of its own."""
    if scope["method"] == "PATCH":
        return bool(scope["path"].startswith(_UPLOADS))
    kind = headers.get("content-type", "").split(";")[0].strip().lower()
    return scope["method"] == "POST" and scope["path"] == _UPLOADS.rstrip("/") and kind == UPLOAD_CONTENT_TYPE


def _nul(scope: Scope) -> WibamError | None:
    """Why an address with a NUL in it leads nowhere: no id and no parameter has one, and PostgreSQL takes none."""
    if "\0" in scope["path"]:
        return NotFound("nothing has an address with a NUL in it", hint="Leave %00 out of the address.")
    if b"\0" in unquote_to_bytes(scope["query_string"]):
        return InputError("no parameter has a NUL in it", hint="Leave %00 out of the address.")
    return None
