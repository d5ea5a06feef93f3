"""A real API on a real socket, in this process, and a site to send to it."""

from __future__ import annotations

import socket
import threading
import time
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx
import uvicorn

from api.__main__ import server_config
from api.main import create_app
from api.services import Services
from tests.builders import corner_rig, site_of
from wibam_core.adapters.database import sqlite_url
from wibam_core.adapters.settings import ServiceSettings, token_digest

TOKEN = "a-token-for-tests"


def settings_for(data_dir: Path, **changes: Any) -> ServiceSettings:
    """Settings of a service in a folder, without a broker."""
    settings = ServiceSettings(
        data_dir=data_dir,
        database_url=sqlite_url(data_dir / "wibam.db"),
        broker_url=f"redis+socket://{data_dir}/absent.sock",
        token_sha256=token_digest(TOKEN),
    )
    return replace(settings, **changes)


@dataclass
class LiveApi:
    """Attributes: ``http`` sends the token; ``services`` are those of the running application."""

    url: str
    http: httpx.Client
    services: Services

    def site(self, cameras: int = 2) -> str:
        """Create a site with cameras cam1, cam2, ...; returns its id."""
        response = self.http.post("/v1/sites", json=site_of(corner_rig(cameras)).model_dump(mode="json"))
        assert response.status_code == 201, response.text
        return str(response.json()["id"])

    def begin(
        self,
        site: str,
        length: int,
        camera: str = "cam1",
        body: bytes | None = None,
        extra: Mapping[str, str] | None = None,
        **metadata: str,
    ) -> httpx.Response:
        """The tus creation request of a recording, with its first bytes and headers of one's own if need be."""
        values = {"site": site, "purpose": "recording", "camera": camera, "filename": "x.mp4", **metadata}
        header = ",".join(f"{key} {b64encode(value.encode()).decode()}" for key, value in values.items() if value)
        headers = {"Tus-Resumable": "1.0.0", "Upload-Length": str(length), "Upload-Metadata": header}
        if body is not None:
            headers["Content-Type"] = "application/offset+octet-stream"
        return self.http.post("/v1/uploads", headers={**headers, **(extra or {})}, content=body)

    def send(self, path: str, offset: int, data: Any, **headers: str) -> httpx.Response:
        """A tus PATCH."""
        fixed = {
            "tus-resumable": "1.0.0",
            "upload-offset": str(offset),
            "content-type": "application/offset+octet-stream",
        }
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        return self.http.patch(path, content=data, headers={**fixed, **named})

    def offset(self, path: str) -> int:
        response = self.http.head(path, headers={"Tus-Resumable": "1.0.0"})
        assert response.status_code == 200, response.status_code
        return int(response.headers["Upload-Offset"])

    def upload(self, site: str, data: bytes, camera: str = "cam1", **metadata: str) -> None:
        """A whole file in one piece."""
        begun = self.begin(site, len(data), camera, **metadata)
        assert begun.status_code == 201, begun.text
        assert self.send(begun.headers["Location"], 0, data).status_code == 204


@contextmanager
def live_api(settings: ServiceSettings, port: int = 0, **serving: Any) -> Iterator[LiveApi]:
    """Serve until the block ends, on a free port unless one is given."""
    app = create_app(settings)
    listener = socket.create_server(("127.0.0.1", port))
    server = uvicorn.Server(server_config(app, **{"timeout_graceful_shutdown": 2, **serving}))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    try:
        wait_until(lambda: server.started or not thread.is_alive())
        assert server.started, "the API did not start"
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {TOKEN}"}, timeout=300) as http:
            yield LiveApi(url, http, app.state.services)
    finally:
        server.should_exit = True
        thread.join(timeout=120)
    assert not thread.is_alive()


def wait_until(condition: Callable[[], bool], seconds: float = 600.0) -> None:
    """Look again and again until it is so; fail when it takes far too long."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it has not come about"
        time.sleep(0.02)
