"""Fit 7DoF boxes to the views of every vehicle."""

from __future__ import annotations

from wibam_core.artifacts.catalogue import ANNOTATIONS, FITS, LIFT_STATISTICS, RIG, SPLIT
from wibam_core.config import LiftConfig
from wibam_core.documents.split import SUBSETS
from wibam_core.lifting.instants import thinned, within_split
from wibam_core.lifting.lift import lift
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
