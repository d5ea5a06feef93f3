"""Tracks to conflicts, where tracks are good enough to tell."""

from __future__ import annotations

from collections import Counter

from wibam_core.artifacts.catalogue import CONFLICTS, FITS, SPLIT, TRACKS
from wibam_core.config import SafetyConfig
from wibam_core.safety.area import analysable_area
from wibam_core.safety.conflicts import find_conflicts
from wibam_core.safety.document import conflicts_document
from wibam_core.safety.measured_errors import measured_errors
from wibam_core.safety.track_errors import TrackErrors
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: SafetyConfig) -> Summary:
    """Write `CONFLICTS`."""
    tracks, validated = context.read(TRACKS), frozenset(context.read(SPLIT).times_ns["val"])
    fits = [fitted for fitted in context.read(FITS) if fitted.time_ns in validated]
    errors = measured_errors(tracks, fits, TrackErrors())
    found = find_conflicts(tracks, config, errors=errors, progress=context.progress)
    document = conflicts_document(found, config, analysable_area(tracks, config), errors)
    context.write(CONFLICTS, document)
    conflicts, exposure = document.conflicts, document.exposure
    assert exposure is not None
    kinds = Counter(conflict.type for conflict in conflicts)
    road_users = Counter(" and ".join(sorted(conflict.classes)) for conflict in conflicts)
    return {
        "conflicts": len(conflicts),
        "conflicts_elsewhere": exposure.conflicts_elsewhere,
        "analysable_m2": exposure.area_m2,
        "road_user_hours": round(exposure.road_user_hours, 4),
        "tracks": len(tracks),
        "by_type": dict(sorted(kinds.items())),
        "by_road_users": dict(sorted(road_users.items())),
    }
