"""Clocks that were set while a camera recorded, as by a time server.

Stamps that jump ahead by half a minute look like frames that are missing. Where light changes hardly meet under any
clock, the witnesses are asked how long such gaps lasted, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

from wibam_core.clocks import SignalChange
from wibam_core.documents.warnings import Caution
from wibam_core.errors import NoSignalChange, UnknownClock
from wibam_core.sync.hearing import SoundAlignment
from wibam_core.sync.paths import GroundPath
from wibam_core.sync.segments import InSegments, Span, synchronise_segments

#: Clocks may have been set if fewer changes meet than this share, and were if with them so set this much more do.
_BELIEVED_SHARE, _GAINED_SHARE = 0.8, 0.15
#: What lies less beside its stamps than this was not set.
_LEAST_S = 1.0


def synchronise_set_clocks(
    known_s: Mapping[str, Sequence[Span]],
    stamped_s: Mapping[str, Sequence[Span]],
    reference_id: str,
    *,
    changes: Mapping[str, Sequence[SignalChange]] | None = None,
    paths: Mapping[str, Sequence[GroundPath]] | None = None,
    sounds: Sequence[SoundAlignment] = (),
    max_offset_s: float | None = None,
) -> InSegments:
    """As `synchronise_segments`, of clocks that may have been set where stamps have a gap.

    Args:
        known_s: camera id -> segments in order, each later one's gap to the one before unknown.
        stamped_s: the same, cut also where stamps alone tell how long a gap lasted.
        reference_id: see `synchronise_segments`.
        changes: see there.
        paths: see there.
        sounds: see there.
        max_offset_s: see there.

    Raises:
        NoSignalChange: see there.
        UnknownClock: see there.
    """

    def found_in(segments_s: Mapping[str, Sequence[Span]], sounds: Sequence[SoundAlignment]) -> InSegments:
        return synchronise_segments(
            segments_s, reference_id, changes=changes, paths=paths, sounds=sounds, max_offset_s=max_offset_s
        )

    found = found_in(known_s, sounds)
    if least_share(found) >= _BELIEVED_SHARE or stamped_s == known_s:
        return found
    whole = [one for one in sounds if len(stamped_s[one.first_id]) == len(stamped_s[one.second_id]) == 1]
    with suppress(NoSignalChange, UnknownClock):
        as_set = found_in(stamped_s, whole)
        is_gained = least_share(as_set) >= least_share(found) + _GAINED_SHARE
        if is_gained and set_cautions(as_set, known_s) and not any(as_set.assumed.values()):
            return as_set
    return found


def least_share(found: InSegments) -> float:
    """Of the light changes that could meet, how many do: of the camera with the fewest; 1 without lights."""
    return min(found.shares.values(), default=1.0)


def set_cautions(found: InSegments, known_s: Mapping[str, Sequence[Span]]) -> list[Caution]:
    """Where clocks were set: a segment lies elsewhere beside the one before than stamped, and none of ``known_s``
    begins there."""
    return [
        Caution(
            code="clock_set",
            message=f"The clock of {camera_id} was set while it recorded: beside what was before, what follows "
            f"{one.from_s:.1f} s was {abs(by_s):.2f} s {'earlier' if by_s < 0 else 'later'} than its time stamps say, "
            "and lies there now",
            hint="Keep a camera's clock from being set while it records.",
            details={"camera": camera_id, "at_s": one.from_s, "shift_s": by_s},
        )
        for camera_id, placed in found.placed.items()
        for before_s, one in zip((0.0, *(one.shift_s for one in placed)), placed, strict=False)
        if abs(by_s := one.shift_s - before_s) >= _LEAST_S
        and one.from_s not in {begin_s for begin_s, _ in known_s[camera_id]}
    ]
