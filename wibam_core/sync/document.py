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
from wibam_core.scene import SignalChange
from wibam_core.sync.offsets import SyncResult


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
            message=f"The clock of {camera_id} is ambiguous: {clock.matched} light changes also meet with an offset of "
            + " or ".join(f"{other.offset_s:+.2f} s" for other in clock.alternatives if other.matched >= clock.matched),
            hint="Compare a moving vehicle in two cameras, or record for longer.",
            details={
                "camera": camera_id,
                "offset_s": clock.offset_s,
                "alternatives_s": [other.offset_s for other in clock.alternatives],
            },
        )
        for camera_id, clock in document.cameras.items()
        if clock.ambiguous
    ]


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
        rms_before_s=rms_before_s,
        rms_after_s=rms_after_s,
        ambiguous=alignment is not None and alignment.is_ambiguous,
        alternatives=[
            Alternative(offset_s=offset_s, matched=matched)
            for offset_s, matched in (alignment.alternatives if alignment else ())
        ],
    )
