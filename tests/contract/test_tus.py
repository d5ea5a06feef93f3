"""The tus 1.0 protocol over real HTTP: with the public client, and with clients that break off, race and lie."""

from __future__ import annotations

import hashlib
import os
import random
import socket
import threading
import time
from base64 import b64encode
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from tusclient.client import TusClient

from tests.service import TOKEN, LiveApi, live_api, settings_for, wait_until
from wibam_core.adapters.files import UploadFile
from wibam_core.errors import Locked

DATA = random.Random(0).randbytes(3_000_000)
TUS = {"Tus-Resumable": "1.0.0"}


@pytest.fixture(scope="module")
def site(api: LiveApi) -> str:
    return api.site()


def recordings(api: LiveApi, site: str) -> dict[str, dict]:
    return {item["camera"]: item for item in api.http.get(f"/v1/sites/{site}/recordings").json()}


def begin(api: LiveApi, site: str, data: bytes = DATA, **values: str) -> str:
    response = api.begin(site, len(data), **values)
    assert response.status_code == 201, response.text
    return str(response.headers["Location"])


def bytes_on_disk(api: LiveApi, path: str) -> int:
    return api.services.folder.upload(Path(path).name).stat().st_size


def is_locked(api: LiveApi, path: str) -> bool:
    """Whether a request is still writing to the upload. It locks the upload itself to find out."""
    try:
        with UploadFile(api.services.folder, Path(path).name):
            return False
    except Locked:
        return True


def stored_bytes(api: LiveApi, path: str) -> bytes:
    return (api.services.folder.root / "files" / Path(path).name).read_bytes()


class TestPublicClient:
    def client(self, api: LiveApi) -> TusClient:
        return TusClient(f"{api.url}/v1/uploads", headers={"Authorization": f"Bearer {TOKEN}"})

    @pytest.mark.parametrize("checksums", [False, True])
    def test_uploads_in_pieces(self, api: LiveApi, site: str, tmp_path: Path, checksums: bool) -> None:
        path = tmp_path / "a.mp4"
        path.write_bytes(DATA)
        metadata = {"site": site, "purpose": "recording", "camera": "cam1", "filename": "a.mp4"}
        uploader = self.client(api).uploader(
            str(path), chunk_size=700_000, metadata=metadata, upload_checksum=checksums
        )
        uploader.upload()
        found = recordings(api, site)["cam1"]
        assert found["sha256"] == hashlib.sha256(DATA).hexdigest()
        assert found["size_bytes"] == len(DATA)
        assert found["filename"] == "a.mp4"
        assert stored_bytes(api, uploader.url) == DATA

    def test_a_new_client_goes_on_where_another_was_killed(self, api: LiveApi, site: str, tmp_path: Path) -> None:
        path = tmp_path / "b.mp4"
        path.write_bytes(DATA)
        first = self.client(api).uploader(
            str(path), chunk_size=1_000_000, metadata={"site": site, "purpose": "recording", "camera": "cam2"}
        )
        first.upload_chunk()
        second = self.client(api).uploader(str(path), chunk_size=1_000_000, url=first.url)
        assert second.offset == 1_000_000
        second.upload()
        assert recordings(api, site)["cam2"]["sha256"] == hashlib.sha256(DATA).hexdigest()


class TestBreakingOff:
    def break_off(self, api: LiveApi, path: str, offset: int, sent: int) -> None:
        """Announce everything, send some (more than is written at once), and vanish when that is being written."""
        address = urlsplit(api.url)
        head = (
            f"PATCH {path} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {TOKEN}\r\nTus-Resumable: 1.0.0\r\n"
            f"Upload-Offset: {offset}\r\nContent-Type: application/offset+octet-stream\r\n"
            f"Content-Length: {len(DATA) - offset}\r\n\r\n"
        )
        with socket.create_connection((address.hostname, address.port)) as connection:  # type: ignore[arg-type]
            connection.sendall(head.encode() + DATA[offset : offset + sent])
            wait_until(lambda: bytes_on_disk(api, path) > offset)

    def settled_offset(self, api: LiveApi, path: str, before: int = 0) -> int:
        """Where the upload stands once the broken connection has been noticed."""
        wait_until(lambda: api.offset(path) > before and not is_locked(api, path))
        return api.offset(path)

    def test_what_arrived_is_kept_and_the_result_is_whole(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        self.break_off(api, path, 0, 1_300_000)
        offset = self.settled_offset(api, path)
        assert 0 < offset <= 1_300_000
        self.break_off(api, path, offset, 1_300_000)
        offset = self.settled_offset(api, path, before=offset)
        assert api.send(path, offset, DATA[offset:]).status_code == 204
        assert stored_bytes(api, path) == DATA
        assert recordings(api, site)["cam1"]["sha256"] == hashlib.sha256(DATA).hexdigest()

    def test_bytes_beyond_the_acknowledged_offset_are_dropped(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        assert api.send(path, 0, DATA[:1000]).status_code == 204
        partial = api.services.folder.upload(Path(path).name)
        with partial.open("ab") as file:  # what a killed service may have left behind
            file.write(b"rubbish that was never acknowledged")
        assert api.send(path, 1000, DATA[1000:]).status_code == 204
        assert stored_bytes(api, path) == DATA

    def test_a_restarted_service_goes_on(self, tmp_path: Path) -> None:
        settings = settings_for(tmp_path / "data")
        with live_api(settings) as first:
            site = first.site()
            path = begin(first, site)
            assert first.send(path, 0, DATA[:1_234_567]).status_code == 204
        with live_api(settings) as second:
            assert second.offset(path) == 1_234_567
            assert second.send(path, 1_234_567, DATA[1_234_567:]).status_code == 204
            assert recordings(second, site)["cam1"]["sha256"] == hashlib.sha256(DATA).hexdigest()

    def test_a_service_killed_between_disk_and_database_goes_on(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        assert api.send(path, 0, DATA[:2000]).status_code == 204
        folder, name = api.services.folder, Path(path).name
        with folder.upload(name).open("ab") as file:
            file.write(DATA[2000:])
        folder.finish(name)  # moved, but the database was never told
        assert api.offset(path) == 2000
        assert api.send(path, 2000, DATA[2000:]).status_code == 204
        assert stored_bytes(api, path) == DATA

    def test_lost_bytes_are_said_not_filled_with_zeros(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        assert api.send(path, 0, DATA[:2000]).status_code == 204
        api.services.folder.upload(Path(path).name).write_bytes(b"")
        response = api.send(path, 2000, DATA[2000:])
        assert response.status_code == 409
        assert "lost" in response.json()["detail"]


class TestRefusals:
    def test_a_wrong_offset(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        response = api.send(path, 5, DATA[5:])
        assert response.status_code == 409
        assert response.json()["details"]["offset"] == 0
        assert api.offset(path) == 0

    def test_two_writers_at_once(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        second_done = threading.Event()

        def slowly() -> object:
            yield DATA[:1_500_000]
            second_done.wait(60)
            yield DATA[1_500_000:]

        statuses: list[int] = []
        writer = threading.Thread(target=lambda: statuses.append(api.send(path, 0, slowly()).status_code))
        writer.start()
        wait_until(lambda: bytes_on_disk(api, path) > 0)
        response = api.send(path, 0, b"x")  # answered while the first writer is still at it
        assert response.status_code == 423
        assert response.json()["code"] == "locked"
        second_done.set()
        writer.join(600)
        assert statuses == [204]
        assert stored_bytes(api, path) == DATA

    def test_a_wrong_checksum_keeps_nothing(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        wrong = b64encode(hashlib.sha256(b"other").digest()).decode()
        response = api.send(path, 0, DATA[:1000], upload_checksum=f"sha256 {wrong}")
        assert response.status_code == 460
        assert api.offset(path) == 0
        right = b64encode(hashlib.sha256(DATA).digest()).decode()
        assert api.send(path, 0, DATA, upload_checksum=f"sha256 {right}").status_code == 204
        assert stored_bytes(api, path) == DATA

    @pytest.mark.parametrize("header", ["md4 AAAA", "sha256", "sha256 %%%"])
    def test_checksums_that_are_none(self, api: LiveApi, site: str, header: str) -> None:
        response = api.send(begin(api, site), 0, DATA, upload_checksum=header)
        assert response.status_code == (460 if header == "sha256" else 400)  # no digest is one of no bytes

    def test_more_than_promised(self, api: LiveApi, site: str) -> None:
        path = begin(api, site, DATA[:1000])
        assert api.send(path, 0, DATA[:2000]).status_code == 413
        assert api.offset(path) == 0

    def test_an_upload_that_is_complete(self, api: LiveApi, site: str) -> None:
        path = begin(api, site, DATA[:10])
        assert api.send(path, 0, DATA[:10]).status_code == 204
        assert api.offset(path) == 10
        assert api.send(path, 10, b"").status_code == 204
        assert api.send(path, 10, b"x").status_code == 413
        assert stored_bytes(api, path) == DATA[:10]

    def test_without_a_token_not_a_byte_is_read(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        address = urlsplit(api.url)
        head = f"PATCH {path} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer wrong\r\nContent-Length: 50000000\r\n\r\n"
        with socket.create_connection((address.hostname, address.port), timeout=300) as connection:  # type: ignore[arg-type]
            connection.sendall(head.encode())
            assert b"401 Unauthorized" in connection.recv(4000)
        assert api.offset(path) == 0

    def test_another_protocol_version(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        for headers in ({"Tus-Resumable": "0.2.2"}, {}):
            response = api.http.head(path, headers=headers)
            assert response.status_code == 412
            assert response.headers["Tus-Version"] == "1.0.0"

    def test_refusals_speak_tus_too(self, api: LiveApi, site: str) -> None:
        path = begin(api, site)
        for status, response in (
            (401, httpx.post(f"{api.url}/v1/uploads", timeout=300)),
            (404, api.http.head("/v1/uploads/file_0000000000000000", headers=TUS)),
            (409, api.send(path, 5, DATA)),
            (412, api.http.delete(path)),
            (422, api.http.post("/v1/uploads", headers=TUS)),
        ):
            assert response.status_code == status
            assert response.headers["Tus-Resumable"] == "1.0.0"

    def test_another_content_type(self, api: LiveApi, site: str) -> None:
        assert api.send(begin(api, site), 0, DATA, content_type="video/mp4").status_code == 415

    def test_what_does_not_exist(self, api: LiveApi) -> None:
        for path in ("/v1/uploads/file_0000000000000000", "/v1/uploads/..%2f..%2fetc"):
            assert api.http.head(path, headers=TUS).status_code == 404

    @pytest.mark.parametrize(
        ("values", "code"),
        [
            ({"camera": "west"}, "invalid_input"),
            ({"camera": ""}, "invalid_input"),
            ({"purpose": "music"}, "invalid_input"),
            ({"purpose": "labels"}, "invalid_input"),
            ({"site": "site_0000000000000000"}, "not_found"),
        ],
    )
    def test_files_for_nothing(self, api: LiveApi, site: str, values: dict[str, str], code: str) -> None:
        response = api.begin(**{"site": site, "length": 10, **values})
        assert response.json()["code"] == code
        assert response.json()["hint"]

    def test_empty_files_and_broken_metadata(self, api: LiveApi, site: str) -> None:
        assert api.begin(site, 0).status_code == 422
        headers = {**TUS, "Upload-Length": "10", "Upload-Metadata": "site %%%"}
        response = api.http.post("/v1/uploads", headers=headers)
        assert response.status_code == 422
        assert "Upload-Metadata" in response.json()["detail"]

    @pytest.mark.parametrize("header", [b"site \xff\xfe", b"s\xe4te eA==", b"filename w\xe4"])
    def test_headers_that_are_not_ascii(self, api: LiveApi, site: str, header: bytes) -> None:
        headers = {**TUS, "Upload-Length": "10", "Upload-Metadata": header}
        assert api.http.post("/v1/uploads", headers=headers).status_code == 422
        headers = {**TUS, "Upload-Offset": "0", "Upload-Checksum": b"sha256 \xe4"}
        headers["Content-Type"] = "application/offset+octet-stream"
        assert api.http.patch(begin(api, site), content=DATA, headers=headers).status_code == 400

    def test_numbers_beyond_all_files(self, api: LiveApi, site: str) -> None:
        assert api.begin(site, 10**400).status_code == 422
        assert api.send(begin(api, site), 10**60, DATA).status_code == 422


def test_quota_and_expiry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = settings_for(tmp_path / "data", upload_quota_bytes=1000, upload_lifetime_s=3600.0)
    with live_api(settings) as api:
        site = api.site()
        assert api.begin(site, 1001).json()["code"] == "quota_exceeded"
        path = begin(api, site, DATA[:600])
        assert api.begin(site, 600).status_code == 413
        later = time.time() + 3601.0
        monkeypatch.setattr(api.services.uploads, "now", lambda: later)
        monkeypatch.setattr(api.services.uploads.sites, "_now", lambda: later)
        assert api.send(path, 0, DATA[:600]).status_code == 410
        assert api.http.head(path, headers=TUS).status_code == 410
        api.services.uploads.tidy()
        assert api.http.head(path, headers=TUS).status_code == 404
        assert [p.name for p in (tmp_path / "data" / "uploads").iterdir()] == []
        assert api.begin(site, 600).status_code == 201


def test_bytes_that_nobody_knows_of_are_swept(api: LiveApi, site: str) -> None:
    path = begin(api, site)
    folder = api.services.folder
    old, young, known = (
        folder.upload(name) for name in ("file_00000000000000aa", "file_00000000000000bb", Path(path).name)
    )
    for stray in (old, young):
        stray.write_bytes(b"x")
    for stray in (old, known):
        os.utime(stray, (0, 0))
    api.services.uploads.tidy()
    assert (old.exists(), young.exists(), known.exists()) == (False, True, True)
    young.unlink()


def test_metadata_comes_back_word_by_word(api: LiveApi, site: str) -> None:
    given = f"camera Y2FtMQ==,site {b64encode(site.encode()).decode()},  filename w6Q=,is_confidential"
    begun = api.http.post("/v1/uploads", headers={**TUS, "Upload-Length": "10", "Upload-Metadata": given})
    assert api.http.head(begun.headers["Location"], headers=TUS).headers["Upload-Metadata"] == given


def test_termination(api: LiveApi, site: str) -> None:
    path = begin(api, site)
    assert api.http.delete(path, headers=TUS).status_code == 204
    assert api.http.head(path, headers=TUS).status_code == 404
    assert not api.services.folder.upload(Path(path).name).exists()


def test_options_tell_what_is_served(api: LiveApi) -> None:
    headers = api.http.options("/v1/uploads").headers
    assert headers["Tus-Version"] == "1.0.0"
    assert set(headers["Tus-Extension"].split(",")) == {
        "creation",
        "creation-with-upload",
        "expiration",
        "termination",
        "checksum",
    }


def test_replacing_a_recording_removes_the_older_bytes(api: LiveApi) -> None:
    site = api.site()
    api.upload(site, b"first")
    [old] = api.http.get(f"/v1/sites/{site}/recordings").json()
    api.upload(site, b"second")
    [new] = api.http.get(f"/v1/sites/{site}/recordings").json()
    assert new["id"] != old["id"]
    api.services.uploads.tidy()
    files = {path.name for path in (api.services.folder.root / "files").iterdir()}
    assert new["id"] in files
    assert old["id"] not in files


def test_assets_get_the_suffix_of_what_they_are(api: LiveApi) -> None:
    site = api.site()
    api.upload(site, b"PAR1....PAR1", camera="", purpose="labels", filename="labels.exe")
    files = {path.suffix for path in (api.services.folder.root / "files").iterdir()}
    assert ".parquet" in files
    [labels] = api.http.get(f"/v1/sites/{site}/recordings").json()
    assert labels["purpose"] == "labels"
    assert labels["camera"] is None
