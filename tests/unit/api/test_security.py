from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from starlette.types import Message, Receive, Scope, Send

from api.problems import STATUS, status_of
from api.routes.uploads import parse_checksum, parse_metadata
from api.security import Gate
from api.sessions import Passes, ReportLinks
from wibam_core.adapters.database import Database, sqlite_url
from wibam_core.adapters.key_store import KeyStore
from wibam_core.adapters.settings import token_digest
from wibam_core.errors import ChecksumMismatch, InputError, MissingCamera, StageCrashed, Unauthorised, WibamError


class TestReportLinks:
    def test_work_until_they_expire(self) -> None:
        now = [1000.0]
        links = ReportLinks("secret", lifetime_s=60.0, now=lambda: now[0])
        expires, signature = links.sign("job_1")
        links.verify("job_1", expires, signature)
        now[0] += 61.0
        with pytest.raises(Unauthorised):
            links.verify("job_1", expires, signature)

    def test_another_service_cannot_make_them(self) -> None:
        expires, signature = ReportLinks("other").sign("job_1")
        with pytest.raises(Unauthorised):
            ReportLinks("secret").verify("job_1", expires, signature)


@pytest.mark.parametrize(
    ("path", "query", "status"), [("/v1/jobs/a\0b", b"", 404), ("/reports/x", b"signature=%00", 422)]
)
def test_a_nul_in_an_address_reaches_no_route(path: str, query: bytes, status: int, tmp_path: Path) -> None:
    keys = KeyStore(Database(sqlite_url(tmp_path / "wibam.db")))

    async def no_route(scope: Scope, receive: Receive, send: Send) -> None:
        raise AssertionError("it came through")

    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        return {"type": "http.request", "body": b""}

    headers = [(b"authorization", b"Bearer t")]
    scope = {"type": "http", "method": "GET", "path": path, "query_string": query, "headers": headers}
    asyncio.run(Gate(no_route, token_digest("t"), Passes("s"), keys)(scope, receive, send))
    assert sent[0]["status"] == status


class TestStatuses:
    def test_every_mapped_code_is_of_an_error_that_exists(self) -> None:
        for code in STATUS:
            assert type(WibamError.from_dict({"code": code})) is not WibamError, code

    def test_what_a_user_gave_is_422_and_what_we_broke_is_500(self) -> None:
        assert status_of(MissingCamera("x")) == 422
        assert status_of(StageCrashed("x")) == 500
        assert status_of(WibamError("x")) == 500


class TestTusHeaders:
    def test_metadata(self) -> None:
        assert parse_metadata("a eA==,b w6Q=, c") == {"a": "x", "b": "ä", "c": ""}
        assert parse_metadata("") == {}
        for wrong in ("a eA", "a /w=="):
            with pytest.raises(InputError):
                parse_metadata(wrong)

    def test_checksum(self) -> None:
        checksum = parse_checksum("sha1 Lve95gjOVATpfV8EL5X4nxwjKHE=")
        checksum.update(b"Hello World!")
        checksum.verify()
        checksum.update(b"!")
        with pytest.raises(ChecksumMismatch):
            checksum.verify()
