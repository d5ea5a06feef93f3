"""Tracks to conflicts, where tracks are good enough to tell."""

from __future__ import annotations

from wibam_core.artifacts.catalogue import CONFLICTS, FITS, SPLIT, TRACKS
from wibam_core.config import SafetyConfig
from wibam_core.safety.area import analysable_area
from wibam_core.safety.conflicts import find_conflicts
from wibam_core.safety.document import conflicts_document, summary_of
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
    return {**summary_of(document), "tracks": len(tracks)}
