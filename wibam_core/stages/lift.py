"""Fit 7DoF boxes to the views of every vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wibam_core.artifacts.catalogue import ANNOTATIONS, FITS, LIFT_STATISTICS, RIG, SPLIT
from wibam_core.config import LiftConfig
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.lifting.lift import lift
from wibam_core.scene import AnnotatedInstant, Vehicles3D
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: LiftConfig) -> Summary:
    """Write `FITS` (at the instants of the split) and `LIFT_STATISTICS`.

    More instants are fitted than the split holds, since a denser track tells more of its vehicle; those of the split
    are written, without the vehicles that are left out of their subset.
    """
    split = context.read(SPLIT)
    instants = context.read(ANNOTATIONS)
    result = lift(thinned(instants, split, config.rate_hz), context.read(RIG), config, context.progress)
    fits = within_split(result.vehicles, split)
    written = {name: sum(len(v) for v in fits if v.time_ns in set(split.times_ns[name])) for name in SUBSETS}
    statistics = result.statistics.model_copy(update={"written": written})
    context.write(FITS, fits)
    context.write(LIFT_STATISTICS, statistics)
    return statistics.model_dump(exclude_none=True)


def thinned(instants: Sequence[AnnotatedInstant], split: Split, rate_hz: float) -> list[AnnotatedInstant]:
    """The instants to fit: those of the split, and others so that none is farther than a period from the next.

    Args:
        instants: associated, in order of time.
        split: all its instants are kept.
        rate_hz: others are kept a period of it after the last that was.
    """
    period_ns = 1e9 / rate_hz
    wanted = split.subset_of()
    kept: list[AnnotatedInstant] = []
    for instant in instants:
        if instant.time_ns in wanted or not kept or instant.time_ns - kept[-1].time_ns >= period_ns:
            kept.append(instant)
    return kept


def within_split(lifted: Sequence[Vehicles3D], split: Split) -> list[Vehicles3D]:
    """The fits at the instants of the split, without the vehicles that are left out of their subset."""
    subset_of = split.subset_of()
    return [
        vehicles.where(
            np.array(
                [i not in split.left_out_tracks[subset_of[vehicles.time_ns]] for i in vehicles.ids.tolist()], dtype=bool
            )
        )
        for vehicles in lifted
        if vehicles.time_ns in subset_of
    ]
