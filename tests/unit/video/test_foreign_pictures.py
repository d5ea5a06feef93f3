"""Pictures as recordings bring them: turned, mirrored, squeezed, interlaced, in ten bits, of two sizes."""

import struct
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from tests.foreign_recordings import copy, number_of, picture, write
from wibam_core.errors import UnreadableVideo
from wibam_core.video.cautions import cautions_of
from wibam_core.video.decode import decode
from wibam_core.video.probe import measure, probe
from wibam_core.video.recording import Recording


def with_matrix(path: Path, a: float, b: float, c: float, d: float) -> Path:
    """The recording with this matrix in its track header (ISO/IEC 14496-12, 8.3.2)."""
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") - 4
    matrix = at + 8 + 4 + (20 if data[at + 8] == 0 else 32) + 8 + 8
    values = [round(v * 65536) for v in (a, b, 0, c, d, 0, 0, 0)]
    data[matrix : matrix + 36] = struct.pack(">9i", *values, 1 << 30)
    path.with_name("turned.mp4").write_bytes(data)
    return path.with_name("turned.mp4")


def first_image(path: Path) -> np.ndarray:
    return next(decode(path))[1].astype(int)


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A picture that no turn and no mirror leaves as it is."""
    path = tmp_path_factory.mktemp("pictures") / "plain.mp4"
    image = np.full((240, 320, 3), 60, np.uint8)
    image[20:60, 30:200], image[100:200, 20:60] = (250, 40, 40), (40, 40, 250)
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate=10, options={"crf": "4", "bf": "0"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for number in range(3):
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = number, Fraction(1, 10)
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(
    ("matrix", "shown", "turn"),
    [
        ((1, 0, 0, 1), lambda image: image, (0, False)),
        ((-1, 0, 0, 1), lambda image: image[:, ::-1], (0, True)),
        ((1, 0, 0, -1), lambda image: image[::-1], (180, True)),
        ((-1, 0, 0, -1), lambda image: image[::-1, ::-1], (180, False)),
        ((0, 1, -1, 0), lambda image: np.rot90(image, -1), (270, False)),
        ((0, -1, 1, 0), np.rot90, (90, False)),
        ((0, 1, 1, 0), lambda image: image.transpose(1, 0, 2), (90, True)),
        ((0, -1, -1, 0), lambda image: np.rot90(image, 2).transpose(1, 0, 2), (270, True)),
    ],
)
def test_all_eight_orientations_are_shown_as_a_player_shows_them(stored: Path, matrix, shown, turn) -> None:  # type: ignore[no-untyped-def]
    want = shown(first_image(stored))
    path = with_matrix(stored, *matrix)
    got = first_image(path)
    assert got.shape == want.shape
    assert np.abs(got - want).mean() < 1
    info = probe(path)
    assert (info.rotation_deg, info.mirrored) == turn
    assert (info.width_px, info.height_px) == (want.shape[1], want.shape[0])


def test_a_turn_by_another_angle_is_refused(stored: Path) -> None:
    with pytest.raises(UnreadableVideo, match="turned by 30°") as refused:
        probe(with_matrix(stored, 0.866, 0.5, -0.5, 0.866))
    assert refused.value.hint


def squeezed(path: Path) -> Path:
    def prepare(stream: av.video.stream.VideoStream) -> None:
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)

    return write(path, range(10), size=(240, 180), prepare=prepare)


def test_squeezed_pictures_are_stretched_where_the_calibration_is_for_the_size_shown(tmp_path: Path) -> None:
    path = squeezed(tmp_path / "a.mp4")
    info, _ = measure(Recording.at(path), (320, 180))
    assert (info.width_px, info.height_px, info.stored_px) == (320, 180, (240, 180))
    image = next(decode(path, size_px=(320, 180)))[1]
    assert np.abs(image.astype(int) - picture(0, 320, 180)).mean() < 4
    assert cautions_of(info) == []


@pytest.mark.parametrize("size", [(318, 180), (322, 180)])
def test_programs_round_the_width_of_stretched_pictures_as_they_like(tmp_path: Path, size: tuple[int, int]) -> None:
    info, _ = measure(Recording.at(squeezed(tmp_path / "a.mp4")), size)
    assert (info.width_px, info.height_px) == size
    assert cautions_of(info) == []


@pytest.mark.parametrize("size", [(244, 180), (320, 182), (300, 180)])
def test_another_size_is_not_taken_for_a_rounded_one(tmp_path: Path, size: tuple[int, int]) -> None:
    info, _ = measure(Recording.at(squeezed(tmp_path / "a.mp4")), size)
    assert (info.width_px, info.height_px) == (240, 180)


def test_squeezed_pictures_that_are_used_as_stored_are_said(tmp_path: Path) -> None:
    info, _ = measure(Recording.at(squeezed(tmp_path / "a.mp4")), (240, 180))
    assert (info.width_px, info.height_px) == (240, 180)
    [caution] = cautions_of(info)
    assert caution.code == "pixels_not_square" and "1.333" in caution.message


def joined(tmp_path: Path, size: tuple[int, int]) -> Path:
    first = write(tmp_path / "a.ts", range(24), size=(640, 360))
    second = copy(write(tmp_path / "b.ts", range(24, 48), size=size), tmp_path / "c.ts", shift_s=1.0)
    path = tmp_path / "joined.ts"
    path.write_bytes(first.read_bytes() + second.read_bytes())
    return path


@pytest.mark.parametrize("wanted", [(640, 360), (320, 180)])
def test_a_size_that_changes_midway_is_brought_to_one_and_said(tmp_path: Path, wanted: tuple[int, int]) -> None:
    path = joined(tmp_path, (320, 180))
    info, times_ns = measure(Recording.at(path), wanted)
    images = list(decode(path, size_px=(info.width_px, info.height_px)))
    assert {image.shape for _, image in images} == {(wanted[1], wanted[0], 3)}
    assert [number_of(image) for _, image in images] == [*range(48)]
    assert [time_ns for time_ns, _ in images] == times_ns.tolist()
    [caution] = cautions_of(info)
    assert caution.code == "size_changes" and "320x180 px at 1.0 s" in caution.message


def test_a_shape_that_changes_midway_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableVideo, match=r"from 640x360 to 320x240 px at 1\.0 s"):
        probe(joined(tmp_path, (320, 240)))


def test_interlaced_pictures_are_deinterlaced_and_said(tmp_path: Path) -> None:
    """The fields of a frame show moments between which an edge moves by 16 px: it must not be a comb."""
    path = tmp_path / "a.ts"
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate=25, options={"x264-params": "tff=1", "bf": "2", "crf": "10"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for number in range(12):
            image = np.full((240, 320, 3), 40, np.uint8)
            image[::2, : 20 + 16 * number] = 200
            image[1::2, : 28 + 16 * number] = 200
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame = frame.reformat(format="yuv420p")
            frame.pts, frame.time_base = number, Fraction(1, 25)
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    info, times_ns = measure(Recording.at(path))
    images = list(decode(path))
    assert [time_ns for time_ns, _ in images] == times_ns.tolist()
    assert len(images) == 12
    combs = [np.abs(np.diff(image[60:180, :, 1].astype(int), axis=0)).mean() for _, image in images[2:-2]]
    assert max(combs) < 2  # 8 px of 320 between the fields, 160 levels apart, make 4
    assert [caution.code for caution in cautions_of(info)] == ["interlaced"]


@pytest.mark.parametrize(
    ("codec", "pixels"), [("libx264", "yuv420p10le"), ("libx264", "yuvj420p"), ("prores_ks", "yuva444p10le")]
)
def test_depth_range_and_alpha_change_no_colour(tmp_path: Path, codec: str, pixels: str) -> None:
    path = write(tmp_path / "a.mov", range(5), codec=codec, pixels=pixels)
    image = next(decode(path))[1].astype(int)
    assert np.median(image[:, 40:]) == pytest.approx(40, abs=2)
    assert np.median(image[:, :8]) == pytest.approx(200, abs=2)


def test_the_default_track_is_the_recording_and_another_one_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as output:
        streams = []
        for size in ((640, 360), (320, 240)):
            stream = output.add_stream("libx264", rate=24, options={"bf": "0"})
            stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
            streams.append(stream)
        streams[0].disposition = av.stream.Disposition(0)
        streams[1].disposition = av.stream.Disposition.default
        for number in range(10):
            for stream in streams:
                frame = av.VideoFrame.from_ndarray(picture(number, stream.width, stream.height), format="bgr24")
                frame.pts, frame.time_base = number, Fraction(1, 24)
                output.mux(stream.encode(frame))
        for stream in streams:
            output.mux(stream.encode(None))
    info = probe(path)
    assert (info.width_px, info.height_px, info.frames) == (320, 240, 10)
    [caution] = cautions_of(info)
    assert caution.code == "several_video_tracks" and "320x240" in caution.message


def test_a_cover_picture_is_not_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    cover = cv2.imencode(".jpg", picture(0, 1280, 720))[1].tobytes()
    with av.open(str(path), "w") as output:
        attached = output.add_stream("mjpeg", rate=1)
        attached.width, attached.height, attached.pix_fmt = 1280, 720, "yuvj420p"
        attached.disposition = av.stream.Disposition.attached_pic
        stream = output.add_stream("libx264", rate=24, options={"bf": "0"})
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        packet = av.Packet(cover)
        packet.stream, packet.pts, packet.dts, packet.time_base = attached, 0, 0, Fraction(1, 24)
        for number in range(10):
            frame = av.VideoFrame.from_ndarray(picture(number), format="bgr24")
            frame.pts, frame.time_base = number, Fraction(1, 24)
            output.mux(stream.encode(frame))
        output.mux(packet)
        output.mux(stream.encode(None))
    info = probe(path)
    assert (info.width_px, info.frames, info.video_tracks) == (320, 10, 1)
    assert [number_of(image) for _, image in decode(path)] == [*range(10)]
