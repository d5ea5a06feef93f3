"""Fit 7DoF boxes to the views of every vehicle."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from wibam_core.config import LiftConfig
from wibam_core.dataset.split import SUBSETS, Split
from wibam_core.formats.annotations import read_annotations
from wibam_core.formats.rig import read_rig
from wibam_core.formats.vehicles3d import write_vehicles3d
from wibam_core.lifting.lift import lift
from wibam_core.scene import AnnotatedInstant, Vehicles3D
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: LiftConfig) -> Summary:
    """Write ``lifts.parquet`` (the instants of the split) and ``statistics.json``.

    More instants are fitted than the split holds, since a denser track tells more of its vehicle; those of the split
    are written, without the vehicles that are left out of their subset.
    """
    rig = read_rig(context.upstream["calibrate"] / "rig.json")
    instants = read_annotations(context.upstream["associate"] / "annotations.parquet")
    split = Split.from_json(json.loads((context.upstream["dataset"] / "split.json").read_text(encoding="utf-8")))
    result = lift(thinned(instants, split, config.rate_hz), rig, config, context.progress)
    labels = as_labels(result.vehicles, split)
    written = {name: sum(len(v) for v in labels if v.time_ns in set(split.times_ns[name])) for name in SUBSETS}
    statistics = result.statistics | {"written": written}
    write_vehicles3d(context.output / "lifts.parquet", labels)
    (context.output / "statistics.json").write_text(json.dumps(statistics, indent=1), encoding="utf-8")
    return statistics


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


def as_labels(lifted: Sequence[Vehicles3D], split: Split) -> list[Vehicles3D]:
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
