"""How loud a recording's sound is over time, in bands of frequency: all that is kept of it. It is untrusted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import av
import numpy as np
from av.audio.frame import AudioFrame
from av.audio.stream import AudioStream
from av.container import InputContainer
from numpy.typing import NDArray

from wibam_core.video.recording import Recording
from wibam_core.video.source import CODECS, ns_from_pts, open_container, video_streams
from wibam_core.video.timeline import UNUSED, TimedFile, read_timeline

Array = NDArray[np.float64]

_STEPS_PER_S = 40
#: Loudness is told once in so long.
STEP_S = 1 / _STEPS_PER_S
#: Limits of the bands, Hz: wind and the hum of engines and mains lie below, which microphones do not share.
BANDS_HZ = (250.0, 700.0, 1500.0, 3000.0, 6000.0)
#: Decoders of sound that may read an upload.
_CODECS = (
    *("aac", "mp2", "mp2float", "mp3", "mp3float", "ac3", "eac3", "opus", "vorbis", "flac", "alac", "wmav1", "wmav2"),
    *("pcm_s16le", "pcm_s16be", "pcm_s24le", "pcm_s24be", "pcm_s32le", "pcm_f32le", "pcm_u8", "pcm_alaw", "pcm_mulaw"),
    *("adpcm_ima_wav", "adpcm_ima_qt", "adpcm_ms", "adpcm_swf", "g726", "g726le", "amrnb", "amrwb", "nellymoser"),
)
_RATES_HZ = (4_000, 192_000)
_MOST_CHANNELS = 16
#: Longer frames are those of damaged files.
_MOST_SAMPLES = 1 << 20
#: So much of a recording is listened to.
_LONGEST_S = 3600.0
#: More steps than this that lie beyond are no stray stamps.
_STRAY_STEPS = 1000
#: A stamp that is farther from where the sound before ends begins anew.
_JUMP_S = 0.05
#: Switching a camera on and off is heard in every recording at its ends.
_ENDS_S = 2.0


@dataclass(frozen=True, eq=False)
class Sound:
    """Loudness on the recording's own clock.

    Attributes:
        first_s: the middle of the first step.
        power: (N, bands) loudness of each step in each of `BANDS_HZ`, in one unit of power; nan where the
            recording has no sound.
    """

    first_s: float
    power: Array

    @property
    def times_s(self) -> Array:
        """(N,) the middles of all steps."""
        return np.asarray(self.first_s + STEP_S * np.arange(len(self.power)), dtype=np.float64)

    def within(self, begin_s: float, end_s: float) -> Sound:
        """What of it lies between two times, without what switching the camera sounds like."""
        times = self.times_s
        kept = np.flatnonzero((times >= begin_s + _ENDS_S) & (times <= end_s - _ENDS_S))
        if not len(kept):
            return Sound(begin_s, np.empty((0, len(BANDS_HZ) - 1)))
        return Sound(float(times[kept[0]]), self.power[kept[0] : kept[-1] + 1])


def has_sound(recording: Recording) -> bool:
    """Whether a file of the recording has a sound track that can be decoded."""
    for file in recording.files:
        with open_container(file.path, file.name, (*CODECS, *_CODECS)) as container:
            if _track(container) is not None:
                return True
    return False


def hear(recording: Recording) -> Sound | None:
    """Loudness of a recording, of its first hour; None where it has no sound.

    Sound is put on the recording's clock by the video packets that it lies beside in its file, so that gaps and clocks
    that jump move both alike. What does not decode is left out.

    Args:
        recording: its file or files.

    Raises:
        UnreadableVideo: a file cannot be opened.
    """
    return _collected(step for file in read_timeline(recording).files for step in _steps(file))


def sound_of_samples(samples: Array, rate_hz: int, begin_s: float = 0.0) -> Sound:
    """Loudness of (N,) samples, full scale 1, the first of them at ``begin_s``.

    Raises:
        ValueError: they last for less than a step.
    """
    found = _collected(_Meter(rate_hz).feed(samples, round(begin_s * 1e9)))
    if found is None:
        raise ValueError(f"{len(samples)} samples last for less than {STEP_S} s")
    return found


def _collected(steps: Iterable[tuple[int, Array]]) -> Sound | None:
    """Of middles (ns) and loudness, in about the order of time."""
    by_number: dict[int, Array] = {}
    first_ns: int | None = None
    beyond = 0
    for at_ns, power in steps:
        first_ns = at_ns if first_ns is None else first_ns
        number = round((at_ns - first_ns) / (1e9 * STEP_S))
        if 0 <= number < _LONGEST_S / STEP_S:
            by_number[number] = power
        elif (beyond := beyond + 1) > _STRAY_STEPS:
            break
    if first_ns is None:
        return None
    power = np.full((max(by_number) + 1, len(BANDS_HZ) - 1), np.nan)
    for number, heard in by_number.items():
        power[number] = heard
    return Sound(first_ns / 1e9, power)


def _track(container: InputContainer) -> AudioStream | None:
    """The sound track that a player plays: the default one, else the first that can be decoded."""
    readable = [
        stream
        for stream in container.streams.audio
        if stream.codec_context is not None
        and stream.codec_context.name in _CODECS
        and _RATES_HZ[0] <= stream.codec_context.sample_rate <= _RATES_HZ[1]
        and 1 <= stream.codec_context.channels <= _MOST_CHANNELS
    ]
    return min(readable, key=lambda one: not one.disposition & av.stream.Disposition.default, default=None)


def _steps(file: TimedFile) -> Iterator[tuple[int, Array]]:
    """Middle (ns, on the recording's clock) and loudness of each step of a file's sound."""
    name, path = file.packets.file.name, file.packets.file.path
    with open_container(path, name, (*CODECS, *_CODECS)) as container:
        track = _track(container)
        if track is not None and len(file.used_ns):
            meter = _Meter(track.codec_context.sample_rate)
            for shift_ns, frame in _frames(container, track, file):
                yield from meter.add(frame, shift_ns)


def _frames(container: InputContainer, track: AudioStream, file: TimedFile) -> Iterator[tuple[int, AudioFrame]]:
    """Decoded sound, and by how much the recording's clock is before the file's there."""
    video = video_streams(container)[0]
    shifts = _shifts_ns(file)
    shift_ns, number = int(shifts[0]), 0
    packets = container.demux(video, track)
    while True:
        try:
            packet = next(packets)
        except (StopIteration, av.FFmpegError, EOFError):
            return
        if packet.stream_index == video.index:
            if packet.size:  # counted as `packets.numbered` does
                shift_ns = int(shifts[min(number, len(shifts) - 1)])
                number += 1
            continue
        with suppress(av.FFmpegError, EOFError):
            for frame in track.codec_context.decode(packet):
                yield shift_ns, frame


def _shifts_ns(file: TimedFile) -> NDArray[np.int64]:
    """(packets,) of each video packet, the time of its frame on the recording's clock minus its stamp."""
    numbers = file.packets.numbers
    used = file.times_ns[numbers] != UNUSED
    numbers, stamps = numbers[used], file.packets.stamps_ns[used]
    nearest = np.clip(np.searchsorted(numbers, np.arange(file.packets.packets), side="right") - 1, 0, None)
    return np.asarray((file.times_ns[numbers] - stamps)[nearest])


class _Meter:
    """Cuts sound into steps, wherever its frames begin and end.

    Args:
        rate_hz: samples a second.
    """

    def __init__(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._length = rate_hz // _STEPS_PER_S
        self._window = np.hanning(self._length)
        places = np.fft.rfftfreq(self._length, 1 / rate_hz)
        self._bands = [(places >= low) & (places < high) for low, high in pairwise(BANDS_HZ)]
        self._left: Array = np.empty(0)
        self._number = 0  # of the step that comes next, in its second
        self._ends_ns: int | None = None

    def add(self, frame: AudioFrame, shift_ns: int) -> Iterator[tuple[int, Array]]:
        if frame.pts is None or frame.sample_rate != self._rate_hz or not 0 < frame.samples <= _MOST_SAMPLES:
            return
        begin_ns = ns_from_pts(frame.pts, frame.time_base or Fraction(1, self._rate_hz)) + shift_ns
        yield from self.feed(_mono(frame), begin_ns)

    def feed(self, samples: Array, begin_ns: int) -> Iterator[tuple[int, Array]]:
        if self._ends_ns is not None and abs(begin_ns - self._ends_ns) > 1e9 * _JUMP_S:
            self._left, self._number = np.empty(0), 0
        begin_ns -= round(len(self._left) / self._rate_hz * 1e9)
        samples = np.concatenate([self._left, samples])
        begins = self._begins(len(samples) // self._length + 1)
        count = int(np.searchsorted(begins, len(samples), side="right")) - 1
        steps = samples[begins[:count, None] + np.arange(self._length)]
        power = np.abs(np.fft.rfft(steps * self._window, axis=1)) ** 2 / self._length**2
        for k in range(count):
            middle_ns = begin_ns + round((int(begins[k]) + 0.5 * self._length) / self._rate_hz * 1e9)
            yield middle_ns, np.array([power[k, band].sum() for band in self._bands])
        self._left = samples[begins[count] :]
        self._number = (self._number + count) % _STEPS_PER_S
        self._ends_ns = begin_ns + round(len(samples) / self._rate_hz * 1e9)

    def _begins(self, count: int) -> NDArray[np.int64]:
        """(count + 1,) samples until each next step begins: whole ones, however many a step has by the rate."""
        numbers = self._number + np.arange(count + 1, dtype=np.int64)
        begins = (2 * numbers * self._rate_hz + _STEPS_PER_S) // (2 * _STEPS_PER_S)
        return np.asarray(begins - begins[0])


def _mono(frame: AudioFrame) -> Array:
    """(samples,) the mean of all channels, full scale 1; what damaged files hold beyond is cut off."""
    values = frame.to_ndarray()
    channels = len(frame.layout.channels)
    values = values.reshape(channels, -1) if frame.format.is_planar else values.reshape(-1, channels).T
    kind = values.dtype.kind
    full = {"u": 128.0, "i": 2.0 ** (8 * values.dtype.itemsize - 1), "f": 1.0}[kind]
    samples = np.nan_to_num(values.astype(np.float64)) / full - (1.0 if kind == "u" else 0.0)
    return np.asarray(np.clip(samples, -1.0, 1.0).mean(axis=0))
