"""What the tus protocol (https://tus.io) wants of every response about an upload, errors too."""

from __future__ import annotations

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

TUS_VERSION = "1.0.0"
EXTENSIONS = ("creation", "expiration", "termination", "checksum")
_UPLOADS = "/v1/uploads"


class TusHeaders:
    """ASGI middleware: ``Tus-Resumable`` on all responses about uploads; ``Tus-Version`` where it was a wrong one."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not f"{scope['path']}/".startswith(f"{_UPLOADS}/"):
            await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Tus-Resumable"] = TUS_VERSION
                if message["status"] == 412:
                    headers["Tus-Version"] = TUS_VERSION
            await send(message)

        await self._app(scope, receive, send_with_headers)
