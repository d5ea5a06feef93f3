"""Which instants are fitted, and which of the fits belong to the split."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wibam_core.documents.split import Split
from wibam_core.scene import AnnotatedInstant, Vehicles3D


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
