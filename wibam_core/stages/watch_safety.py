"""Tracks of a run, however many, to conflicts: stretch by stretch, so that memory does not grow with the footage."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from wibam_core.artifacts.catalogue import CONFLICTS, TRACKS
from wibam_core.config import SafetyConfig
from wibam_core.formats.tracks import read_tracks, span_of
from wibam_core.safety.conflicts import Conflict, find_conflicts
from wibam_core.safety.document import conflicts_document
from wibam_core.stages.base import StageContext, Summary

#: Conflicts are looked for in stretches of so many seconds; of tracks so much before and after is looked at, too.
_STRETCH_S, _AROUND_S = 300, 60
_S = 1_000_000_000


def run(context: StageContext, config: SafetyConfig) -> Summary:
    """Write `CONFLICTS`: at most one for a pair of road users, the one with the smallest time to collision."""
    path = context.inputs.local(TRACKS)
    by_pair: dict[tuple[int, int], Conflict] = {}
    span = span_of(path)
    for share, conflicts in _of_stretches(path, span, config) if span is not None else ():
        for conflict in conflicts:
            known = by_pair.get(conflict.track_ids)
            if known is None or (conflict.ttc_s, conflict.pet_s) < (known.ttc_s, known.pet_s):
                by_pair[conflict.track_ids] = conflict
        context.progress(share, f"{len(by_pair)} conflicts", conflicts=len(by_pair))
    found = sorted(by_pair.values(), key=lambda conflict: (conflict.time_ns, conflict.track_ids))
    context.write(CONFLICTS, conflicts_document(found, config))
    context.progress(1.0)
    kinds = Counter(conflict.kind.value for conflict in found)
    road_users = Counter(" and ".join(sorted(conflict.classes)) for conflict in found)
    return {
        "conflicts": len(found),
        "by_type": dict(sorted(kinds.items())),
        "by_road_users": dict(sorted(road_users.items())),
    }


def _of_stretches(path: Path, span: tuple[int, int], config: SafetyConfig) -> Iterator[tuple[float, list[Conflict]]]:
    """How much of the time is done after each stretch, and the conflicts in it."""
    first, last = span[0] // (_STRETCH_S * _S), span[1] // (_STRETCH_S * _S)
    for number in range(first, last + 1):
        start, end = number * _STRETCH_S * _S, (number + 1) * _STRETCH_S * _S
        tracks = read_tracks(path, start - _AROUND_S * _S, end + _AROUND_S * _S)
        conflicts = find_conflicts(tracks, config, seed=number - first) if tracks else []
        yield (number - first + 1) / (last - first + 1), [c for c in conflicts if start <= c.time_ns < end]
