from __future__ import annotations

import re
import wave
from pathlib import Path

import av
import numpy as np
import pytest

from wibam_core.errors import UnreadableVideo
from wibam_core.video.decode import decode
from wibam_core.video.encode import VideoWriter
from wibam_core.video.probe import probe

FRAME_NS = 40_000_000


def write(path: Path, times_ns: list[int], width: int = 96, height: int = 64) -> Path:
    rng = np.random.default_rng(0)
    with VideoWriter(path, width, height, 25.0) as writer:
        for time_ns in times_ns:
            writer.write(rng.integers(0, 255, (height, width, 3), dtype=np.uint8), time_ns)
    return path


def remux(source: Path, target: Path, **options: str) -> Path:
    """The same packets in another container."""
    with av.open(str(source)) as reader, av.open(str(target), "w", container_options=options) as writer:
        stream = writer.add_stream_from_template(reader.streams.video[0])
        for packet in reader.demux(reader.streams.video[0]):
            if packet.dts is not None:
                packet.stream = stream
                writer.mux(packet)
    return target


def test_figures_of_a_steady_recording(tmp_path: Path) -> None:
    info = probe(write(tmp_path / "a.mp4", [5 * FRAME_NS + i * FRAME_NS for i in range(30)], 98, 64))
    assert (info.codec, info.width_px, info.height_px, info.rotation_deg) == ("h264", 98, 64, 0)
    assert (info.frames, info.missing_frames) == (30, 0)
    assert (info.first_ns, info.last_ns) == (5 * FRAME_NS, 34 * FRAME_NS)
    assert info.fps == pytest.approx(25)
    assert info.duration_s == pytest.approx(1.2)
    assert info.largest_gap_s == pytest.approx(0.04)
    assert not info.variable_rate


def test_dropped_frames_leave_the_rate_as_it_is(tmp_path: Path) -> None:
    info = probe(write(tmp_path / "a.mp4", [i * FRAME_NS for i in range(60) if i % 10 != 7]))
    assert info.fps == pytest.approx(25)
    assert info.frames == 54
    assert info.largest_gap_s == pytest.approx(0.08)
    assert info.variable_rate


@pytest.mark.parametrize("suffix", ["mkv", "ts", "mov"])
def test_other_containers_keep_rate_and_duration(tmp_path: Path, suffix: str) -> None:
    source = write(tmp_path / "a.mp4", [i * 33_366_667 for i in range(60)])
    info = probe(remux(source, tmp_path / f"b.{suffix}"))
    assert info.frames == 60
    assert info.fps == pytest.approx(1e9 / 33_366_667, rel=2e-3)
    assert info.duration_s == pytest.approx(60 * 0.033366667, rel=2e-3)


def test_cut_off_file_with_its_index_in_front_says_how_much_is_missing(tmp_path: Path) -> None:
    source = write(tmp_path / "a.mp4", [i * FRAME_NS for i in range(50)])
    path = remux(source, tmp_path / "b.mp4", movflags="faststart")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    info = probe(path)
    assert 20 < info.frames < 40
    assert 50 - info.frames - 1 <= info.missing_frames <= 50 - info.frames


def test_cut_off_file_without_its_index_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mp4", [i * FRAME_NS for i in range(50)])
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(UnreadableVideo, match=r"a\.mp4 is an MP4 file that was cut off") as caught:
        probe(path)
    assert caught.value.hint


def test_text_named_mp4_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "notes.mp4"
    path.write_text("not a film\n" * 100)
    with pytest.raises(UnreadableVideo, match=r"notes\.mp4 is not a video"):
        probe(path)


def test_empty_and_missing_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    path.touch()
    with pytest.raises(UnreadableVideo, match="empty"):
        probe(path)
    with pytest.raises(UnreadableVideo, match="does not exist"):
        probe(tmp_path)


def test_audio_only_is_refused_by_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "sound.m4a"
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("aac", rate=16_000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 16_000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with pytest.raises(UnreadableVideo, match="no video stream: it holds audio only"):
        probe(path)
    with wave.open(str(tmp_path / "sound.wav"), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(16_000))
    with pytest.raises(UnreadableVideo):
        probe(tmp_path / "sound.wav")


def black(path: Path, codec: str, frames: int) -> Path:
    """A recording of black frames."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(frames):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="bgr24")))
        container.mux(stream.encode(None))
    return path


def test_codec_that_we_do_not_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnreadableVideo, match="snow"):
        probe(black(tmp_path / "a.avi", "snow", 3))


def test_recording_without_frames_is_refused(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "a.mp4", 96, 64, 25.0):
        pass
    with pytest.raises(UnreadableVideo):
        probe(tmp_path / "a.mp4")
    with pytest.raises(UnreadableVideo, match="a single frame"):
        probe(write(tmp_path / "b.mp4", [0]))


def test_play_list_that_names_a_local_file_is_not_followed(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4", [0, FRAME_NS])
    for name, text in {
        "list.m3u8": f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{tmp_path / 'a.mp4'}\n#EXT-X-ENDLIST\n",
        "list.ffconcat": f"ffconcat version 1.0\nfile {tmp_path / 'a.mp4'}\n",
        "list.sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\nc=IN IP4 127.0.0.1\nm=video 5004 RTP/AVP 96\n",
    }.items():
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(UnreadableVideo):
            probe(path)


def test_video_beside_sound_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        video = container.add_stream("libx264", rate=25)
        video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        audio = container.add_stream("aac", rate=16_000, layout="mono")
        for _ in range(10):
            container.mux(video.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="bgr24")))
            sound = av.AudioFrame.from_ndarray(np.zeros((1, 640), np.float32), format="fltp", layout="mono")
            sound.sample_rate = 16_000
            container.mux(audio.encode(sound))
        container.mux(video.encode(None))
        container.mux(audio.encode(None))
    info = probe(path)
    assert (info.frames, info.codec) == (10, "h264")


@pytest.mark.assets
def test_real_recordings(assets: Path) -> None:
    road = probe(assets / "footage" / "traffic.mp4")
    assert (road.frames, road.width_px, road.height_px) == (480, 640, 360)
    assert road.fps == pytest.approx(23.976, abs=1e-3)
    junction = probe(assets / "signals" / "junction_640x480_6fps.mp4")
    assert (junction.frames, junction.width_px, junction.height_px) == (384, 640, 480)
    assert junction.fps == pytest.approx(6.0015, abs=1e-3)  # measured; the header says 6.02


def test_avi_without_presentation_times_is_read(tmp_path: Path) -> None:
    info = probe(black(tmp_path / "a.avi", "mpeg4", 10))
    assert (info.codec, info.container, info.frames, info.fps) == ("mpeg4", "avi", 10, pytest.approx(25))


def test_whatever_bytes_are_wrong_the_file_is_read_or_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    sound = write(tmp_path / "a.mp4", [i * FRAME_NS for i in range(12)], 32, 32).read_bytes()
    header = sound.index(b"moov")
    path = tmp_path / "b.mp4"
    refused = 0
    for attempt in range(120):
        data = bytearray(sound)
        for at in rng.integers(header if attempt % 2 else 0, len(data), rng.integers(1, 12)):
            data[at] = rng.integers(0, 256)
        path.write_bytes(data)
        try:
            probe(path)
            assert sum(1 for _ in decode(path)) <= 12
        except UnreadableVideo:
            refused += 1
    assert 10 < refused < 110


@pytest.mark.parametrize(("step_s", "said"), [(21_600.0, "lie 2.16e+04 s apart"), (0.04e-3, "2.51e+04 a second")])
def test_stamps_in_another_unit_are_refused_with_the_rate_that_they_say(
    tmp_path: Path, step_s: float, said: str
) -> None:
    with pytest.raises(UnreadableVideo, match=re.escape(said)) as caught:
        probe(write(tmp_path / "a.mp4", [round(number * step_s * 1e9) for number in range(13)]))
    assert "another unit" in caught.value.hint
