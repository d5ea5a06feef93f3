"""Conflicts as a document."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from wibam_core.config import SafetyConfig
from wibam_core.documents.base import finite
from wibam_core.documents.conflicts import ConflictRow, Conflicts, Exposure
from wibam_core.safety.area import AnalysableArea
from wibam_core.safety.conflicts import Conflict
from wibam_core.safety.track_errors import TrackErrors
from wibam_core.safety.uncertainty import Interval


def conflicts_document(
    conflicts: Sequence[Conflict],
    config: SafetyConfig,
    area: AnalysableArea | None = None,
    errors: TrackErrors | None = None,
) -> Conflicts:
    """The conflicts within the area, all without one, numbered in their order, with the thresholds that made them."""
    if area is None:
        return Conflicts(thresholds=config.model_dump(), conflicts=[_row(n, c) for n, c in enumerate(conflicts)])
    held = area.holds(np.array([[c.x_m, c.y_m] for c in conflicts]).reshape(-1, 2)).tolist()
    inside = [conflict for conflict, here in zip(conflicts, held, strict=True) if here]
    return Conflicts(
        thresholds=config.model_dump(),
        conflicts=[_row(number, conflict) for number, conflict in enumerate(inside)],
        exposure=Exposure(
            outlines_m=area.outlines(),
            area_m2=area.area_m2,
            hours=area.hours,
            road_user_hours=area.road_user_hours,
            road_user_km=area.road_user_km,
            conflicts_elsewhere=len(conflicts) - len(inside),
        ),
        track_errors=asdict(errors or TrackErrors()),
    )


def summary_of(document: Conflicts) -> dict[str, Any]:
    """How many conflicts, of which kinds, and what they are of, of a document with an area."""
    conflicts, exposure = document.conflicts, document.exposure
    assert exposure is not None
    kinds = Counter(conflict.type for conflict in conflicts)
    road_users = Counter(" and ".join(sorted(conflict.classes)) for conflict in conflicts)
    return {
        "conflicts": len(conflicts),
        "conflicts_elsewhere": exposure.conflicts_elsewhere,
        "analysable_m2": exposure.area_m2,
        "road_user_hours": round(exposure.road_user_hours, 4),
        "by_type": dict(sorted(kinds.items())),
        "by_road_users": dict(sorted(road_users.items())),
    }


def _row(number: int, conflict: Conflict) -> ConflictRow:
    return ConflictRow(
        conflict_id=number,
        track_ids=conflict.track_ids,
        classes=conflict.classes,
        type=conflict.kind.value,
        time_ns=conflict.time_ns,
        x_m=conflict.x_m,
        y_m=conflict.y_m,
        speeds_mps=conflict.speeds_mps,
        ttc_s=finite(conflict.ttc_s),
        ttc_interval_s=_ends(conflict.ttc),
        probability=finite(conflict.probability),
        ttc_probability=finite(conflict.ttc_probability),
        pet_probability=finite(conflict.pet_probability),
        pet_s=finite(conflict.pet_s),
        pet_interval_s=_ends(conflict.pet),
        deceleration_mps2=conflict.deceleration_mps2,
        duration_s=conflict.duration_s,
        heading_difference_deg=math.degrees(conflict.heading_difference_rad),
        measures={name: finite(value) for name, value in conflict.measures.items()},
    )


def _ends(interval: Interval) -> tuple[float | None, float | None]:
    return finite(interval.low_s), finite(interval.high_s)
