"""What the tus protocol (https://tus.io) wants of every response about an upload, errors too."""

from __future__ import annotations

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

TUS_VERSION = "1.0.0"
EXTENSIONS = ("creation", "creation-with-upload", "expiration", "termination", "checksum")
TUS_RESPONSE_HEADERS = (
    "Tus-Resumable", "Tus-Version", "Tus-Extension", "Tus-Checksum-Algorithm",
    "Upload-Offset", "Upload-Length", "Upload-Expires", "Upload-Metadata",
)  # fmt: skip
_UPLOADS = "/v1/uploads"


#: Methods that a client may name in a header of a POST, where what lies between knows only GET and POST.
_OVERRIDABLE = ("PATCH", "DELETE", "HEAD")


class TusHeaders:
    """ASGI middleware: ``Tus-Resumable`` on all responses about uploads; ``Tus-Version`` where it was a wrong one.

    A POST with ``X-HTTP-Method-Override`` is taken for the method that it names, as the protocol demands.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not f"{scope['path']}/".startswith(f"{_UPLOADS}/"):
            await self._app(scope, receive, send)
            return

        method = Headers(scope=scope).get("x-http-method-override", "").upper()
        if scope["method"] == "POST" and method in _OVERRIDABLE:
            scope = {**scope, "method": method}

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Tus-Resumable"] = TUS_VERSION
                if message["status"] == 412:
                    headers["Tus-Version"] = TUS_VERSION
            await send(message)

        await self._app(scope, receive, send_with_headers)
