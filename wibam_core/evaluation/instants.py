"""Which instants of the test part are evaluated: those of the split, and others where only those are labelled.

And when each of their frames was exposed.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence

import numpy as np

from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.scene import FrameSet


def evaluated_instants(
    instants: Sequence[FrameSet], test_times_ns: Sequence[int], labels: LabelTimeline | None
) -> list[FrameSet]:
    """The instants to detect vehicles in, in order of time.

    Whoever labels by hand picks the moments. Where no frame of the split's instant is labelled, the instant nearest to
    a label takes part as well, one in every period of the split at most.

    Args:
        instants: all that have frames, in order of time.
        test_times_ns: the test part of the split, ascending.
        labels: by time; None where there are none.
    """
    wanted = set(test_times_ns)
    chosen = [instant for instant in instants if instant.time_ns in wanted]
    if labels is None or len(test_times_ns) < 2:
        return chosen
    first, period_ns = test_times_ns[0], int(np.median(np.diff(test_times_ns)))
    # the k-th period begins with the k-th instant of the split: they need not be equally long
    taken = {bisect_right(test_times_ns, i.time_ns) for i in chosen if _is_labelled(i, labels)}
    nearest: dict[int, tuple[int, FrameSet]] = {}
    for instant in instants:
        period = bisect_right(test_times_ns, instant.time_ns)
        within = first <= instant.time_ns < test_times_ns[-1] + period_ns
        if within and period not in taken and instant.time_ns not in wanted and _is_labelled(instant, labels):
            nearest[period] = min(
                nearest.get(period, (2**63, instant)),
                (labels.distance_ns(instant.time_ns), instant),
                key=lambda entry: entry[0],
            )
    added = [instant for _, instant in nearest.values()]
    return sorted([*chosen, *added], key=lambda instant: instant.time_ns)


def exposure_times(instants: Iterable[FrameSet]) -> dict[tuple[int, str], int]:
    """(instant, camera id) -> when that camera exposed its frame of the instant; all times in ns, reference clock."""
    return {(one.time_ns, camera_id): time for one in instants for camera_id, time in one.frame_times_ns.items()}


def _is_labelled(instant: FrameSet, labels: LabelTimeline) -> bool:
    return any(labels.at(time_ns) is not None for time_ns in instant.frame_times_ns.values())
