"""Everything that the synchronisation rests on, for figures and for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from wibam_core.documents.synchronisation import (
    Alternative,
    CameraClock,
    ChangeGroup,
    Observation,
    SeenChange,
    Synchronisation,
)
from wibam_core.documents.warnings import Caution
from wibam_core.errors import NoSignalChange
from wibam_core.scene import SignalChange
from wibam_core.sync.offsets import SyncResult

#: A clock under which a smaller share of the changes meets is doubtful.
_MIN_SHARE = 0.5
#: Other offsets that a warning names.
_SAID = 4
#: Fewer changes than this that could meet say little.
_FEW = 3.0


def sync_document(changes: Mapping[str, Sequence[SignalChange]], result: SyncResult) -> Synchronisation:
    """All changes, which of them were matched, and how far each camera was from the reference before and after.

    Args:
        changes: camera id -> all changes seen, also those that were not used.
        result: what `estimate_clocks` made of the confident ones.
    """
    matched = {(c, change) for group in result.groups for c, change in group.seen.items()}
    return Synchronisation(
        method="signals",
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
        cameras={camera_id: _camera(camera_id, changes, result) for camera_id in result.clocks},
    )


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
    found = []
    for camera_id, clock in document.cameras.items():
        if clock.score is None or clock.could is None:
            continue
        details = {"camera": camera_id, "matched": clock.matched, "could": clock.could, "score": clock.score}
        said = f"of about {clock.could:.0f} light changes that {camera_id} could share with others, {clock.score:.0%}"
        hint = (
            "Check that the same signal id marks heads that show the same phase, that regions hold one head, and that "
            "the recordings' frame rates are right."
        )
        if clock.score < _MIN_SHARE and clock.ambiguous:
            raise NoSignalChange(f"{said} meet at best, and as many do with other offsets", hint=hint, **details)
        if clock.score < _MIN_SHARE:
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


def _camera(camera_id: str, changes: Mapping[str, Sequence[SignalChange]], result: SyncResult) -> CameraClock:
    clock, error = result.clocks[camera_id], result.errors[camera_id]
    rms_before_s, rms_after_s = result.rms_s(camera_id)
    alignment = result.alignments.get(camera_id)
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
    )
