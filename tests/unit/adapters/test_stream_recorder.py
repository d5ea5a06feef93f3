"""A stream is recorded from a real server: signed in, cut, lost and found again."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from itertools import pairwise
from pathlib import Path

import pytest

from tests.recordings import write_recording
from tests.rtsp_server import Camera, Picture, pictures_of, rtsp_server
from tests.service import wait_until
from wibam_core.adapters.camera_stream import StreamAddress, StreamLost, StreamRefused, open_stream
from wibam_core.adapters.stream_recorder import RECORDED, StreamRecorder, disk_error, is_recorded
from wibam_core.adapters.watched_folder import began
from wibam_core.errors import DiskFull, InputError, WibamError
from wibam_core.video.decode import decode

LOGIN, SECRET = ("us@er", "p:ss wörd"), "us%40er:p%3Ass%20w%C3%B6rd@"
#: How long a silent stream is waited for; a busy machine sends late.
SILENCE_S = 4.0


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[Picture]:
    """Two seconds of small noise, and a key frame at their beginning."""
    return pictures_of(write_recording(tmp_path_factory.mktemp("rtsp") / "live.mp4"))


class Recording:
    """A recorder, and what it said."""

    def __init__(self, folder: Path, url: str, chunk_s: float, most_bytes: int) -> None:
        self.folder, self.said = folder, list[str]()
        address = StreamAddress.of(url)
        self.recorder = StreamRecorder(address, folder, chunk_s, most_bytes, self.said.append, SILENCE_S, 0.05)

    @property
    def files(self) -> list[Path]:
        return sorted(path for path in self.folder.glob("*/*") if is_recorded(path))

    @property
    def last(self) -> str:
        return self.said[-1] if self.said else ""

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait, while the recorder does not fail."""

        def met() -> bool:
            self.recorder.check()
            return condition()

        wait_until(met, 120.0)

    def taken_s(self) -> list[list[float]]:
        """Unix times of the pictures in each file."""
        return [
            [began(path.name, timedelta()).timestamp() + time_ns / 1e9 for time_ns, _ in decode(path)]
            for path in self.files
        ]


@contextmanager
def recorded(folder: Path, url: str, chunk_s: float = 1.5, most_bytes: int = 10**9) -> Iterator[Recording]:
    recording = Recording(folder / "north", url, chunk_s, most_bytes)
    try:
        yield recording
    finally:
        recording.recorder.stop()


def test_a_stream_becomes_files_that_say_when_each_picture_was_taken(pictures: list[Picture], tmp_path: Path) -> None:
    with rtsp_server(Camera(pictures, login=LOGIN)) as camera:
        with recorded(tmp_path, camera.url(SECRET)) as recording:
            recording.until(lambda: len(recording.files) >= 2)
        recording.recorder.check()
    taken = [time_s for of_file in recording.taken_s() for time_s in of_file]
    assert len(taken) >= 40
    assert len(recording.taken_s()[0]) == 20, "cut at the key frame"
    assert not list(recording.folder.rglob(".*")), "the last file was completed"
    # each picture was sent when it was taken; a busy machine sends some late, never early, and some receive them so
    sent = sorted(time_s for time_s, *_ in camera.sent)
    assert min(time_s - sent_s for time_s, sent_s in zip(taken, sent, strict=False)) > -0.06
    said = " ".join(recording.said)
    assert "is being recorded" in said
    assert "rtsp://127.0.0.1" in said
    assert not any(part in said for part in ("us%40er", "p%3Ass", "us@er"))


def test_a_camera_that_goes_away_and_returns_leaves_a_gap(pictures: list[Picture], tmp_path: Path) -> None:
    camera = Camera(pictures)
    with rtsp_server(camera):
        port = camera.port
        recording = Recording(tmp_path / "north", camera.url(), 60.0, 10**9)
        recording.until(lambda: len(camera.sent) > 25)
    try:
        recording.until(lambda: "refused" in recording.last)  # it is off
        assert len(recording.files) == 1
        left = len(camera.sent)
        with rtsp_server(camera, port):
            recording.until(lambda: "is back after" in recording.last)
            recording.until(lambda: len(camera.sent) > left + 25)
            recording.recorder.stop()
    finally:
        recording.recorder.stop()
    before, after = recording.taken_s()
    assert after[0] - before[-1] > camera.sent[left][0] - camera.sent[left - 1][0] - 0.2


def test_a_connection_that_breaks_or_falls_silent_is_made_again(pictures: list[Picture], tmp_path: Path) -> None:
    camera = Camera(pictures, breaks_after=25)
    with rtsp_server(camera), recorded(tmp_path, camera.url(), 60.0) as recording:
        recording.until(lambda: len(recording.said) == 3)
        camera.silent_from = 30
        recording.until(lambda: len(recording.said) == 4)
        camera.silent_from = None
        recording.until(lambda: len(recording.said) == 5)
    assert ["has ended" in said for said in recording.said] == [False, True, False, False, False]
    assert "no answer for too long" in recording.said[3]
    assert sum(request.startswith("PLAY") for request in camera.requests) >= 3


def test_stamps_that_jump_end_a_file(pictures: list[Picture], tmp_path: Path) -> None:
    camera = Camera(pictures, jumps={25: 3600.0, 65: -7200.0})
    with rtsp_server(camera), recorded(tmp_path, camera.url(), 60.0) as recording:
        recording.until(lambda: len(camera.sent) > 105)
    files = recording.taken_s()
    assert len(files) == 3
    assert all(0.0 < b[0] - a[-1] < 120.0 for a, b in pairwise(files))
    assert sum(map(len, files)) <= len(camera.sent) - 15 - 15, "nothing decodes between a jump and the next key frame"


def test_where_files_wait_for_longer_than_there_is_room_the_oldest_go(pictures: list[Picture], tmp_path: Path) -> None:
    (tmp_path / "north" / RECORDED).mkdir(parents=True)
    old = tmp_path / "north" / RECORDED / "2026-07-01_06-00-00.000Z.mkv"
    other = tmp_path / "north" / "2026-07-01_06-00-00.000Z.mkv"  # not ours to remove
    for path in (old, other):
        path.write_bytes(bytes(10**6))
    with rtsp_server(Camera(pictures)) as camera, recorded(tmp_path, camera.url(), 1.5, 200_000) as recording:
        recording.until(lambda: not old.exists() and len(recording.files) > 0)
    assert other.exists()
    assert any("2026-07-01_06-00-00.000Z.mkv was removed" in said for said in recording.said)


AUDIO = "m=audio 0 RTP/AVP 0\r\na=control:track1\r\n"
STRANGE = "m=video 0 RTP/AVP 96\r\na=rtpmap:96 X-STRANGE/90000\r\na=control:track1\r\n"


@pytest.mark.parametrize(
    ("changes", "login", "path", "said"),
    [
        ({}, "", "/other", "no such stream"),
        ({"login": LOGIN}, "", "/live", "does not take this name and password"),
        ({"login": LOGIN}, "us%40er:wr0ng@", "/live", "does not take this name and password"),
        ({"media": AUDIO}, "", "/live", "has no video"),
        ({"media": STRANGE, "silent_from": 0}, "", "/live", "in a codec that we do not read"),
    ],
)
def test_what_waiting_does_not_mend_ends_the_recording(
    pictures: list[Picture], tmp_path: Path, changes: dict, login: str, path: str, said: str
) -> None:
    with (
        rtsp_server(Camera(pictures, **changes)) as camera,
        recorded(tmp_path, camera.url(login, path)) as recording,
        pytest.raises(StreamRefused, match=said) as refused,
    ):
        recording.until(lambda: False)
    assert said in recording.last, "at once, not when somebody looks"
    assert "wr0ng" not in str(refused.value.to_dict())
    assert refused.value.__cause__ is None
    assert list((tmp_path / "north").iterdir()) == []


def test_a_refusal_later_is_waited_out(pictures: list[Picture], tmp_path: Path) -> None:
    camera = Camera(pictures, breaks_after=15)
    with rtsp_server(camera), recorded(tmp_path, camera.url()) as recording:
        recording.until(lambda: len(camera.sent) > 12)
        camera.login = LOGIN
        recording.until(lambda: "does not take this name and password" in recording.last)
        recording.recorder.check()


def test_it_stops_at_once_while_it_waits_for_a_camera_that_is_off(tmp_path: Path) -> None:
    before = threading.active_count()
    with recorded(tmp_path, "rtsp://127.0.0.1:9/live") as recording:
        recording.until(lambda: len(recording.said) == 1)
    assert threading.active_count() == before
    assert "refused" in recording.said[0]


def test_a_stream_that_ends_is_lost(pictures: list[Picture]) -> None:
    camera = Camera(pictures, breaks_after=15)
    with rtsp_server(camera), open_stream(StreamAddress.of(camera.url())) as packets:
        first = next(packets)
        assert (first.packet.pts, first.packet.is_keyframe) == (0, True)
        with pytest.raises(StreamLost, match="has ended"):
            list(packets)


@pytest.mark.parametrize(
    "text",
    [
        *("", "http://camera/live", "rtsp://", "/video.mp4", "rtsp://a:b@h:99999/x", "rtsp://h/a b", "rtsp:\n//h"),
        # characters that end the host, not written as %2F and the like: each would be the host "admin", port 12
        *("rtsp://admin:12/s3cret@camera/live", "rtsp://admin:12?s3cret@camera/x", "rtsp://admin:12#s3cret@camera/x"),
    ],
)
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(InputError) as refused:
        StreamAddress.of(text)
    assert not any(secret in str(refused.value.to_dict()) for secret in ("99999", "s3cret"))


@pytest.mark.parametrize(
    "text",
    [
        "rtsp://admin:s3cret@camera:554/live?user=admin&password=s3cret",
        "rtsp://camera:554/user=admin&password=s3cret&channel=1&stream=0.sdp?",
        "rtsp://camera:554/user=admin_password=s3cret_channel=1_stream=0.sdp?real_stream",
    ],
)
def test_an_address_shows_no_secret(text: str) -> None:
    address = StreamAddress.of(text)
    assert str(address) == "rtsp://camera:554"
    assert "s3cret" not in repr(address)


def test_a_camera_may_write_its_name_in_any_encoding(pictures: list[Picture]) -> None:
    with (
        rtsp_server(Camera(pictures, name=b"cam\xe9ra")) as camera,
        open_stream(StreamAddress.of(camera.url()), SILENCE_S) as packets,
    ):
        assert next(packets).packet.is_keyframe


def test_a_stream_without_key_frames_is_not_said_to_be_recorded(pictures: list[Picture], tmp_path: Path) -> None:
    media = Camera(pictures).described().decode().partition("t=0 0\r\n")[2]
    with (
        rtsp_server(Camera([one for one in pictures if not one.key], media=media)) as camera,
        recorded(tmp_path, camera.url(), 0.3) as recording,
    ):
        recording.until(lambda: "has hardly any key frames" in recording.last)
        assert len(recording.said) == 1
    assert recording.files == []


@pytest.mark.parametrize(
    ("number", "error"), [(errno.ENOSPC, DiskFull), (errno.EDQUOT, DiskFull), (errno.EACCES, InputError)]
)
def test_a_disk_is_called_full_where_it_is(tmp_path: Path, number: int, error: type[WibamError]) -> None:
    assert type(disk_error(tmp_path, OSError(number, os.strerror(number)))) is error


def test_a_refusal_after_a_start_without_answer_or_of_a_stream_that_was_read_before_ends_nothing(
    pictures: list[Picture], tmp_path: Path
) -> None:
    camera = Camera(pictures, login=LOGIN)
    (tmp_path / "read" / "north" / RECORDED).mkdir(parents=True)  # by a program before
    with rtsp_server(camera) as listening:
        port = listening.port
        with recorded(tmp_path / "read", camera.url()) as recording:
            recording.until(lambda: "does not take this name and password" in recording.last)
            recording.recorder.check()
    with recorded(tmp_path / "off", camera.url()) as recording:  # the camera starts after the program
        recording.until(lambda: "refused" in recording.last)
        with rtsp_server(camera, port):
            recording.until(lambda: "does not take this name and password" in recording.last)
            recording.recorder.check()
