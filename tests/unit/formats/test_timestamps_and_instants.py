"""The small tables that say when frames were taken, and which of them form an instant."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.formats.instants import read_instants, write_instants
from wibam_core.formats.timestamps import read_timestamps, write_timestamps
from wibam_core.scene import FrameSet

TIME = st.integers(-(10**18), 10**18)
CAMERA = st.text("abc-_1", min_size=1, max_size=3)
INSTANT = st.dictionaries(CAMERA, st.tuples(TIME, TIME), min_size=1, max_size=4)


@given(st.dictionaries(CAMERA, st.sets(TIME, min_size=1, max_size=20).map(sorted), min_size=1, max_size=4))
def test_law_timestamps_round_trip(tmp_path_factory: pytest.TempPathFactory, times: dict[str, list[int]]) -> None:
    path = tmp_path_factory.mktemp("times") / "timestamps.parquet"
    write_timestamps(path, {camera_id: np.array(of_camera) for camera_id, of_camera in times.items()})
    assert {camera_id: of_camera.tolist() for camera_id, of_camera in read_timestamps(path).items()} == times


@given(st.dictionaries(TIME, INSTANT, max_size=5))
def test_law_instants_round_trip_in_order_of_time(
    tmp_path_factory: pytest.TempPathFactory, given_: dict[int, dict[str, tuple[int, int]]]
) -> None:
    path = tmp_path_factory.mktemp("instants") / "instants.parquet"
    instants = [
        FrameSet(time_ns, {c: t for c, (t, _) in frames.items()}, {c: t for c, (_, t) in frames.items()})
        for time_ns, frames in given_.items()
    ]
    write_instants(path, instants)
    found = {
        instant.time_ns: {c: (t, instant.local_times_ns[c]) for c, t in instant.frame_times_ns.items()}
        for instant in read_instants(path)
    }
    assert found == given_
    assert list(found) == sorted(given_)


def test_no_instants_are_a_table_too(tmp_path: Path) -> None:
    write_instants(tmp_path / "none.parquet", [])
    assert read_instants(tmp_path / "none.parquet") == []
