"""Tracks to conflicts."""

from __future__ import annotations

from collections import Counter

from wibam_core.artifacts.catalogue import CONFLICTS, TRACKS
from wibam_core.config import SafetyConfig
from wibam_core.safety.conflicts import find_conflicts
from wibam_core.safety.document import conflicts_document
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: SafetyConfig) -> Summary:
    """Write `CONFLICTS`."""
    tracks = context.read(TRACKS)
    conflicts = find_conflicts(tracks, config, progress=context.progress)
    context.write(CONFLICTS, conflicts_document(conflicts, config))
    kinds = Counter(conflict.kind.value for conflict in conflicts)
    road_users = Counter(" and ".join(sorted(conflict.classes)) for conflict in conflicts)
    return {
        "conflicts": len(conflicts),
        "tracks": len(tracks),
        "by_type": dict(sorted(kinds.items())),
        "by_road_users": dict(sorted(road_users.items())),
    }
