"""Everything that the synchronisation rests on, for figures and for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from wibam_core.clocks import SignalChange
from wibam_core.documents.synchronisation import (
    Alternative,
    CameraClock,
    ChangeGroup,
    Observation,
    PlacedSegment,
    SeenChange,
    Synchronisation,
    TrafficPair,
)
from wibam_core.documents.warnings import Caution
from wibam_core.errors import NoSignalChange
from wibam_core.sync.hearing import SoundAlignment
from wibam_core.sync.matching import Alignment, Offset
from wibam_core.sync.offsets import SyncResult
from wibam_core.sync.segments import Placed
from wibam_core.sync.sound_pairs import sound_pair
from wibam_core.sync.traffic import TrafficAlignment

#: A clock under which a smaller share of the changes meets is doubtful.
LEAST_SHARE = 0.5
#: Other offsets that a warning names.
_SAID = 4
#: Fewer changes than this that could meet say little.
_FEW = 3.0


def sync_document(
    changes: Mapping[str, Sequence[SignalChange]],
    result: SyncResult,
    traffic: Sequence[TrafficAlignment] = (),
    disagreeing: Sequence[str] = (),
    placed: Mapping[str, Sequence[Placed]] | None = None,
    assumed: Mapping[str, Sequence[float]] | None = None,
    sounds: Sequence[SoundAlignment] = (),
    by_sound: Sequence[str] = (),
) -> Synchronisation:
    """All changes, which of them were matched, and how far each camera was from the reference before and after.

    Args:
        changes: camera id -> all changes seen, also those that were not used.
        result: what was made of the confident ones, and of the traffic.
        traffic: what road users say of each two cameras.
        disagreeing: cameras whose light changes were left out, since the traffic says otherwise.
        placed: camera id -> segments of its recording that were placed by themselves.
        assumed: camera id -> beginnings of segments that nothing places.
        sounds: what the sound says of each two cameras.
        by_sound: cameras between whose offsets the sound has chosen.
    """
    matched = {(c, change) for group in result.groups for c, change in group.seen.items()}
    return Synchronisation(
        method="signals" if not traffic else "both" if result.groups else "traffic",
        reference=result.reference_id,
        changes={
            camera_id: [seen_change(change, (camera_id, change) in matched) for change in seen]
            for camera_id, seen in changes.items()
        },
        groups=[
            ChangeGroup(
                signal=group.signal_id,
                before=group.before,
                after=group.after,
                time_s=group.time_s,
                observations=[
                    Observation(
                        camera=o.camera_id,
                        time_s=o.time_s,
                        delay_before_s=o.delay_before_s,
                        delay_after_s=o.delay_after_s,
                        residual_s=o.residual_s,
                    )
                    for o in result.observations
                    if o.group == g
                ],
            )
            for g, group in enumerate(result.groups)
        ],
        cameras={
            camera_id: _camera(camera_id, changes, result, traffic).model_copy(
                update={
                    "decided_by_sound": camera_id in by_sound,
                    "segments": [PlacedSegment(**vars(one)) for one in (placed or {}).get(camera_id, ())],
                    "assumed_from_s": list((assumed or {}).get(camera_id, ())),
                }
            )
            for camera_id in result.clocks
        },
        traffic=[_pair(one, result) for one in traffic],
        sound=[sound_pair(one, result) for one in sounds],
        disagreeing=list(disagreeing),
        rms_after_by_change_s=_by_change(result),
    )


def _pair(one: TrafficAlignment, result: SyncResult) -> TrafficPair:
    meeting = one.meeting
    residual_s = None
    if meeting is not None:
        mapped = [
            int(result.clocks[camera_id].to_reference_ns(round(at_s * 1e9)))
            for camera_id, at_s in ((one.first_id, meeting.first_s), (one.second_id, meeting.second_s))
        ]
        residual_s = (mapped[0] - mapped[1]) / 1e9
    told = [*((c, False) for c in one.rivals), *((c, True) for c in one.worse[:_SAID])]
    return TrafficPair(
        first=one.first_id,
        second=one.second_id,
        offset_s=one.taken.offset_s,
        drift_ppm=1e6 * (one.taken.drift if meeting is None else meeting.drift),
        matched=one.taken.matched,
        could=one.taken.could,
        score=round(one.taken.share, 4),
        clear=one.is_clear,
        sd_s=None if meeting is None else meeting.sd_s,
        drift_sd_ppm=None if meeting is None else 1e6 * meeting.drift_sd,
        residual_s=residual_s,
        alternatives=[
            Alternative(
                offset_s=c.offset_s,
                matched=c.matched,
                could=c.could,
                score=round(c.share, 4),
                drift_ppm=1e6 * c.drift,
                excluded=excluded,
            )
            for c, excluded in told
        ],
    )


def _by_change(result: SyncResult) -> dict[str, float]:
    squares: dict[str, list[float]] = {}
    for o in result.observations:
        group = result.groups[o.group]
        squares.setdefault(f"{group.before} to {group.after}", []).append(o.residual_s**2)
    return {kind: float(np.sqrt(np.mean(values))) for kind, values in sorted(squares.items())}


def _open_offsets(alignment: Alignment) -> list[Offset]:
    return [other for other in alignment.alternatives if not other.excluded]


def seen_change(change: SignalChange, matched: bool | None = None) -> SeenChange:
    """One change, its time in s on the camera's own clock."""
    return SeenChange(
        signal=change.signal_id,
        before=change.before,
        after=change.after,
        time_s=change.time_ns / 1e9,
        half_interval_s=change.half_interval_ns / 1e9,
        confidence=round(change.confidence, 4),
        matched=matched,
    )


def ambiguities(document: Synchronisation) -> list[Caution]:
    """Cameras whose light changes meet as well under another offset."""
    return [
        Caution(
            code="ambiguous_clock",
            message=f"The clock of {camera_id} is ambiguous: {clock.offset_s:+.2f} s was taken, but the signals repeat "
            "themselves, and their changes meet as well with an offset of "
            + " or ".join(f"{other.offset_s:+.2f} s ({other.score:.0%})" for other in _open(clock)[:_SAID])
            + (f" or {len(_open(clock)) - _SAID} others" if len(_open(clock)) > _SAID else ""),
            hint="Compare a moving vehicle in two cameras, record for longer, or mark further signals.",
            details={
                "camera": camera_id,
                "offset_s": clock.offset_s,
                "score": clock.score,
                "alternatives_s": [other.offset_s for other in _open(clock)],
            },
        )
        for camera_id, clock in document.cameras.items()
        if clock.ambiguous
    ]


def doubts(document: Synchronisation, max_offset_s: float | None) -> list[Caution]:
    """Cameras whose light changes hardly meet others', are few, or meet beyond what the user expects.

    Raises:
        NoSignalChange: fewer than half of the changes that could meet do, and under another offset as many.
    """
    found = [
        Caution(
            code="witnesses_disagree",
            message=f"The light changes of {camera_id} say otherwise than the road users that it shares with others; "
            "the road users are believed",
            hint="Check that the same signal id marks heads that show the same phase in that camera.",
            details={"camera": camera_id},
        )
        for camera_id in document.disagreeing
    ]
    found += [
        Caution(
            code="segment_unplaced",
            message=f"Where the recording of {camera_id} goes on after {', '.join(f'{at_s:.1f}' for at_s in shown)} s "
            "is assumed: neither light changes nor road users tell",
            hint="Upload the parts as files with their times, or mark a signal head that this camera shares.",
            details={"camera": camera_id, "at_s": clock.assumed_from_s},
        )
        for camera_id, clock in document.cameras.items()
        if (shown := clock.assumed_from_s[:_SAID])
    ]
    for camera_id, clock in document.cameras.items():
        if clock.score is None or clock.could is None:
            continue
        details = {"camera": camera_id, "matched": clock.matched, "could": clock.could, "score": clock.score}
        said = f"of about {clock.could:.0f} light changes that {camera_id} could share with others, {clock.score:.0%}"
        hint = (
            "Check that the same signal id marks heads that show the same phase, that regions hold one head, and that "
            "the recordings' frame rates are right."
        )
        if clock.decided_by_traffic:
            continue
        if clock.score < LEAST_SHARE and clock.ambiguous:
            raise NoSignalChange(f"{said} meet at best, and as many do with other offsets", hint=hint, **details)
        if clock.score < LEAST_SHARE:
            message = f"The clock of {camera_id} is doubtful: {said} meet"
            found.append(Caution(code="doubtful_clock", message=message, hint=hint, details=details))
        elif clock.could < _FEW:
            message = f"The clock of {camera_id} rests on few light changes: about {clock.could:.0f} could be matched"
            hint = "Record for longer, or mark further signals."
            found.append(Caution(code="few_light_changes", message=message, hint=hint, details=details))
        if max_offset_s is not None and abs(clock.offset_s) > max_offset_s:
            message = (
                f"The clock of {camera_id} is off by {clock.offset_s:+.2f} s, beyond sync.max_offset_s "
                f"({max_offset_s:g} s): no smaller offset explains its light changes"
            )
            hint = "Check when that recording was started, and raise sync.max_offset_s."
            found.append(Caution(code="unexpected_offset", message=message, hint=hint, details=details))
    return found


def _open(clock: CameraClock) -> list[Alternative]:
    """Other offsets that nothing excludes."""
    return [other for other in clock.alternatives if not other.excluded]


def _camera(
    camera_id: str,
    changes: Mapping[str, Sequence[SignalChange]],
    result: SyncResult,
    traffic: Sequence[TrafficAlignment],
) -> CameraClock:
    clock, error = result.clocks[camera_id], result.errors[camera_id]
    rms_before_s, rms_after_s = result.rms_s(camera_id)
    alignment = result.alignments.get(camera_id)
    shared = [one.taken.matched for one in traffic if one.is_clear and camera_id in (one.first_id, one.second_id)]
    open_to_lights = alignment is None or bool(_open_offsets(alignment))
    return CameraClock(
        offset_s=clock.offset_ns / 1e9,
        offset_sd_s=error.offset_sd_ns / 1e9,
        drift_ppm=clock.drift * 1e6,
        drift_sd_ppm=error.drift_sd * 1e6,
        changes=len(changes.get(camera_id, ())),
        matched=sum(camera_id in group.seen for group in result.groups),
        could=None if alignment is None else alignment.taken.could,
        score=None if alignment is None else round(alignment.taken.share, 4),
        rms_before_s=rms_before_s,
        rms_after_s=rms_after_s,
        ambiguous=alignment is not None and alignment.is_ambiguous,
        alternatives=[
            Alternative(
                offset_s=other.offset_s,
                matched=other.matched,
                could=other.could,
                score=round(other.share, 4),
                drift_ppm=other.drift * 1e6,
                excluded=other.excluded,
            )
            for other in (alignment.alternatives if alignment else ())
        ],
        road_users=max(shared, default=0),
        decided_by_traffic=bool(shared) and camera_id != result.reference_id and open_to_lights,
    )
