"""Which instants are evaluated: the split's where they are labelled, others only in their stead."""

from __future__ import annotations

import numpy as np
import pytest

from wibam_core.dataset.split import at_rate
from wibam_core.evaluation.instants import evaluated_instants
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.scene import FrameSet, LabelledInstant, Vehicles3D


def frames(rate_hz: float, seconds: float = 20.0) -> list[FrameSet]:
    times = np.rint(np.arange(0, seconds, 1 / rate_hz) * 1e9).astype(np.int64).tolist()
    return [FrameSet(time, {"a": time}, {"a": time}) for time in times]


def labelled(times_ns: list[int]) -> LabelTimeline:
    return LabelTimeline([LabelledInstant(Vehicles3D.of(time, np.empty((0, 7))), {}) for time in times_ns])


@pytest.mark.parametrize(("rate_hz", "split_hz"), [(12.5, 2.5), (10, 3), (30, 7), (10, 7), (12, 5), (6.25, 2)])
def test_where_every_frame_is_labelled_the_splits_instants_are_evaluated(rate_hz: float, split_hz: float) -> None:
    stored = frames(rate_hz)
    times = [instant.time_ns for instant in stored]
    split = at_rate(np.array(times), split_hz).tolist()
    assert [i.time_ns for i in evaluated_instants(stored, split, labelled(times))] == split


def test_of_several_labelled_instants_in_a_period_one_is_added() -> None:
    stored = frames(10.0)
    split = [instant.time_ns for instant in stored[::10]]
    extra = [stored[13].time_ns, stored[16].time_ns, stored[27].time_ns]
    found = [i.time_ns for i in evaluated_instants(stored, split, labelled(extra))]
    assert sorted(set(found) - set(split)) == [extra[0], extra[2]]
    assert found == sorted(found)


def test_without_labels_or_far_from_them_nothing_is_added() -> None:
    stored = frames(10.0)
    split = [instant.time_ns for instant in stored[50:150:5]]
    assert [i.time_ns for i in evaluated_instants(stored, split, None)] == split
    assert [i.time_ns for i in evaluated_instants(stored, split, labelled([stored[2].time_ns]))] == split
