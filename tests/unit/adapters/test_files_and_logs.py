from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from wibam_core.adapters.files import DataFolder, RunningDigests, UploadFile
from wibam_core.adapters.logs import JobLog, read_log
from wibam_core.adapters.records import new_id, plain_json
from wibam_core.errors import Conflict, DiskFull, Locked, NotFound
from wibam_core.jobs.records import Purpose, Upload

UPLOAD = Upload("file_0123456789abcdef", "site", Purpose.LABELS, "", "x", 100, 0, 0.0, 1.0)


@pytest.fixture
def folder(tmp_path: Path) -> DataFolder:
    folder = DataFolder(tmp_path)
    folder.upload(UPLOAD.id).touch()
    return folder


class TestDataFolder:
    @pytest.mark.parametrize(
        "name", ["../x", "/etc/passwd", "", "file_0123456789ABCDEF", "file_0123456789abcdef/..", "x"]
    )
    def test_only_our_own_ids_become_paths(self, folder: DataFolder, name: str) -> None:
        for make in (folder.upload, folder.log):
            with pytest.raises(NotFound):
                make(name)

    def test_new_ids_do(self, folder: DataFolder) -> None:
        assert folder.log(new_id("job")).parent.is_dir()

    @pytest.mark.parametrize(
        ("head", "suffix"),
        [
            (b"PAR1", ".parquet"),
            (b'{"a"', ".json"),
            (b"[1", ".json"),
            (b"\xef\xbb\xbf{", ".json"),
            (b"\xff\xfe[\0", ".json"),
            (b"\0", ""),
        ],
    )
    def test_a_file_is_named_by_what_it_is(self, folder: DataFolder, head: bytes, suffix: str) -> None:
        folder.upload(UPLOAD.id).write_bytes(head)
        assert folder.finish(UPLOAD.id) == suffix
        assert not folder.upload(UPLOAD.id).exists()
        folder.reopen(UPLOAD.id)
        assert folder.upload(UPLOAD.id).read_bytes() == head

    def test_more_than_the_disk_holds_is_refused(self, folder: DataFolder) -> None:
        folder.require_space(1)
        with pytest.raises(DiskFull):
            folder.require_space(10**18)


class TestUploadFile:
    def test_one_writer_at_a_time(self, folder: DataFolder) -> None:
        with UploadFile(folder, UPLOAD.id), pytest.raises(Locked), UploadFile(folder, UPLOAD.id):
            pass
        with UploadFile(folder, UPLOAD.id):
            pass

    def test_goes_on_at_the_acknowledged_byte(self, folder: DataFolder) -> None:
        folder.upload(UPLOAD.id).write_bytes(b"0123456789")
        with UploadFile(folder, UPLOAD.id) as file:
            file.resume_at(4)
            file.write(b"abc")
            file.sync()
            assert file.read_sha256() == hashlib.sha256(b"0123abc").hexdigest()
        assert folder.upload(UPLOAD.id).read_bytes() == b"0123abc"

    def test_never_fills_gaps_with_zeros(self, folder: DataFolder) -> None:
        with UploadFile(folder, UPLOAD.id) as file, pytest.raises(Conflict, match="lost bytes"):
            file.resume_at(4)


class TestRunningDigests:
    def test_are_given_out_for_the_offset_they_belong_to_alone(self) -> None:
        digests = RunningDigests(capacity=1)
        digest = digests.take(UPLOAD)
        assert digest is not None
        digest.update(b"abc")
        digests.keep(UPLOAD.id, 3, digest)
        assert digests.take(replace(UPLOAD, offset=2)) is None
        digests.keep(UPLOAD.id, 3, digest)
        again = digests.take(replace(UPLOAD, offset=3))
        assert again is not None
        assert again.hexdigest() == hashlib.sha256(b"abc").hexdigest()
        assert digests.take(replace(UPLOAD, offset=3)) is None

    def test_the_oldest_are_forgotten(self) -> None:
        digests = RunningDigests(capacity=1)
        for name in ("a", "b"):
            digests.keep(name, 3, hashlib.sha256())
        assert digests.take(replace(UPLOAD, id="a", offset=3)) is None
        assert digests.take(replace(UPLOAD, id="b", offset=3)) is not None


class TestLogs:
    def test_are_read_in_whole_lines(self, tmp_path: Path) -> None:
        path = tmp_path / "log"
        with JobLog(path) as log:
            for n in range(5):
                log.write("sync", f"line {n}")
        line_bytes = path.stat().st_size // 5
        text, offset = read_log(path, 0, limit=line_bytes * 2 + 7)
        assert text.count("\n") == 2
        rest, end = read_log(path, offset)
        assert rest.count("[sync] line") == 3
        assert read_log(path, end) == ("", end)

    def test_do_not_grow_without_end(self, tmp_path: Path) -> None:
        path = tmp_path / "log"
        with JobLog(path, max_bytes=500) as log:
            for _ in range(100):
                log.write("sync", "x" * 50)
        assert path.stat().st_size < 1000
        assert "not kept" in path.read_text()

    def test_one_that_cannot_be_opened_stops_no_work(self, tmp_path: Path) -> None:
        with JobLog(tmp_path) as log:
            log.write("sync", "lost")
        assert list(tmp_path.iterdir()) == []

    def test_absent_ones_are_empty(self, tmp_path: Path) -> None:
        assert read_log(tmp_path / "none", 0) == ("", 0)


def test_plain_json_is_what_every_database_takes() -> None:
    value = {"a": [float("inf"), float("nan"), 1.5], "b\0": "c\0\ud800", "t": (1, None, True)}
    assert plain_json(value) == {"a": [None, None, 1.5], "b": "c?", "t": [1, None, True]}
