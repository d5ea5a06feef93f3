import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.clocks import ClockMap, ClockPiece
from wibam_core.errors import InputError
from wibam_core.formats.clocks import ClockError, Clocks, read_clocks, write_clocks

clock_maps = st.builds(
    ClockMap,
    offset_ns=st.integers(-(10**12), 10**12),
    drift=st.floats(-1e-3, 1e-3, allow_nan=False),
)


@given(clocks=st.dictionaries(st.text("abcXYZ-_09", min_size=1, max_size=6), clock_maps, min_size=1, max_size=5))
def test_round_trip_is_exact_and_keeps_the_order(clocks, tmp_path_factory):
    path = tmp_path_factory.mktemp("clocks") / "clocks.json"
    write_clocks(path, Clocks(clocks))
    read = read_clocks(path)
    assert dict(read) == clocks
    assert list(read) == list(clocks)
    assert read.errors == {}


def test_errors_are_kept_for_the_cameras_that_have_them(tmp_path):
    path = tmp_path / "clocks.json"
    write_clocks(path, Clocks({"a": ClockMap(), "b": ClockMap(5, 1e-6)}, {"b": ClockError(1e6, 2e-6)}))
    assert read_clocks(path).errors == {"b": ClockError(1e6, 2e-6)}


def test_pieces_of_a_clock_are_kept_and_must_ascend(tmp_path):
    path = tmp_path / "clocks.json"
    clock = ClockMap(5, 1e-6, (ClockPiece(8 * 10**9, 60 * 10**9), ClockPiece(9 * 10**9, 61 * 10**9)))
    write_clocks(path, Clocks({"a": clock}))
    assert read_clocks(path)["a"] == clock
    backwards = json.loads(path.read_text())
    backwards["clocks"][0]["pieces"].reverse()
    path.write_text(json.dumps(backwards))
    with pytest.raises(InputError, match="ascend"):
        read_clocks(path)


@pytest.mark.parametrize(
    "change",
    [
        {"format": "other"},
        {"version": 2},
        {"clocks": []},
        {"clocks": [{"camera_id": "a", "offset_ns": 1.5, "drift": 0}]},
        {"clocks": [{"camera_id": "a", "offset_ns": 1, "drift": 3.0}]},
        {"clocks": [{"camera_id": "a", "offset_ns": 1, "drift": 0, "extra": 1}]},
        {"clocks": [{"camera_id": "a", "offset_ns": 1, "drift": 0}] * 2},
    ],
)
def test_malformed_files_are_refused(tmp_path, change):
    path = tmp_path / "clocks.json"
    good = {"format": "wibam-clocks", "version": 1, "clocks": [{"camera_id": "a", "offset_ns": 1, "drift": 0.0}]}
    path.write_text(json.dumps(good))
    assert dict(read_clocks(path)) == {"a": ClockMap(1, 0.0)}
    path.write_text(json.dumps({**good, **change}))
    with pytest.raises(InputError, match=r"clocks\.json"):
        read_clocks(path)


def test_a_missing_file_says_so(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_clocks(tmp_path / "clocks.json")
