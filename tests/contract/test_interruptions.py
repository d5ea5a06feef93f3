"""Uploads when something else happens meanwhile: a silent connection, a rival, a deletion, a slow service."""

from __future__ import annotations

import hashlib
import random
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.service import TOKEN, LiveApi, wait_until
from wibam_core.adapters.files import UploadFile
from wibam_core.adapters.site_store import UploadRequest
from wibam_core.client import WibamClient, uploading
from wibam_core.errors import Conflict, Locked, NotFound, ServiceUnavailable
from wibam_core.jobs.records import Upload

DATA = random.Random(1).randbytes(2_500_000)
TUS = {"Tus-Resumable": "1.0.0"}


@pytest.fixture(scope="module")
def site(api: LiveApi) -> str:
    return api.site()


@pytest.fixture
def path(api: LiveApi, site: str) -> str:
    """An upload of `DATA` that has just begun."""
    return str(api.begin(site, len(DATA)).headers["Location"])


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "x.mp4"
    path.write_bytes(DATA)
    return path


@pytest.fixture
def client(api: LiveApi, monkeypatch: pytest.MonkeyPatch) -> Iterator[WibamClient]:
    """It does not pause for long, and puts up with a service that is away for no time at all."""
    monkeypatch.setattr(uploading, "_FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(uploading, "_LONGEST_PAUSE_S", 0.02)
    with WibamClient(api.url, TOKEN, timeout_s=300.0, patience_s=0.0) as connected:
        yield connected


@pytest.fixture
def begun(api: LiveApi, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The ids of the uploads that have begun, as they begin."""
    found: list[str] = []
    create = api.services.uploads.create

    def remembering(request: UploadRequest) -> Upload:
        upload = create(request)
        found.append(upload.id)
        return upload

    monkeypatch.setattr(api.services.uploads, "create", remembering)
    return found


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Grows whenever a request is refused because its upload is locked."""
    found: list[str] = []
    enter = UploadFile.__enter__

    def counting(self: UploadFile) -> UploadFile:
        try:
            return enter(self)
        except Locked:
            found.append("locked")
            raise

    monkeypatch.setattr(UploadFile, "__enter__", counting)
    return found


def stored_digest(client: WibamClient, site: str, camera: str) -> str:
    return next(file.sha256 for file in client.files(site) if file.camera == camera)


class TestSilence:
    @pytest.fixture(autouse=True)
    def impatient(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("api.routes.uploads._IDLE_S", 1.0)

    def test_a_connection_that_brings_nothing_more_is_given_up(self, api: LiveApi, site: str, path: str) -> None:
        address, sent = urlsplit(api.url), 1_300_000
        head = (
            f"PATCH {path} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {TOKEN}\r\nTus-Resumable: 1.0.0\r\n"
            f"Upload-Offset: 0\r\nContent-Type: application/offset+octet-stream\r\nContent-Length: {len(DATA)}\r\n\r\n"
        )
        with socket.create_connection((address.hostname, address.port), timeout=300) as connection:  # type: ignore[arg-type]
            connection.sendall(head.encode() + DATA[:sent])
            answer = b""
            while part := connection.recv(4096):  # to the end: the service hangs up
                answer += part
        assert answer.startswith(b"HTTP/1.1 408 ")
        assert b'"code":"upload_stalled"' in answer
        assert api.offset(path) == sent
        assert api.send(path, sent, DATA[sent:]).status_code == 204

    def test_the_client_takes_up_what_was_given_up(
        self,
        api: LiveApi,
        site: str,
        client: WibamClient,
        recording: Path,
        begun: list[str],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        stalled = threading.Event()
        bytes_of = uploading._bytes_of

        def stalling(path: Path, offset: int, length: int) -> Iterator[bytes]:
            for number, block in enumerate(bytes_of(path, offset, length)):
                if number == 3 and not stalled.is_set():
                    stalled.set()
                    wait_until(lambda: api.offset(f"/v1/uploads/{begun[-1]}") > 0)
                yield block

        monkeypatch.setattr(uploading, "_bytes_of", stalling)
        client.upload_recording(site, "cam1", recording)
        assert stalled.is_set()
        assert stored_digest(client, site, "cam1") == hashlib.sha256(DATA).hexdigest()


class TestRivals:
    def test_the_client_waits_while_the_upload_is_locked(
        self,
        api: LiveApi,
        site: str,
        client: WibamClient,
        recording: Path,
        begun: list[str],
        refused: list[str],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr(uploading, "_PIECE_BYTES", 1_000_000)
        rival = ExitStack()

        def hold_it_for_a_while(sent: int, size: int) -> None:
            if sent == 1_000_000 and not refused:
                rival.enter_context(UploadFile(api.services.folder, begun[-1]))
            if len(refused) > 20:
                rival.close()

        client.upload_recording(site, "cam2", recording, hold_it_for_a_while)
        assert len(refused) > 20
        assert stored_digest(client, site, "cam2") == hashlib.sha256(DATA).hexdigest()

    def test_a_deletion_that_raced_the_last_bytes_keeps_the_file(
        self, api: LiveApi, path: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        uploads, name = api.services.uploads, Path(path).name
        look, looks = uploads.sites.upload, [0]

        def complete_after_the_first_look(upload_id: str) -> object:
            found = look(upload_id)
            looks[0] += 1
            if looks[0] == 1:
                assert api.send(path, 0, DATA).status_code == 204
            return found

        monkeypatch.setattr(uploads.sites, "upload", complete_after_the_first_look)
        uploads.delete(name)
        monkeypatch.undo()
        assert (api.services.folder.root / "files" / name).read_bytes() == DATA
        with pytest.raises(NotFound):
            uploads.upload(name)

    def test_an_upload_that_has_just_advanced_is_not_tidied_away(
        self, api: LiveApi, path: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        uploads = api.services.uploads
        stale = uploads.upload(Path(path).name)
        monkeypatch.setattr(uploads.sites, "expired_uploads", lambda: [stale])
        uploads.tidy()
        assert api.send(path, 0, DATA).status_code == 204

    def test_a_site_that_is_deleted_meanwhile_ends_its_uploads(
        self, api: LiveApi, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        site = api.site()
        path = str(api.begin(site, len(DATA)).headers["Location"])
        complete = api.services.sites.complete_upload

        def deleted_first(*arguments: object, **values: object) -> object:
            assert api.http.delete(f"/v1/sites/{site}").status_code == 204
            return complete(*arguments, **values)  # type: ignore[arg-type]

        monkeypatch.setattr(api.services.sites, "complete_upload", deleted_first)
        assert api.send(path, 0, DATA).status_code == 404


class TestSlowService:
    def test_the_client_waits_while_a_long_file_is_read_again(
        self,
        api: LiveApi,
        site: str,
        client: WibamClient,
        recording: Path,
        refused: list[str],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        read_sha256 = UploadFile.read_sha256

        def slowly(self: UploadFile) -> str:
            wait_until(lambda: len(refused) > 20)
            return read_sha256(self)

        monkeypatch.setattr(api.services.uploads.digests, "take", lambda upload: None)  # as after a restart
        monkeypatch.setattr(UploadFile, "read_sha256", slowly)
        with WibamClient(api.url, TOKEN, timeout_s=2.0, patience_s=0.0) as impatient:
            impatient.upload_recording(site, "cam1", recording)
        assert len(refused) > 20
        assert stored_digest(client, site, "cam1") == hashlib.sha256(DATA).hexdigest()

    def test_a_service_that_stays_away_is_given_up(
        self, client: WibamClient, site: str, recording: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def away(*_: object) -> int:
            raise ServiceUnavailable("gone")

        monkeypatch.setattr(uploading, "_send_piece", away)
        with pytest.raises(ServiceUnavailable, match="gone"):
            client.upload_recording(site, "cam1", recording)

    def test_a_refusal_is_not_argued_with(
        self,
        api: LiveApi,
        site: str,
        client: WibamClient,
        recording: Path,
        begun: list[str],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr(uploading, "_PIECE_BYTES", 1_000_000)

        def lose_the_bytes(sent: int, size: int) -> None:
            api.services.folder.upload(begun[-1]).write_bytes(b"")

        with pytest.raises(Conflict, match="lost bytes"):
            client.upload_recording(site, "cam1", recording, lose_the_bytes)
