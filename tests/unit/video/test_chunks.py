"""A stream is cut into files whose pictures and times are those of the stream."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import timedelta
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from wibam_core.adapters.watched_folder import began
from wibam_core.video.chunks import Chunk, ChunkCutter, name_of, recovered
from wibam_core.video.decode import decode

S = 1_000_000_000
#: Unix time of the clock's zero by which packets arrive.
UNIX_NS = 1_782_885_600 * S
FPS, KEY_EVERY = 10, 10
OF_OTHER_FILES = timedelta(hours=9)


@dataclass(frozen=True)
class Pictures:
    """A recording that stands for a stream, and its pictures' colours, decoded before it is cut."""

    path: Path
    shown: list[int]


def write(path: Path, seconds: float, b_frames: int = 0) -> Pictures:
    """Grey pictures, each a little brighter than the one before."""
    with av.open(str(path), "w") as container:
        options = {"bf": str(b_frames), "sc_threshold": "0", "crf": "10"}
        stream = container.add_stream("libx264", rate=FPS, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.gop_size = KEY_EVERY
        for n in range(round(seconds * FPS)):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 10 + 3 * n, np.uint8), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return Pictures(path, [brightness(image) for _, image in decode(path)])


def brightness(image: np.ndarray) -> int:
    return round(float(image.mean()))


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Pictures:
    return write(tmp_path_factory.mktemp("stream") / "stream.mp4", 6.0)


def cut(
    source: Pictures,
    folder: Path,
    length_s: float,
    late_s: Callable[[int], float] = lambda n: 0.0,
    jump_s: Callable[[int], float] = lambda n: 0.0,
    of: Sequence[int] | None = None,
    most_bytes: int = 10**9,
) -> list[Chunk]:
    """Feed a recording as a stream whose picture n arrives so late after it was taken, and whose stamps have jumped."""
    made: list[Chunk] = []
    with (
        av.open(str(source.path)) as container,
        ChunkCutter(folder, length_s, lambda ns: ns + UNIX_NS, made.append, most_bytes) as cutter,
    ):
        stream = container.streams.video[0]
        packets: Iterator[av.Packet] = (packet for packet in container.demux(stream) if packet.size)
        for n, packet in enumerate(packets):
            if of is not None and n not in of:
                continue
            assert packet.pts is not None and packet.time_base is not None
            taken_s = packet.pts * packet.time_base
            packet.pts += int(Fraction(str(jump_s(n))) / packet.time_base)
            packet.dts = None
            cutter.add(packet, stream, round((float(taken_s) + late_s(n)) * S))
    return made


def shown(chunks: Sequence[Chunk]) -> list[tuple[int, int]]:
    """Unix time in ms, as the file's name says, and brightness of all pictures."""
    return [
        (round(began(chunk.path.name, OF_OTHER_FILES).timestamp() * 1000) + round(time_ns / 1e6), brightness(image))
        for chunk in chunks
        for time_ns, image in decode(chunk.path)
    ]


def expected(source: Pictures, numbers: Sequence[int], late_ms: int = 0) -> list[tuple[int, int]]:
    return [(UNIX_NS // 1_000_000 + 1000 * n // FPS + late_ms, source.shown[n]) for n in numbers]


def test_files_have_all_pictures_at_their_times_and_begin_with_key_frames(pictures: Pictures, tmp_path: Path) -> None:
    chunks = cut(pictures, tmp_path, 1.5)
    assert shown(chunks) == expected(pictures, range(60))
    assert [round((chunk.began_ns - UNIX_NS) / S, 3) for chunk in chunks] == [0.0, 2.0, 4.0]
    assert [round((chunk.ended_ns - UNIX_NS) / S, 3) for chunk in chunks] == [1.9, 3.9, 5.9]
    assert sorted(path.name for path in tmp_path.iterdir()) == [chunk.path.name for chunk in chunks]


def test_pictures_that_are_sent_in_another_order_than_shown_are_shown_in_order(tmp_path: Path) -> None:
    source = write(tmp_path / "stream.mp4", 4.0, b_frames=2)
    folder = tmp_path / "cut"
    folder.mkdir()
    assert sorted(shown(cut(source, folder, 1.5))) == expected(source, range(40))


def test_packets_that_come_late_do_not_make_files_begin_later(pictures: Pictures, tmp_path: Path) -> None:
    def late_s(n: int) -> float:
        """The first second comes at once, as when a stream is opened; later packets 30 ms late at least."""
        return max(1.0 - n / FPS, 0.0) + 0.03 + (0.2 if n % 3 else 0.0)

    assert shown(cut(pictures, tmp_path, 1.5, late_s)) == expected(pictures, range(60), late_ms=30)


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0, 3.0, -3.0])
def test_a_jump_of_the_stamps_ends_a_file_and_moves_no_picture(
    pictures: Pictures, tmp_path: Path, jump_s: float
) -> None:
    chunks = cut(pictures, tmp_path, 60.0, jump_s=lambda n: jump_s if n >= 25 else 0.0)
    assert shown(chunks) == expected(pictures, [*range(25), *range(30, 60)])
    assert len(chunks) == 2


def test_a_pause_of_the_camera_is_a_pause_in_the_file(pictures: Pictures, tmp_path: Path) -> None:
    of = [*range(15), *range(50, 60)]
    assert shown(cut(pictures, tmp_path, 60.0, of=of)) == expected(pictures, of)


def test_what_comes_before_the_first_key_frame_and_pieces_too_short_are_left_out(
    pictures: Pictures, tmp_path: Path
) -> None:
    assert cut(pictures, tmp_path, 1.5, of=range(3, 20)) == []
    assert list(tmp_path.iterdir()) == []
    assert shown(cut(pictures, tmp_path, 1.5, of=range(3, 25))) == expected(pictures, range(10, 25))


def test_a_file_that_a_killed_program_left_is_completed(pictures: Pictures, tmp_path: Path) -> None:
    made: list[Chunk] = []
    with av.open(str(pictures.path)) as container:
        cutter = ChunkCutter(tmp_path, 60.0, lambda ns: ns + UNIX_NS, made.append, 10**9)
        stream = container.streams.video[0]
        for packet in container.demux(stream):
            if packet.size:
                cutter.add(packet, stream, round(float(packet.pts * packet.time_base) * S) + 5 * S)
        (hidden,) = tmp_path.iterdir()
        assert hidden.name.startswith(".")
        copy = tmp_path / "killed"
        copy.mkdir()
        (copy / hidden.name).write_bytes(hidden.read_bytes())  # what the disk has of it
        (copy / f".{name_of(UNIX_NS)}").touch()
        cutter.close()
    (path,) = recovered(copy)
    assert path.name == name_of(UNIX_NS + 5 * S)
    assert list(copy.iterdir()) == [path]
    assert [brightness(image) for _, image in decode(path)][:45] == pictures.shown[:45]


def test_a_stream_without_key_frames_is_overdue(pictures: Pictures, tmp_path: Path) -> None:
    overdue = []
    with av.open(str(pictures.path)) as container:
        stream = container.streams.video[0]
        with ChunkCutter(tmp_path, 0.3, lambda ns: ns, lambda chunk: None, 10**9) as cutter:
            for packet in container.demux(stream):
                if packet.size:
                    cutter.add(packet, stream, round(float(packet.pts * packet.time_base) * S))
                    overdue.append(cutter.overdue)
    assert overdue[:10] == [False] * 7 + [True] * 3


def test_a_stream_that_never_has_a_key_frame_is_overdue(pictures: Pictures, tmp_path: Path) -> None:
    with av.open(str(pictures.path)) as container:
        stream = container.streams.video[0]
        packets = [packet for packet in container.demux(stream) if packet.size and not packet.is_keyframe]
        overdue = []
        with ChunkCutter(tmp_path, 600.0, lambda ns: ns, lambda chunk: None, 10**9) as cutter:
            for second in (5, 35, 64, 66):
                cutter.add(packets[0], stream, second * S)
                overdue.append(cutter.overdue)
                assert not cutter.writing
    assert overdue == [False, False, False, True]


def test_stamps_that_go_slowly_make_files_no_longer_by_the_clock(pictures: Pictures, tmp_path: Path) -> None:
    """Each second of the stamps takes three of the clock: files of six seconds end at every second key frame."""
    chunks = cut(pictures, tmp_path, 6.0, late_s=lambda n: 2.0 * n / FPS)
    assert [len(list(decode(chunk.path))) for chunk in chunks] == [20, 20, 20]


def test_stamps_that_stand_still_are_told_of(pictures: Pictures, tmp_path: Path) -> None:
    with (
        av.open(str(pictures.path)) as container,
        ChunkCutter(tmp_path, 3.0, lambda ns: ns + UNIX_NS, lambda chunk: None, 10**9) as cutter,
    ):
        stream = container.streams.video[0]
        for n, packet in enumerate(packet for packet in container.demux(stream) if packet.size):
            packet.pts, packet.dts = n, None
            cutter.add(packet, stream, n * S // FPS)
            assert cutter.frozen == (n >= 30)
            if cutter.frozen:
                break
    assert list(tmp_path.iterdir()) == []


def test_files_end_when_they_have_all_bytes_that_they_may_have(pictures: Pictures, tmp_path: Path) -> None:
    with av.open(str(pictures.path)) as container:
        sizes = [packet.size for packet in container.demux(container.streams.video[0]) if packet.size]
    for name in ("at_key", "at_once"):
        (tmp_path / name).mkdir()
    most_bytes = 2 * sum(sizes[:11])
    chunks = cut(pictures, tmp_path / "at_key", 60.0, most_bytes=most_bytes)
    assert shown(chunks) == expected(pictures, range(60)), "nothing is lost where there are key frames"
    assert len(chunks) >= 2
    # with one key frame in the first four seconds a file ends at once, and the next begins with the next key frame
    of = [n for n in range(60) if n not in (10, 20, 30, 50)]
    chunks = cut(pictures, tmp_path / "at_once", 60.0, of=of, most_bytes=sum(sizes[n] for n in of[:15]))
    assert round((chunks[0].ended_ns - UNIX_NS) / S, 3) == of[14] / FPS
    assert chunks[1].began_ns == UNIX_NS + 4 * S


def test_convention_names_are_in_utc_to_the_millisecond() -> None:
    assert name_of(1_782_885_600_250_400_000) == "2026-07-01_06-00-00.250Z.mkv"
    assert name_of(1_782_885_599_999_600_000) == "2026-07-01_06-00-00.000Z.mkv"
