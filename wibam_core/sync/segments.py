"""Recordings that were interrupted: segments of one camera whose gaps nobody knows, each put on the reference clock.

A camera that was restarted has one oscillator, but how long it was off is unknown. So its segments are taken for
cameras of their own, which share a drift, and which never see anything at the same time. A segment that no witness
places stays where it was assumed to lie, against the one before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from wibam_core.clocks import ClockMap, ClockPiece, SignalChange
from wibam_core.errors import NoSignalChange, UnknownClock
from wibam_core.sync.hearing import SoundAlignment
from wibam_core.sync.matching import Alignment, Offset
from wibam_core.sync.offsets import Meeting, SyncResult
from wibam_core.sync.paths import GroundPath
from wibam_core.sync.witnesses import Synchronised, synchronise

#: First and last time of a segment, on its camera's own clock, s.
Span = tuple[float, float]

#: Segments of one camera share its oscillator to this, and of where they lie against each other nothing is known, s.
_SAME_DRIFT = 1e-7
_ANYWHERE_S = 1e6


@dataclass(frozen=True)
class Placed:
    """A segment that was put somewhere.

    Attributes:
        from_s: its beginning, on the camera's own clock.
        shift_s: by how much it lies later than was assumed.
        sd_s: standard deviation of its place on the reference clock, in the middle of what tells it.
        matched: light changes of it that other cameras saw, too.
    """

    from_s: float
    shift_s: float
    sd_s: float
    matched: int


@dataclass(frozen=True, eq=False)
class InSegments:
    """Clocks of recordings of several segments.

    Attributes:
        found: as of whole cameras; their clocks have pieces.
        placed: camera id -> segments that witnesses have placed.
        assumed: camera id -> beginnings (s, own clock) of segments that stay where they were assumed to lie.
        shares: camera id -> of the light changes of all its segments that could meet another camera's, how many do;
            without cameras whose changes are not compared.
    """

    found: Synchronised
    placed: Mapping[str, tuple[Placed, ...]] = field(default_factory=dict)
    assumed: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    shares: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Stretch:
    """One or more segments of a camera that keep their places against each other."""

    camera_id: str
    segments: tuple[Span, ...]

    @property
    def span_s(self) -> Span:
        return self.segments[0][0], self.segments[-1][1]

    @property
    def id(self) -> str:
        """No camera has such an id."""
        return f"{self.camera_id}#{self.segments[0][0]}"

    def and_(self, other: _Stretch) -> _Stretch:
        return _Stretch(self.camera_id, self.segments + other.segments)


def synchronise_segments(
    segments_s: Mapping[str, Sequence[Span]],
    reference_id: str,
    *,
    changes: Mapping[str, Sequence[SignalChange]] | None = None,
    paths: Mapping[str, Sequence[GroundPath]] | None = None,
    sounds: Sequence[SoundAlignment] = (),
    max_offset_s: float | None = None,
) -> InSegments:
    """As `synchronise`, of recordings whose segments may lie anywhere.

    Args:
        segments_s: camera id -> segments in order, each later one's gap to the one before unknown; all cameras.
        reference_id: the camera whose first segment's clock is kept.
        changes: camera id -> light changes; None: the lights are not asked.
        paths: camera id -> ways of road users; None: the traffic is not asked.
        sounds: what recordings of one segment sound like, two by two.
        max_offset_s: of offsets that explain all equally well, smaller ones than this are preferred.

    Raises:
        NoSignalChange: the traffic is not asked, and a camera shares no light change.
        UnknownClock: no witness connects a camera with the others.
    """
    stretches = {camera_id: [_Stretch(camera_id, (span,)) for span in spans] for camera_id, spans in segments_s.items()}
    while True:
        names = {s.id if k else s.camera_id: s for own in stretches.values() for k, s in enumerate(own)}
        lit = None if changes is None else {n: list(_changes_of(s, changes)) for n, s in names.items()}
        try:
            found = synchronise(
                {name: s.span_s for name, s in names.items()},
                reference_id,
                changes=lit,
                paths=None if paths is None else {n: list(_paths_of(s, paths)) for n, s in names.items()},
                sounds=sounds,
                max_offset_s=max_offset_s,
                owners={name: s.camera_id for name, s in names.items()},
                ties=_ties(stretches),
            )
        except (NoSignalChange, UnknownClock) as error:
            unknown = error.details.get("cameras") or [error.details.get("camera")]
            doubtful = [names[n] for n in unknown if n in names and len(stretches[names[n].camera_id]) > 1]
            doubtful = doubtful or [s for own in stretches.values() for s in own[1:]]
            if not doubtful:
                raise
        else:
            doubtful = list(_misplaced(stretches, names, found))
            if not doubtful:
                return _composed(stretches, names, found, lit or {})
        # The shortest first: what lies beside it may well be found.
        _keep_beside(stretches, min(doubtful, key=lambda s: s.span_s[1] - s.span_s[0]))


def _changes_of(stretch: _Stretch, changes: Mapping[str, Sequence[SignalChange]]) -> Iterator[SignalChange]:
    """Changes within the segments; one that was seen across a joint is none, since nobody knows how long it took."""
    for change in changes.get(stretch.camera_id, ()):
        first_s, last_s = ((change.time_ns + sign * change.half_interval_ns) / 1e9 for sign in (-1, 1))
        if any(begin_s - 1e-3 <= first_s and last_s <= end_s + 1e-3 for begin_s, end_s in stretch.segments):
            yield change


def _paths_of(stretch: _Stretch, paths: Mapping[str, Sequence[GroundPath]]) -> Iterator[GroundPath]:
    for path in paths.get(stretch.camera_id, ()):
        for begin_s, end_s in stretch.segments:
            inside = (path.times_s >= begin_s - 1e-3) & (path.times_s <= end_s + 1e-3)
            if inside.sum() > 2:
                yield GroundPath(*(getattr(path, name)[inside] for name in vars(path)))


def _ties(stretches: Mapping[str, Sequence[_Stretch]]) -> list[Meeting]:
    """That the segments of a camera share its drift."""
    return [
        Meeting(camera_id, s.id, float(np.mean(own[0].span_s)), float(np.mean(s.span_s)), 0.0, _ANYWHERE_S, _SAME_DRIFT)
        for camera_id, own in stretches.items()
        for s in own[1:]
    ]


def _misplaced(
    stretches: Mapping[str, Sequence[_Stretch]], names: Mapping[str, _Stretch], found: Synchronised
) -> Iterator[_Stretch]:
    """Later stretches whose place is ambiguous, or before the one that they follow."""
    clocks = found.result.clocks
    for name, stretch in names.items():
        if name == stretch.camera_id:
            continue
        alignment = found.result.alignments.get(name)
        own = stretches[stretch.camera_id]
        before = own[own.index(stretch) - 1]
        ended_ns = clocks[before.id if before.id in clocks else before.camera_id].to_reference_ns(
            round(before.span_s[1] * 1e9)
        )
        if (alignment is not None and alignment.is_ambiguous) or (
            clocks[name].to_reference_ns(round(stretch.span_s[0] * 1e9)) <= ended_ns
        ):
            yield stretch


def _keep_beside(stretches: dict[str, list[_Stretch]], stretch: _Stretch) -> None:
    """Leave a stretch where it lies against its neighbour: the one before, of the first the one after."""
    own = stretches[stretch.camera_id]
    k = max(own.index(stretch), 1)
    own[k - 1 : k + 1] = [own[k - 1].and_(own[k])]


def _composed(
    stretches: Mapping[str, Sequence[_Stretch]],
    names: Mapping[str, _Stretch],
    found: Synchronised,
    lit: Mapping[str, Sequence[SignalChange]],
) -> InSegments:
    """Clocks of whole cameras from those of their stretches."""
    result = found.result
    owner = {name: s.camera_id for name, s in names.items()}
    clocks, placed = {}, {}
    for camera_id, own in stretches.items():
        base = result.clocks[camera_id]
        pieces, told = [], []
        for stretch in own[1:]:
            clock = result.clocks[stretch.id]
            middle_ns = round(result.centres_s.get(stretch.id, float(np.mean(stretch.span_s))) * 1e9)
            shift_ns = int(clock.to_reference_ns(middle_ns) - base.to_reference_ns(middle_ns))
            pieces.append(ClockPiece(round(stretch.span_s[0] * 1e9), shift_ns))
            matched = sum(stretch.id in group.seen for group in result.groups)
            told.append(Placed(stretch.span_s[0], shift_ns / 1e9, result.sd_s(stretch.id, middle_ns / 1e9), matched))
        clocks[camera_id] = ClockMap(base.offset_ns, base.drift, tuple(pieces))
        placed[camera_id] = tuple(told)
    groups = tuple(replace(g, seen={owner[name]: change for name, change in g.seen.items()}) for g in result.groups)
    met = _met(names, result.alignments, lit)
    whole = SyncResult(
        reference_id=result.reference_id,
        clocks=clocks,
        errors={c: error for c, error in result.errors.items() if c in clocks},
        groups=groups,
        alignments={c: replace(one, taken=met[c]) for c, one in result.alignments.items() if c in clocks},
        observations=tuple(replace(o, camera_id=owner[o.camera_id]) for o in result.observations),
        centres_s={c: at_s for c, at_s in result.centres_s.items() if c in clocks},
    )
    traffic = tuple(
        replace(
            one,
            first_id=owner[one.first_id],
            second_id=owner[one.second_id],
            meeting=None
            if one.meeting is None
            else replace(one.meeting, first_id=owner[one.first_id], second_id=owner[one.second_id]),
        )
        for one in found.traffic
    )
    assumed = {c: tuple(span[0] for s in own for span in s.segments[1:]) for c, own in stretches.items()}
    disagreeing = tuple(dict.fromkeys(owner[name] for name in found.disagreeing))
    shares = {camera_id: one.share for camera_id, one in met.items()}
    return InSegments(Synchronised(whole, traffic, disagreeing, found.sounds, found.by_sound), placed, assumed, shares)


def _met(
    names: Mapping[str, _Stretch], alignments: Mapping[str, Alignment], lit: Mapping[str, Sequence[SignalChange]]
) -> dict[str, Offset]:
    """Camera id -> its first stretch's clock, and how many light changes of all its stretches meet and could.

    The changes of a later stretch that meet none at all could have, if those of another stretch do.
    """
    met: dict[str, Offset] = {}
    for name, alignment in alignments.items():
        camera_id, one = names[name].camera_id, alignment.taken
        clock = alignments[camera_id].taken if camera_id in alignments else Offset(0.0, 0.0, 0, 0.0)
        before = met.get(camera_id, replace(clock, matched=0, could=0.0))
        met[camera_id] = replace(before, matched=before.matched + one.matched, could=before.could + one.could)
    for name, stretch in names.items():
        if stretch.camera_id in met and name != stretch.camera_id and name not in alignments:
            before = met[stretch.camera_id]
            met[stretch.camera_id] = replace(before, could=before.could + len(lit.get(name, ())))
    return met
