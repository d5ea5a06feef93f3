"""Tracks to conflicts."""

from __future__ import annotations

import json
import math
from collections import Counter
from typing import Any

from wibam_core.config import SafetyConfig
from wibam_core.formats.tracks import read_tracks
from wibam_core.safety.conflicts import Conflict, find_conflicts
from wibam_core.safety.uncertainty import Interval
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: SafetyConfig) -> Summary:
    """Write ``conflicts.json``: ``{"thresholds": {...}, "conflicts": [...]}``; null stands for "none"."""
    tracks = read_tracks(context.upstream["track"] / "tracks.parquet")
    conflicts = find_conflicts(tracks, config, progress=context.progress)
    result = {
        "thresholds": config.model_dump(),
        "conflicts": [to_json(number, conflict) for number, conflict in enumerate(conflicts)],
    }
    (context.output / "conflicts.json").write_text(json.dumps(result, indent=1, allow_nan=False), encoding="utf-8")
    kinds = Counter(conflict.kind.value for conflict in conflicts)
    return {"conflicts": len(conflicts), "tracks": len(tracks), "by_type": dict(sorted(kinds.items()))}


def to_json(number: int, conflict: Conflict) -> dict[str, Any]:
    """One conflict as JSON types."""
    return {
        "conflict_id": number,
        "track_ids": list(conflict.track_ids),
        "classes": [cls.value for cls in conflict.classes],
        "type": conflict.kind.value,
        "time_ns": conflict.time_ns,
        "x_m": conflict.x_m,
        "y_m": conflict.y_m,
        "speeds_mps": list(conflict.speeds_mps),
        "ttc_s": _finite(conflict.ttc_s),
        "ttc_interval_s": _interval(conflict.ttc),
        "probability": _finite(conflict.probability),
        "pet_s": _finite(conflict.pet_s),
        "pet_interval_s": _interval(conflict.pet),
        "deceleration_mps2": conflict.deceleration_mps2,
        "duration_s": conflict.duration_s,
        "heading_difference_deg": math.degrees(conflict.heading_difference_rad),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _interval(interval: Interval) -> list[float | None]:
    return [_finite(interval.low_s), _finite(interval.high_s)]
