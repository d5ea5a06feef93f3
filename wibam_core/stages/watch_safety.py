"""Tracks of a run, however many, to conflicts: stretch by stretch, so that memory does not grow with the footage."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from wibam_core.artifacts.catalogue import CONFLICTS, TRACKS, WATCHED
from wibam_core.config import SafetyConfig
from wibam_core.documents.conflicts import Conflicts
from wibam_core.documents.watching import Watched
from wibam_core.formats.tracks import read_tracks, span_of
from wibam_core.safety.area import SeenGround
from wibam_core.safety.conflicts import Conflict, find_conflicts
from wibam_core.safety.document import conflicts_document, summary_of
from wibam_core.safety.track_errors import TrackErrors
from wibam_core.scene import Track
from wibam_core.stages.base import StageContext, Summary

#: Conflicts are looked for in stretches of so many seconds; of tracks so much before and after is looked at, too.
_STRETCH_S, _AROUND_S = 300, 60
_S = 1_000_000_000


def run(context: StageContext, config: SafetyConfig) -> Summary:
    """Write `CONFLICTS`: at most one for a pair of road users, the one with the smallest time to collision.

    How tracks err was measured where the network was made; where that is not known, they err as on other sites.
    """
    path = context.inputs.local(TRACKS)
    errors = _known_errors(context)
    span = span_of(path)
    stretches = list(_stretches(path, span)) if span is not None else []
    by_pair: dict[tuple[int, int], Conflict] = {}
    ground = SeenGround(_recorded(context.read(WATCHED)))
    for number, stretch in enumerate(stretches):
        tracks = stretch.read()
        ground.see(tracks, stretch.start_ns, stretch.end_ns)
        for conflict in find_conflicts(tracks, config, errors=errors, seed=number) if tracks else ():
            if not stretch.start_ns <= conflict.time_ns < stretch.end_ns:
                continue
            known = by_pair.get(conflict.track_ids)
            if known is None or (conflict.ttc_s, conflict.pet_s) < (known.ttc_s, known.pet_s):
                by_pair[conflict.track_ids] = conflict
        share = 0.9 * (number + 1) / len(stretches)
        context.progress(share, f"{len(by_pair)} conflicts", conflicts=len(by_pair))
    area = ground.area(config)
    for stretch in stretches:
        area = area.used_by(stretch.read(), stretch.start_ns, stretch.end_ns)
    found = sorted(by_pair.values(), key=lambda conflict: (conflict.time_ns, conflict.track_ids))
    document = conflicts_document(found, config, area, errors)
    context.write(CONFLICTS, document)
    context.progress(1.0)
    return summary_of(document)


@dataclass(frozen=True)
class _Stretch:
    """A part of the footage's time, from a time on until before another."""

    path: Path
    start_ns: int
    end_ns: int

    def read(self) -> list[Track]:
        """The tracks then, and what they did shortly before and after."""
        return read_tracks(self.path, self.start_ns - _AROUND_S * _S, self.end_ns + _AROUND_S * _S)


def _stretches(path: Path, span: tuple[int, int]) -> Iterator[_Stretch]:
    for number in range(span[0] // (_STRETCH_S * _S), span[1] // (_STRETCH_S * _S) + 1):
        yield _Stretch(path, number * _STRETCH_S * _S, (number + 1) * _STRETCH_S * _S)


def _recorded(watched: Watched) -> list[tuple[int, int]]:
    """When any camera recorded: pieces that follow each other."""
    found: list[tuple[int, int]] = []
    every = sorted((piece.from_ns, piece.to_ns) for camera in watched.cameras.values() for piece in camera.footage)
    for start, end in every:
        if found and start <= found[-1][1]:
            start, end = found[-1][0], max(end, found.pop()[1])
        found.append((start, end))
    return found


def _known_errors(context: StageContext) -> TrackErrors:
    if "track_errors" not in context.assets:
        return TrackErrors()
    measured = Conflicts.model_validate_json(context.assets["track_errors"].read_bytes()).track_errors
    return TrackErrors(**(measured or {}))
