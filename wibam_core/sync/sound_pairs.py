"""What the sound of recordings says beside the clocks that were found, for figures and for people."""

from __future__ import annotations

from wibam_core.documents.synchronisation import SoundPair, Synchronisation
from wibam_core.documents.warnings import Caution
from wibam_core.sync.hearing import SoundAlignment
from wibam_core.sync.offsets import SyncResult
from wibam_core.sync.witnesses import APART_S


def sound_pair(one: SoundAlignment, result: SyncResult) -> SoundPair:
    """What the sound of two recordings says, beside the clocks that were found."""
    first_ns, second_ns = (
        int(result.clocks[camera_id].to_reference_ns(round(at_s * 1e9)))
        for camera_id, at_s in ((one.first_id, one.first_s), (one.second_id, one.second_s))
    )
    residual_s = (first_ns - second_ns) / 1e9
    return SoundPair(
        first=one.first_id,
        second=one.second_id,
        offset_s=one.offset_s,
        sd_s=one.sd_s,
        strength=round(one.strength, 2),
        contrast=round(one.contrast, 2),
        clear=one.is_clear,
        residual_s=residual_s,
        agrees=abs(residual_s) <= APART_S + one.way_s if one.is_clear else None,
    )


def sound_cautions(document: Synchronisation) -> list[Caution]:
    """Two cameras whose clocks mean another offset than their sound."""
    return [
        Caution(
            code="sound_disagrees",
            message=f"What {pair.first} and {pair.second} sound like meets with an offset of {pair.offset_s:+.2f} s, "
            f"{abs(pair.residual_s):.2f} s beside their clocks as they were found",
            hint="Compare a moving vehicle in the two cameras. If the clocks are right, the sound of one recording is "
            "not its own (another take, sound that was added later), or lies beside its pictures.",
            details={"cameras": [pair.first, pair.second], "offset_s": pair.offset_s, "residual_s": pair.residual_s},
        )
        for pair in document.sound
        if pair.agrees is False
    ]
