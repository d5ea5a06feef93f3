"""Clients that are too slow, and requests whose length is not clear."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

from api.protocol import PatientProtocol
from api.security import Gate
from tests.service import TOKEN, LiveApi, live_api, settings_for


class Impatient(PatientProtocol):
    """As the service's, in a hurry."""

    head_s = 0.3
    take_s = 0.5


@pytest.fixture(scope="module")
def hasty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApi]:
    with live_api(settings_for(tmp_path_factory.mktemp("hasty")), http=Impatient) as running:
        yield running


def connect(api: LiveApi) -> socket.socket:
    address = urlsplit(api.url)
    assert address.hostname is not None
    assert address.port is not None
    return socket.create_connection((address.hostname, address.port), timeout=300)


def everything(connection: socket.socket) -> bytes:
    found = b""
    while block := connection.recv(65536):
        found += block
    return found


def send_for_ever(connection: socket.socket, data: bytes, every_s: float = 0.0) -> None:
    while True:
        connection.sendall(data)
        time.sleep(every_s)


class TestHeads:
    @pytest.mark.parametrize("begun", [b"", b"GET /healthz HTTP/1.1\r\nHost: x\r\nX-Slow: ", b"GET"])
    def test_that_do_not_come_end_the_connection(self, hasty: LiveApi, begun: bytes) -> None:
        connections = [connect(hasty) for _ in range(100)]
        for connection in connections:
            connection.sendall(begun)
        for connection in connections:
            assert everything(connection).startswith(b"HTTP/1.1 408 ")
            connection.close()

    def test_drop_by_drop_do_not_gain_time(self, hasty: LiveApi) -> None:
        with connect(hasty) as connection, pytest.raises(ConnectionError):
            send_for_ever(connection, b"G", every_s=0.05)

    def test_a_second_request_has_its_own_time(self, hasty: LiveApi) -> None:
        with connect(hasty) as connection:
            connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
            assert connection.recv(4096).startswith(b"HTTP/1.1 200")
            connection.sendall(b"GET /healthz HTTP/1.1\r\nHost")
            assert b"HTTP/1.1 408 " in everything(connection)

    def test_one_that_came_in_time_may_be_answered_slowly(self, hasty: LiveApi) -> None:
        assert hasty.http.get("/openapi.json").status_code == 200


class TestBodies:
    def test_that_do_not_come_are_refused(self, hasty: LiveApi, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(Gate, "body_s", 0.2)
        with connect(hasty) as connection:
            head = f"POST /v1/sites HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {TOKEN}\r\n"
            connection.sendall(f"{head}Content-Type: application/json\r\nContent-Length: 100\r\n\r\n{{".encode())
            answer = everything(connection)
        assert answer.startswith(b"HTTP/1.1 408 ")
        assert b'"code":"too_slow"' in answer

    def test_of_two_lengths_are_refused(self, api: LiveApi) -> None:
        with connect(api) as connection:
            head = f"POST /v1/sites HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {TOKEN}\r\nContent-Length: 4\r\n"
            connection.sendall(f"{head}Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n".encode())
            answer = everything(connection)
        assert answer.startswith(b"HTTP/1.1 400 ")
        assert b"ambiguous_length" in answer


def test_who_does_not_take_an_answer_is_let_go(hasty: LiveApi) -> None:
    """Asks and asks, and reads nothing: first the service stops listening, then it ends the connection."""
    with connect(hasty) as connection, pytest.raises(ConnectionError):
        send_for_ever(connection, b"GET /openapi.json HTTP/1.1\r\nHost: x\r\n\r\n" * 1000)
