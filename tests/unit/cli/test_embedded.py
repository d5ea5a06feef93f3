"""The embedded service's children, with stand-ins for them; the real ones are in tests/integration."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from tests.service import wait_until
from wibam_core.cli import embedded
from wibam_core.errors import Conflict, ServiceUnavailable

SLEEPS = [sys.executable, "-c", "import time; time.sleep(600)"]
DIES = [sys.executable, "-c", "print('no more'); raise SystemExit(3)"]


@pytest.fixture
def family(tmp_path: Path) -> Iterator[embedded._Family]:
    with embedded._Family(tmp_path, {}) as family:
        yield family


def process_of(family: embedded._Family, name: str) -> int:
    return family._children[name][2].pid


class TestFamily:
    def test_one_that_keeps_dying_is_told_and_the_others_live_on(self, family: embedded._Family) -> None:
        family.start("redis", SLEEPS)
        first = process_of(family, "redis")
        family.supervise()
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: process_of(family, "redis") != first)  # the supervisor's child now
        family.start("worker", DIES)
        wait_until(lambda: family.failure is not None)
        assert family.failure is not None
        assert "worker" in family.failure.message
        assert "no more" in family.failure.details["log_tail"]
        wait_until(lambda: family._children["worker"][2].poll() is not None)
        assert family._supervisor.is_alive(), "its children would die with it"
        assert family._children["redis"][2].poll() is None

    def test_one_that_cannot_be_restarted_is_told(
        self, family: embedded._Family, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fail(*_: object) -> None:
            raise OSError("no more processes")

        family.start("worker", DIES)
        monkeypatch.setattr(family, "start", fail)
        family.supervise()
        wait_until(lambda: family.failure is not None)
        assert family._supervisor.is_alive()

    def test_children_are_asked_before_they_are_killed(self, tmp_path: Path) -> None:
        polite = "import signal, sys, time; signal.signal(15, lambda *_: sys.exit(print('bye', flush=True)));"
        polite += "print('up', flush=True); time.sleep(600)"
        log = tmp_path / "worker.log"
        with embedded._Family(tmp_path, {}) as family:
            family.start("worker", [sys.executable, "-c", polite])
            wait_until(lambda: log.read_text().count("up") == 1)
            family.supervise()
            os.kill(process_of(family, "worker"), signal.SIGKILL)
            wait_until(lambda: log.read_text().count("up") == 2)  # the supervisor's child
        assert log.read_text().count("bye") == 1


def test_readiness_is_not_asked_through_a_proxy(family: embedded._Family, monkeypatch: pytest.MonkeyPatch) -> None:
    class Ready(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    monkeypatch.setattr(embedded, "_PATIENCE_S", 300.0)
    with HTTPServer(("127.0.0.1", 0), Ready) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        embedded._wait_until_ready(f"http://127.0.0.1:{server.server_port}", family)
        server.shutdown()


def test_a_taken_port_is_told_once() -> None:
    with embedded._listen("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(Conflict) as refused:
            embedded._listen("127.0.0.1", port)
    assert refused.value.message == f"cannot listen on 127.0.0.1:{port}: Address already in use"


@pytest.mark.parametrize(("python", "hint"), [((3, 11), "wibam[embedded]"), ((3, 13), "Python 3.11 or 3.12")])
def test_without_a_redis_the_hint_says_how_to_get_one(
    python: tuple[int, int], hint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(embedded.shutil, "which", lambda name: None)
    monkeypatch.setattr(embedded.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(embedded.sys, "version_info", python)
    with pytest.raises(ServiceUnavailable, match="no redis-server") as caught:
        embedded._redis_program()
    assert "Install redis-server" in caught.value.hint
    assert hint in caught.value.hint
