"""Conflicts as a document."""

from __future__ import annotations

import math
from collections.abc import Sequence

from wibam_core.config import SafetyConfig
from wibam_core.documents.base import finite
from wibam_core.documents.conflicts import ConflictRow, Conflicts
from wibam_core.safety.conflicts import Conflict
from wibam_core.safety.uncertainty import Interval


def conflicts_document(conflicts: Sequence[Conflict], config: SafetyConfig) -> Conflicts:
    """All conflicts, numbered in their order, and the thresholds that made them."""
    return Conflicts(
        thresholds=config.model_dump(), conflicts=[_row(number, conflict) for number, conflict in enumerate(conflicts)]
    )


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
        pet_s=finite(conflict.pet_s),
        pet_interval_s=_ends(conflict.pet),
        deceleration_mps2=conflict.deceleration_mps2,
        duration_s=conflict.duration_s,
        heading_difference_deg=math.degrees(conflict.heading_difference_rad),
        measures={name: finite(value) for name, value in conflict.measures.items()},
    )


def _ends(interval: Interval) -> tuple[float | None, float | None]:
    return finite(interval.low_s), finite(interval.high_s)
