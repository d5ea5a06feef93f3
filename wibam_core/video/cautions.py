"""What a person should know about a recording before anything is computed from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from wibam_core.documents.recordings import Segment, VideoInfo
from wibam_core.documents.warnings import Caution

#: Longer than this without a frame is worth a word.
_LONGEST_GAP_S = 1.0
#: More than this share of a recording's frames unused is worth a word.
_UNUSED_SHARE = 0.02
#: Less than this of what a header promised is rounding, s.
_LEAST_MISSING_S = 1.0
#: Rates that differ by more than this share are two, and no dropped frames.
_OTHER_RATE = 0.25
_NAMED = 5
#: A picture may stay the same for so long without a word, s; fewer pictures a second than this are worth one.
_LONGEST_STILL_S = 10.0
_FEW_FPS = 4.0
#: Hardly any camera that films traffic takes more.
_MANY_FPS = 250.0


def cautions_of(info: VideoInfo) -> list[Caution]:
    """Everything about a recording that makes a result doubtful."""
    return [*_of_frames(info), *_of_time(info), *_of_pictures(info)]


def _of_frames(info: VideoInfo) -> Iterator[Caution]:
    if info.missing_frames:
        last = "frame is" if info.missing_frames == 1 else f"{info.missing_frames} frames are"
        yield Caution(
            code="cut_off",
            message=f"the file was cut off; its last {last} missing",
            hint="Copy the file from the camera again if what is missing matters; the rest is used.",
            details={"frames": info.missing_frames},
        )
    if info.missing_s > max(_UNUSED_SHARE * (info.duration_s + info.missing_s), _LEAST_MISSING_S):
        yield Caution(
            code="cut_off",
            message=f"by its header it lasts {info.missing_s:.1f} s longer than there are pictures: it was cut off, or "
            "something else in it lasts longer, such as sound",
            hint="Copy the file from the camera again if what is missing matters; the rest is used.",
            details={"missing_s": info.missing_s},
        )
    if info.missing_files:
        there, which = ("it is", "it") if len(info.missing_files) == 1 else ("they are", "them")
        names = ", ".join(info.missing_files[:_NAMED]) + (" and others" if len(info.missing_files) > _NAMED else "")
        yield Caution(
            code="chapter_missing",
            message=f"{names} should lie between the files, or before them: {there} not there",
            hint=f"Upload {which} with the others; until then nothing is seen by this camera meanwhile.",
            details={"files": list(info.missing_files)},
        )
    if info.stray_frames:
        have, are = ("1 frame has", "is") if info.stray_frames == 1 else (f"{info.stray_frames} frames have", "are")
        yield Caution(
            code="stray_stamps",
            message=f"{have} a time stamp far from those of the frames around, and {are} left out",
            hint="Nothing need be done about a few; many point to a damaged file or a faulty recorder.",
            details={"frames": info.stray_frames},
        )
    share = info.unused_frames / (info.frames + info.unused_frames)
    if share > _UNUSED_SHARE:
        yield Caution(
            code="frames_unused",
            message=f"{info.unused_frames} frames, {share:.0%} of the recording, have no time stamp of their own, or "
            "are not in its codec, and are left out",
            hint="Copy the file from the camera again, or export it anew with its time stamps.",
            details={"frames": info.unused_frames, "share": share},
        )
    if info.smeared_frames > _UNUSED_SHARE * info.frames:
        share = info.smeared_frames / info.frames
        yield Caution(
            code="frames_smeared",
            message=f"{info.smeared_frames} frames, {share:.0%} of the recording, follow frames that were lost on the "
            "way, and show parts of the picture where they were before",
            hint="Record on the camera's own card, or over a connection that loses nothing: things that move are "
            "placed wrongly there.",
            details={"frames": info.smeared_frames, "share": share},
        )
    if info.unread_share > _UNUSED_SHARE:
        yield Caution(
            code="part_unread",
            message=f"{info.unread_share:.0%} of a file is not used: before or behind what is read lies another "
            "recording, or another track that goes on with it",
            hint="Files were joined byte by byte, or the recorder began anew within one: give the parts as files of "
            "their own.",
            details={"share": info.unread_share},
        )
    for frames, code, what in (
        (info.hidden_frames, "frames_hidden", "are hidden by the file's edit list, as players hide them"),
        (info.lead_in_frames, "lead_in", "come before the first one that can be decoded by itself"),
    ):
        if frames > _UNUSED_SHARE * (info.frames + frames):
            yield Caution(
                code=code,
                message=f"{frames} frames, {frames / (info.frames + frames):.0%} of the file, {what}, and are left out",
                hint="Nothing need be done if the recording was cut so; else export it anew.",
                details={"frames": frames, "share": frames / (info.frames + frames)},
            )
    if info.video_tracks > 1:
        yield Caution(
            code="several_video_tracks",
            message=f"the file has {info.video_tracks} video tracks; the one that a player shows "
            f"({info.width_px}x{info.height_px} px) is used",
            hint="Export the other track to a file of its own if that is the recording.",
            details={"tracks": info.video_tracks},
        )


def _of_time(info: VideoInfo) -> Iterator[Caution]:
    if info.largest_gap_s > _LONGEST_GAP_S:
        yield Caution(
            code="recording_gap",
            message=f"there is no frame for {info.largest_gap_s:.1f} s",
            hint="Nothing is seen by this camera meanwhile; look whether the recording was joined from parts. If its "
            "clock was set then, as by a time server, nothing is missing, and all that follows is said to be later.",
            details={"gap_s": info.largest_gap_s},
        )
    unknown = [segment for segment in info.segments if segment.placed_by == "assumed"]
    if unknown:
        assumed = "no time was assumed to have passed"
        if info.missing_files:
            assumed = "what is missing was assumed to last as long as the file before it"
        yield Caution(
            code="gap_unknown",
            message=f"its clock starts anew {_at(unknown)}; how long the camera was off there is unknown, "
            f"and {assumed}",
            hint="Check the synchronisation after that moment, or upload the parts as files with their times.",
            details={"at_s": [segment.first_ns / 1e9 for segment in unknown]},
        )
    rough = [segment for segment in info.segments if segment.placed_by in ("creation_time", "name")]
    if rough:
        yield Caution(
            code="gap_rough",
            message=f"where {_files(rough)} begins is known by the file's date or name alone, to a second or so",
            hint="Check the synchronisation after that moment.",
            details={"at_s": [segment.first_ns / 1e9 for segment in rough]},
        )
    if info.stretches > 1:
        yield Caution(
            code="edited",
            message=f"its edit list shows {info.stretches} stretches of the file one after the other, as if no time "
            "lay between",
            hint="Take the recording as the camera made it: after the first stretch, times lack what was cut out.",
            details={"stretches": info.stretches},
        )
    if info.rate_changes:
        rate = info.rate_changes[0]
        yield Caution(
            code="rate_changes",
            message=f"from {rate.time_ns / 1e9:.1f} s on it has {rate.fps:.4g} frames a second, and "
            f"{rate.before_fps:.4g} before{_more(info.rate_changes)}",
            hint="Check that both parts run at normal speed and show the same section: cameras often cut the picture "
            "at high rates, and calibration holds for one section alone.",
            details={"at_s": [each.time_ns / 1e9 for each in info.rate_changes]},
        )
    if info.fps < _FEW_FPS:
        yield Caution(
            code="few_pictures",
            message=f"it has {info.fps:.2g} pictures a second, between which vehicles go many metres",
            hint=f"Record {_FEW_FPS:g} and more a second: fewer make tracks, speeds and conflicts inexact.",
            details={"fps": info.fps},
        )
    if info.fps > _MANY_FPS:
        yield Caution(
            code="many_pictures",
            message=f"by its time stamps it has {info.fps:.0f} pictures a second and lasts for "
            f"{(info.last_ns - info.first_ns) / 1e9:.1f} s",
            hint="Does it last so long in a player? If not, the stamps are in another unit than the file says: export "
            "the recording anew with the camera's rate.",
            details={"fps": info.fps},
        )
    captured = info.captured_fps
    if captured is not None and abs(captured / info.fps - 1) > _OTHER_RATE:
        yield Caution(
            code="other_speed",
            message=f"the camera took {captured:.4g} pictures a second, and the file shows {info.fps:.4g}: time runs "
            f"{captured / info.fps:.3g} times as slowly in it",
            hint="Record at normal speed, or export it with its true rate: speeds and times come out wrong otherwise.",
            details={"captured_fps": captured, "fps": info.fps},
        )
    if not info.has_clock:
        yield Caution(
            code="no_clock",
            message=f"the file holds no times; {info.fps:.2f} frames a second were assumed",
            hint="Put it into an MP4 file with the camera's true rate.",
            details={"fps": info.fps},
        )


def _of_pictures(info: VideoInfo) -> Iterator[Caution]:
    if info.size_changes:
        change = info.size_changes[0]
        yield Caution(
            code="size_changes",
            message=f"the picture's size changes to {change.width_px}x{change.height_px} px at "
            f"{change.time_ns / 1e9:.1f} s{_more(info.size_changes)}; all pictures are brought to "
            f"{info.width_px}x{info.height_px} px",
            hint="Check that the picture shows the same section before and after, and that the camera did not zoom.",
            details={"at_s": [each.time_ns / 1e9 for each in info.size_changes]},
        )
    stretched = info.stored_px is not None
    if abs(info.pixel_aspect - 1) > 0.01 and not (stretched and not info.size_changes):
        yield Caution(
            code="pixels_not_square",
            message=f"its pixels are {info.pixel_aspect:.3f} times as wide as high, and the picture is used as stored, "
            f"{info.width_px}x{info.height_px} px",
            hint="A calibration from a player's picture does not fit it: give the size of the picture that was "
            "calibrated.",
            details={"pixel_aspect": info.pixel_aspect},
        )
    if info.still_ns is not None and info.still_ns[1] - info.still_ns[0] >= _LONGEST_STILL_S * 1e9:
        first_s, last_s = (time_ns / 1e9 for time_ns in info.still_ns)
        yield Caution(
            code="picture_still",
            message=f"all pictures that were looked at between {first_s:.1f} and {last_s:.1f} s are alike",
            hint="Look at it: the camera froze, its lens was covered, or nobody was there in the dark. A frozen "
            "picture shows vehicles where they no longer are.",
            details={"from_s": first_s, "to_s": last_s},
        )
    if info.interlaced:
        yield Caution(
            code="interlaced",
            message="its pictures are interlaced: lines of two moments were joined into one picture",
            hint="Let the camera record progressive pictures; what moves fast is placed less exactly.",
        )
    if info.high_range:
        yield Caution(
            code="high_dynamic_range",
            message="its brightness is coded for high dynamic range, and looks dull to the detectors",
            hint="Let the camera record with standard dynamic range.",
        )


def _more(changes: Sequence[object]) -> str:
    return f", and changes {len(changes) - 1} times more" if len(changes) > 1 else ""


def _at(segments: list[Segment]) -> str:
    shown = ", ".join(f"{segment.first_ns / 1e9:.1f}" for segment in segments[:_NAMED])
    return f"at {shown} s" + (f" and {len(segments) - _NAMED} times more" if len(segments) > _NAMED else "")


def _files(segments: list[Segment]) -> str:
    shown = ", ".join(segment.file for segment in segments[:_NAMED])
    return shown + (f" and {len(segments) - _NAMED} more" if len(segments) > _NAMED else "")
