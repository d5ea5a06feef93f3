"""What a recording is, measured from its packets rather than believed from its header."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.recordings import RateChange, SizeChange, VideoInfo
from wibam_core.errors import UnreadableVideo
from wibam_core.video.packets import FilePackets, Look
from wibam_core.video.picture import Size
from wibam_core.video.recording import Recording
from wibam_core.video.timeline import UNUSED, TimedFile, Timeline, read_timeline

#: Intervals that differ from the usual one by more than this share make a frame rate variable.
_RATE_TOLERANCE = 0.1
#: A recording whose timestamps span more has wrong timestamps.
_MAX_HOURS = 48
#: Frames a second of a camera over a road; stamps that say less or more are in another unit.
_SLOWEST_HZ, _FASTEST_HZ = 0.5, 1000.0
#: Segments whose rates differ by more than this factor were recorded in different modes, and with at least so many
#: frames a segment tells its rate.
_OTHER_RATE, _FEWEST_TIMED = 1.5, 10
#: Pictures whose aspect ratios differ by more than this share show different things.
_ASPECT_TOLERANCE = 0.01
#: Programs round the width of stretched pictures differently, to even numbers or multiples of four, px.
_STRETCHED_WITHIN_PX = 4


def probe(recording: Path | Recording) -> VideoInfo:
    """Measure a recording: as `measure`, without the times."""
    return measure(recording)[0]


def measure(recording: Path | Recording, size_px: Size | None = None) -> tuple[VideoInfo, NDArray[np.int64]]:
    """Measure a recording: reads all of it, decodes some frames.

    Args:
        recording: its file or files.
        size_px: width and height that its calibration is for, by which it is chosen whether pictures whose pixels
            are not square are stretched; None: they stay as they are.

    Returns:
        What it is, and the presentation times (N,) in ns of all its frames, ascending. Not all of them need decode.

    Raises:
        UnreadableVideo: not a video, no video stream, an unknown codec, too large a frame, cut off, no frame
            that can be decoded, pictures that cannot be brought to one size, or files in no order.
    """
    recording = Recording.at(recording) if isinstance(recording, Path) else recording
    timeline = read_timeline(recording, look=True)
    times_ns = timeline.times_ns
    named = timeline.files[0].packets.file.name
    intervals_ns = np.diff(times_ns)
    usual_ns = _usual_interval_ns(intervals_ns)
    if not _SLOWEST_HZ <= 1e9 / usual_ns <= _FASTEST_HZ:
        raise UnreadableVideo(
            f"by their time stamps, the frames of {named} lie {usual_ns / 1e9:.3g} s apart: {1e9 / usual_ns:.3g} a "
            "second",
            hint="The stamps are damaged or in another unit than the file says. Export the recording anew with the "
            f"camera's rate; between {_SLOWEST_HZ:g} and {_FASTEST_HZ:g} frames a second can be used.",
        )
    hours = float(times_ns[-1] - times_ns[0]) / 3.6e12
    if hours > _MAX_HOURS:
        raise UnreadableVideo(f"the timestamps of {named} span {hours:.0f} hours: they are damaged")
    looks = _looks(timeline)
    (width, height), changes = _one_size(looks, size_px, named)
    first, packets = looks[0][1], timeline.files[0].packets
    within = np.abs(intervals_ns - usual_ns) <= _RATE_TOLERANCE * usual_ns + packets.tick_ns
    info = VideoInfo(
        codec=packets.codec,
        container=packets.container,
        width_px=width,
        height_px=height,
        rotation_deg=first.orientation.rotation_deg,
        fps=1e9 / usual_ns,
        frames=len(times_ns),
        missing_frames=sum(file.packets.missing for file in timeline.files),
        first_ns=int(times_ns[0]),
        last_ns=int(times_ns[-1]),
        duration_s=float(times_ns[-1] - times_ns[0] + usual_ns) / 1e9,
        largest_gap_s=float(intervals_ns.max()) / 1e9,
        still_ns=_still_ns(timeline),
        variable_rate=not bool(within.all()),
        segments=list(timeline.segments) if len(timeline.segments) > 1 else [],
        files=len(timeline.files),
        missing_files=list(timeline.missing_files),
        doubled_frames=timeline.doubled,
        unused_frames=timeline.unused,
        stray_frames=timeline.stray,
        smeared_frames=sum(file.packets.smeared for file in timeline.files),
        unread_share=max(file.packets.unread_share for file in timeline.files),
        hidden_frames=sum(file.packets.hidden for file in timeline.files),
        stretches=max(file.packets.stretches for file in timeline.files),
        lead_in_frames=len(packets.lead_in),
        missing_s=sum(_missing_s(file.packets, usual_ns) for file in timeline.files),
        captured_fps=packets.captured_fps,
        mirrored=first.orientation.mirrored,
        stored_px=None if first.upright_px == (width, height) else first.upright_px,
        pixel_aspect=float(first.pixel_aspect),
        aspect_stated=first.aspect_stated,
        size_changes=changes,
        rate_changes=_rate_changes(timeline),
        interlaced=any(look.interlaced for _, look in looks),
        high_range=any(look.high_range for _, look in looks),
        has_clock=all(file.packets.has_clock for file in timeline.files),
        video_tracks=max(file.packets.tracks for file in timeline.files),
    )
    return info, times_ns


def _missing_s(packets: FilePackets, usual_ns: float) -> float:
    """How much earlier a file's pictures end than its header says, s; 0 for less than one picture."""
    if packets.said_ns is None:
        return 0.0
    missing_ns = packets.said_ns - (int(packets.stamps_ns.max()) + usual_ns)
    return float(missing_ns) / 1e9 if missing_ns > usual_ns else 0.0


def _looks(timeline: Timeline) -> list[tuple[int, Look]]:
    """What pictures look like, each with about its time, where that changes."""
    return [(_time_near(file, number), look) for file in timeline.files for number, look in file.packets.looks.items()]


def _still_ns(timeline: Timeline) -> tuple[int, int] | None:
    """The longest stretch of a file in which the picture stays the same."""
    found = [
        (_time_near(file, file.packets.still[0]), _time_near(file, file.packets.still[1]))
        for file in timeline.files
        if file.packets.still is not None
    ]
    return max(found, key=lambda stretch: stretch[1] - stretch[0], default=None)


def _rate_changes(timeline: Timeline) -> list[RateChange]:
    """Segments whose rate is another than that of the one before; those of a few frames tell none."""
    changes: list[RateChange] = []
    before_fps: float | None = None
    for segment in timeline.segments:
        begin = int(np.searchsorted(timeline.times_ns, segment.first_ns))
        end = int(np.searchsorted(timeline.times_ns, segment.last_ns, side="right"))
        if end - begin < _FEWEST_TIMED:
            continue
        fps = 1e9 / _usual_interval_ns(np.diff(timeline.times_ns[begin:end]))
        if before_fps is not None and max(fps / before_fps, before_fps / fps) > _OTHER_RATE:
            changes.append(RateChange(time_ns=segment.first_ns, fps=fps, before_fps=before_fps))
        before_fps = fps
    return changes


def _time_near(file: TimedFile, number: int) -> int:
    later = file.times_ns[number:]
    used = later[later != UNUSED]
    return int(used[0]) if len(used) else int(file.used_ns[-1])


def _one_size(looks: list[tuple[int, Look]], wanted_px: Size | None, name: str) -> tuple[Size, list[SizeChange]]:
    """The size that all pictures are brought to, and where that of the file changes.

    Raises:
        UnreadableVideo: pictures differ in shape, so that it is unknown which part of one the other shows.
    """
    first = looks[0][1].upright_px
    chosen = first
    if wanted_px is not None and any(_is_shown_at(look, wanted_px) for _, look in looks):
        chosen = wanted_px
    changes: list[SizeChange] = []
    for (_, before), (time_ns, look) in pairwise([looks[0], *looks]):
        width, height = look.upright_px
        if before.upright_px != look.upright_px:
            changes.append(SizeChange(time_ns=time_ns, width_px=width, height_px=height))
        if not any(_same_shape(size, chosen) for size in (look.upright_px, look.square_px)):
            raise UnreadableVideo(
                f"the picture of {name} changes from {first[0]}x{first[1]} to {width}x{height} px at "
                f"{time_ns / 1e9:.1f} s, which is another shape",
                hint="Cut the recording there and use one part, or let the camera record at one size; of several "
                "files leave out those of the other size.",
            )
    return chosen, changes


def _is_shown_at(look: Look, size_px: Size) -> bool:
    """Whether pictures are of a size as stored, or as players show them where pixels are not square."""
    if size_px == look.upright_px or look.square_px == look.upright_px:
        return size_px == look.upright_px
    apart = [abs(one - other) for one, other in zip(size_px, look.square_px, strict=True)]
    stretched = [one != other for one, other in zip(look.square_px, look.upright_px, strict=True)]
    return all(off <= (_STRETCHED_WITHIN_PX if is_wider else 0) for off, is_wider in zip(apart, stretched, strict=True))


def _same_shape(one: Size, other: Size) -> bool:
    return abs(one[0] * other[1] / (one[1] * other[0]) - 1) <= _ASPECT_TOLERANCE


def _usual_interval_ns(intervals_ns: NDArray[np.int64]) -> float:
    """Mean of the intervals that are no gaps: exact where the container rounds its timestamps."""
    median = float(np.median(intervals_ns))
    return float(intervals_ns[intervals_ns < 1.5 * median].mean())
