"""All cameras' clocks from what witnesses say: the lights, the traffic, or both, and what recordings sound like."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from wibam_core.clocks import SignalChange
from wibam_core.errors import UnknownClock
from wibam_core.sync.hearing import SoundAlignment
from wibam_core.sync.matching import Alignment, ChangeGroup, match_changes
from wibam_core.sync.offsets import Meeting, SyncResult, solve_clocks
from wibam_core.sync.paths import GroundPath
from wibam_core.sync.traffic import TrafficAlignment, align_by_traffic

#: Offset (s) and drift of a clock against another: ``t + offset + drift * t``.
Clock = tuple[float, float]
Spans = Mapping[str, tuple[float, float]]

#: Witnesses that differ by more than this mean different things, s.
APART_S = 0.4
#: Sound decides for an offset that lies as near as this, if no other does.
_SAME_CYCLE_S = 1.0


@dataclass(frozen=True, eq=False)
class Synchronised:
    """Clocks, and who says so.

    Attributes:
        result: clocks and light changes.
        traffic: what the road users say of each two cameras that share any.
        disagreeing: cameras whose light changes say otherwise than the traffic, which is believed.
        sounds: what the sound says of each two cameras that have any.
        by_sound: cameras whose lights leave several offsets open, between which the sound has chosen.
    """

    result: SyncResult
    traffic: tuple[TrafficAlignment, ...] = ()
    disagreeing: tuple[str, ...] = ()
    sounds: tuple[SoundAlignment, ...] = ()
    by_sound: tuple[str, ...] = ()

    @property
    def is_ambiguous(self) -> bool:
        """Whether nothing decides between several offsets of a camera."""
        return any(alignment.is_ambiguous for alignment in self.result.alignments.values())


def synchronise(
    spans_s: Spans,
    reference_id: str,
    *,
    changes: Mapping[str, Sequence[SignalChange]] | None = None,
    paths: Mapping[str, Sequence[GroundPath]] | None = None,
    sounds: Sequence[SoundAlignment] = (),
    max_offset_s: float | None = None,
    owners: Mapping[str, str] | None = None,
    ties: Sequence[Meeting] = (),
) -> Synchronised:
    """Offset and drift of every camera against the reference.

    The traffic decides where the lights repeat themselves, makes their answer more exact, and stands alone where a
    camera sees no light that another one does. Sound decides where these leave several offsets open, one of which it
    says, too; it moves no clock.

    Args:
        spans_s: camera id -> first and last time of its recording, on its own clock; all cameras.
        reference_id: the camera whose clock is kept.
        changes: camera id -> light changes; None: the lights are not asked.
        paths: camera id -> ways of road users; None: the traffic is not asked.
        sounds: what recordings sound like, two by two.
        max_offset_s: of offsets that explain all equally well, smaller ones than this are preferred.
        owners: id -> camera, where several ids are segments of one camera, which never see anything at the same time.
        ties: what is known of clocks beside what is seen.

    Raises:
        NoSignalChange: the traffic is not asked, and a camera shares no light change.
        UnknownClock: no witness connects a camera with the others.
    """
    lit = {c: list(seen) for c, seen in (changes or {}).items() if seen or paths is None}
    lit_reference = reference_id if reference_id in lit else next(iter(lit), reference_id)
    groups, alignments = _by_lights(lit, lit_reference, max_offset_s, spans_s, paths is None, owners)
    open_s = {lit_reference: [0.0]} | {c: one.open_s for c, one in alignments.items()}
    heard = [one for one in sorted(sounds, key=lambda one: -one.strength) if one.is_clear]
    traffic = _by_traffic(spans_s, paths, owners, open_s, heard)
    edges = [
        (one.first_id, one.second_id, (one.taken.offset_s, one.taken.drift))
        for one in sorted(traffic, key=lambda one: -one.taken.evidence)
        if one.is_clear
    ]
    near = _tree(lit_reference, edges)
    by_sound = _by_sound(lit_reference, edges, alignments, heard, spans_s)
    if (traffic or by_sound) and alignments:
        near_s = by_sound | {camera_id: offset_s for camera_id, (offset_s, _) in near.items() if camera_id in lit}
        groups, alignments = match_changes(lit, lit_reference, max_offset_s, spans_s, near_s, owners=owners)
    disagreeing = tuple(
        c
        for c, one in alignments.items()
        if c in near and _apart_s((one.taken.offset_s, one.taken.drift), near[c], spans_s[c]) > APART_S
    )
    if disagreeing:
        groups = [_without(group, disagreeing) for group in groups]
        groups = [group for group in groups if len(group.seen) >= 2]
        alignments = {c: one for c, one in alignments.items() if c not in disagreeing}
    by_certainty = sorted(alignments.items(), key=lambda item: item[1].is_ambiguous)
    edges += [(lit_reference, c, (one.taken.offset_s, one.taken.drift)) for c, one in by_certainty]
    rough = _tree(reference_id, edges)
    unknown = [camera_id for camera_id in spans_s if camera_id not in rough]
    if unknown:
        raise UnknownClock(
            f"the clock of {', '.join(unknown)} is unknown: too few light changes and road users are shared with the "
            "other cameras" + _considered(traffic, unknown) + _heard(heard, unknown),
            hint="Mark a signal head that two cameras see, record for longer, and check that the recordings overlap in "
            "time, that each is its camera's own, and that the calibration is right.",
            cameras=unknown,
        )
    starts = {camera_id: rough[camera_id] for camera_id in spans_s if camera_id != reference_id}
    meetings = [*ties, *(one.meeting for one in traffic if one.is_clear and one.meeting is not None)]
    result = solve_clocks(reference_id, groups, starts, alignments, meetings)
    return Synchronised(result, tuple(traffic), disagreeing, tuple(sounds), tuple(by_sound))


def _by_lights(
    lit: Mapping[str, Sequence[SignalChange]],
    lit_reference: str,
    max_offset_s: float | None,
    spans_s: Spans,
    alone: bool,
    owners: Mapping[str, str] | None,
) -> tuple[list[ChangeGroup], dict[str, Alignment]]:
    """Light changes matched over all cameras that see any; where they stand ``alone``, all cameras must."""
    if not lit:
        return [], {}
    return match_changes(lit, lit_reference, max_offset_s, spans_s, partial=not alone, owners=owners)


def _by_traffic(
    spans_s: Spans,
    paths: Mapping[str, Sequence[GroundPath]] | None,
    owners: Mapping[str, str] | None,
    open_s: Mapping[str, Sequence[float]],
    heard: Sequence[SoundAlignment],
) -> list[TrafficAlignment]:
    """Each two cameras; ``open_s`` are the offsets that the lights leave open, of cameras whose lights were matched.

    Of these, those that the sound says, too, are expected; where the lights leave none, the sound's own.
    """
    if paths is None:
        return []
    found = []
    by_sound = {(one.first_id, one.second_id): one.offset_s for one in heard}
    for first_id, second_id in combinations(spans_s, 2):
        if owners is not None and owners[first_id] == owners[second_id]:
            continue
        expected = [b - a for a in open_s.get(first_id, ()) for b in open_s.get(second_id, ())]
        offset_s = by_sound.get((first_id, second_id))
        if offset_s is not None:
            near = [other for other in expected if abs(other - offset_s) < _SAME_CYCLE_S]
            expected = near or expected or [offset_s]
        one = align_by_traffic(
            first_id, paths[first_id], spans_s[first_id], second_id, paths[second_id], spans_s[second_id], expected
        )
        if one is not None:
            found.append(one)
    return found


def _by_sound(
    root_id: str,
    edges: Sequence[tuple[str, str, Clock]],
    alignments: Mapping[str, Alignment],
    heard: Sequence[SoundAlignment],
    spans_s: Spans,
) -> dict[str, float]:
    """Offsets of cameras whose lights leave several open, where the traffic (``edges``) says nothing of them and the
    sound says one."""
    taken = {c: one.taken for c, one in alignments.items() if not one.is_ambiguous}
    by_lights = [(root_id, c, (offset.offset_s, offset.drift)) for c, offset in taken.items()]
    by_sound = [(one.first_id, one.second_id, (one.offset_s, 0.0)) for one in heard]
    by_traffic, clocks = _tree(root_id, edges), _tree(root_id, [*edges, *by_lights, *by_sound])
    found = {}
    for camera_id, alignment in alignments.items():
        if not alignment.is_ambiguous or camera_id in by_traffic or camera_id not in clocks:
            continue
        near = [
            offset.offset_s
            for offset in (alignment.taken, *alignment.alternatives)
            if not offset.excluded
            and _apart_s((offset.offset_s, offset.drift), clocks[camera_id], spans_s[camera_id]) < _SAME_CYCLE_S
        ]
        if len(near) == 1:
            found[camera_id] = near[0]
    return found


def _tree(root_id: str, edges: Sequence[tuple[str, str, Clock]]) -> dict[str, Clock]:
    """Clocks against the root's of all cameras that edges lead to, earlier edges first. An edge is (first camera,
    second camera, clock of the second against the first)."""
    clocks: dict[str, Clock] = {root_id: (0.0, 0.0)}
    grown = True
    while grown:
        grown = False
        for first_id, second_id, clock in edges:
            if (first_id in clocks) != (second_id in clocks):
                if first_id in clocks:
                    clocks[second_id] = _after(clocks[first_id], clock)
                else:
                    clocks[first_id] = _after(clocks[second_id], _inverse(clock))
                grown = True
                break
    return clocks


def _after(outer: Clock, inner: Clock) -> Clock:
    """The clock that maps by ``inner`` first."""
    return inner[0] * (1 + outer[1]) + outer[0], (1 + outer[1]) * (1 + inner[1]) - 1


def _inverse(clock: Clock) -> Clock:
    offset_s, drift = clock
    return -offset_s / (1 + drift), 1 / (1 + drift) - 1


def _apart_s(one: Clock, other: Clock, span_s: tuple[float, float]) -> float:
    """By how much two clocks differ in the middle of a recording."""
    middle_s = 0.5 * (span_s[0] + span_s[1])
    return abs(one[0] - other[0] + (one[1] - other[1]) * middle_s)


def _without(group: ChangeGroup, camera_ids: Sequence[str]) -> ChangeGroup:
    seen = {camera_id: change for camera_id, change in group.seen.items() if camera_id not in camera_ids}
    return ChangeGroup(group.signal_id, group.before, group.after, group.time_s, seen)


def _considered(traffic: Sequence[TrafficAlignment], unknown: Sequence[str]) -> str:
    """Offsets between which the traffic cannot decide, in words."""
    told = [
        f"{one.second_id} against {one.first_id} "
        + " or ".join(f"{c.offset_s:+.2f} s ({c.share:.0%})" for c in (one.taken, *one.rivals)[:4])
        for one in traffic
        if not one.is_clear and (one.first_id in unknown) != (one.second_id in unknown)
    ]
    return f" (the traffic cannot decide: {'; '.join(told)})" if told else ""


def _heard(heard: Sequence[SoundAlignment], unknown: Sequence[str]) -> str:
    """What the sound says of clocks that nothing else tells, in words."""
    told = [
        f"{one.second_id} against {one.first_id} {one.offset_s:+.1f} s"
        for one in heard
        if (one.first_id in unknown) != (one.second_id in unknown)
    ]
    return f" (the sound says {'; '.join(told)}, but is not believed alone)" if told else ""
