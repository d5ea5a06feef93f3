from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from wibam_core.errors import InputError, InvalidLabels
from wibam_core.formats.labels import read_labels, write_labels
from wibam_core.formats.tracks import read_tracks, write_tracks
from wibam_core.formats.vehicles3d import read_vehicles3d, write_vehicles3d
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import LabelledInstant, Track, Vehicles3D


def boxes(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low = [-30, -30, 0.5, 3, 1.5, 1.2, -3]
    return rng.uniform(low, [30, 30, 1, 6, 2.5, 3, 3], size=(n, 7))


def vehicles(time_ns: int, n: int, camera_id: str | None = None) -> Vehicles3D:
    sd = np.full((n, 7), 0.25)
    if n:
        sd[0] = np.nan
    return Vehicles3D.of(
        time_ns, boxes(n, time_ns % 97), np.arange(n) % 4, np.arange(n) - 1, np.linspace(0.3, 1, n), sd, camera_id
    )


def same(a: Vehicles3D, b: Vehicles3D) -> None:
    assert (a.time_ns, a.camera_id) == (b.time_ns, b.camera_id)
    for name in ("boxes", "classes", "ids", "scores", "sd"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def test_vehicles3d_round_trip_keeps_order_nan_and_empty_instants(tmp_path: Path) -> None:
    path = tmp_path / "v.parquet"
    given = [vehicles(2_000, 3, "north"), vehicles(1_000, 0, "north"), vehicles(1_000, 2, "east"), vehicles(500, 1)]
    write_vehicles3d(path, given)
    read = read_vehicles3d(path)
    for a, b in zip(sorted(given, key=lambda v: (v.time_ns, v.camera_id or "")), read, strict=True):
        same(a, b)
    times = pq.read_table(path)["time_ns"].to_numpy()
    assert (np.diff(times) >= 0).all()
    assert pq.ParquetFile(path).metadata.row_group(0).column(0).compression == "ZSTD"


def test_nothing_at_all_round_trips(tmp_path: Path) -> None:
    write_vehicles3d(tmp_path / "v.parquet", [])
    write_tracks(tmp_path / "t.parquet", [])
    write_labels(tmp_path / "l.parquet", [])
    assert read_vehicles3d(tmp_path / "v.parquet") == []
    assert read_tracks(tmp_path / "t.parquet") == []
    assert read_labels(tmp_path / "l.parquet") == []


def track(track_id: int, times: list[int]) -> Track:
    n = len(times)
    rng = np.random.default_rng(track_id)
    return Track(
        track_id, RoadUserClass.TRUCK, np.array(times), boxes(n, track_id), np.full((n, 7), 0.1),
        rng.normal(size=(n, 2)), rng.normal(size=n),
    )  # fmt: skip


def test_tracks_round_trip_sorted_by_time(tmp_path: Path) -> None:
    path = tmp_path / "tracks.parquet"
    given = [track(7, [10, 20, 30]), track(2, [5, 20])]
    write_tracks(path, given)
    table = pq.read_table(path)
    assert table["time_ns"].to_pylist() == [5, 10, 20, 20, 30]
    np.testing.assert_allclose(
        table["speed_mps"].to_numpy(), np.hypot(table["vx_mps"].to_numpy(), table["vy_mps"].to_numpy())
    )
    for a, b in zip(sorted(given, key=lambda t: t.track_id), read_tracks(path), strict=True):
        assert (a.track_id, a.vehicle_class) == (b.track_id, b.vehicle_class)
        for name in ("times_ns", "boxes", "sd", "velocities_mps", "yaw_rates_radps"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def test_two_tracks_of_one_id_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="unique"):
        write_tracks(tmp_path / "t.parquet", [track(1, [1]), track(1, [2])])


def test_a_file_of_another_kind_is_refused_by_name(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time_ns": [1]}), tmp_path / "t.parquet")
    with pytest.raises(InputError, match=r"t\.parquet has no column track_id"):
        read_tracks(tmp_path / "t.parquet")


def labelled(time_ns: int, n: int) -> LabelledInstant:
    v = Vehicles3D.of(time_ns, boxes(n, 3), np.arange(n) % 4, np.arange(n) - 1)
    return LabelledInstant(v, {"a": np.linspace(0, 1, n), "b": np.linspace(1, 0, n)} if n else {})


@pytest.mark.parametrize("name", ["labels.parquet", "labels.json"])
def test_labels_round_trip(tmp_path: Path, name: str) -> None:
    given = [labelled(300, 2), labelled(100, 3), labelled(200, 0)]
    write_labels(tmp_path / name, given)
    for a, b in zip(sorted(given, key=lambda i: i.vehicles.time_ns), read_labels(tmp_path / name), strict=True):
        same(a.vehicles, b.vehicles)
        assert set(a.visibility) == set(b.visibility)
        for camera in a.visibility:
            np.testing.assert_array_equal(a.visibility[camera], b.visibility[camera])


GOOD = {
    "time_ns": 1, "vehicle_id": 4, "class": "car", "x_m": 1.0, "y_m": 2, "z_m": 0.7, "length_m": 4.5, "width_m": 1.8,
    "height_m": 1.4, "yaw_rad": 0.1, "visibility": {"a": 0.5},
}  # fmt: skip


def test_a_plain_list_of_labels_is_read(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text(json.dumps([GOOD, {**{k: v for k, v in GOOD.items() if k != "vehicle_id"}, "class": "bus"}]))
    (instant,) = read_labels(path)
    assert instant.vehicles.ids.tolist() == [4, -1]
    assert instant.vehicles.classes.tolist() == [RoadUserClass.CAR.number, RoadUserClass.BUS.number]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"length_m": -1}, "not positive"),
        ({"x_m": float("nan")}, "not finite"),
        ({"x_m": "far"}, "far"),
        ({"y_m": 1.1e7}, "more than 10,000 km from"),
        ({"time_ns": 2**62 + 1}, "no time of a recording"),
        ({"x_m": None}, "no x_m"),
        ({"class": "tram"}, "tram"),
        ({"visibility": {"a": 1.5}}, "visibility in a"),
        ({"visibility": [1]}, "labels.json"),
        ({"time_ns": None}, "no time_ns"),
    ],
)
def test_wrong_labels_are_refused_in_words(tmp_path: Path, change: dict, match: str) -> None:
    path = tmp_path / "labels.json"
    path.write_text(json.dumps([{**GOOD, **change}]))
    with pytest.raises(InvalidLabels, match=match) as caught:
        read_labels(path)
    assert caught.value.hint


def test_labels_of_a_national_grid_are_read_and_empty_instants_beyond_all_recordings_are_not(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text(json.dumps([{**GOOD, "x_m": 500_000.0, "y_m": 9_900_000.0}]))
    (found,) = read_labels(path)
    assert found.vehicles.boxes[0, :2].tolist() == [500_000.0, 9_900_000.0]
    for time_ns in (2**62 + 1, -(2**63)):
        path.write_text(json.dumps({"labels": [GOOD], "empty_instants": [time_ns]}))
        with pytest.raises(InvalidLabels, match="no time of a recording"):
            read_labels(path)


def test_one_vehicle_twice_at_one_instant_is_refused(tmp_path: Path) -> None:
    (tmp_path / "labels.json").write_text(json.dumps([GOOD, GOOD]))
    with pytest.raises(InvalidLabels, match="twice"):
        read_labels(tmp_path / "labels.json")


@pytest.mark.parametrize("content", [b"\xff\x00garbage", b"garbage", b"{", b"[" * 200_000])
@pytest.mark.parametrize("name", ["labels.parquet", "labels.json"])
def test_garbage_is_told_the_format(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidLabels, match="is neither Parquet nor JSON") as caught:
        read_labels(tmp_path / name)
    assert all(column in caught.value.hint for column in (*GOOD, "Parquet", "JSON", "docs/site-format.md"))


@pytest.mark.parametrize("change", [{"time_ns": 10**30}, {"vehicle_id": 10**30}])
def test_numbers_that_no_column_holds_are_refused(tmp_path: Path, change: dict) -> None:
    (tmp_path / "labels.json").write_text(json.dumps([{**GOOD, **change}]))
    with pytest.raises(InvalidLabels):
        read_labels(tmp_path / "labels.json")


@pytest.mark.parametrize("content", ["{", "3", '{"labels": 3}', "[1]"])
def test_files_that_hold_no_labels_are_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "labels.json").write_text(content)
    with pytest.raises(InvalidLabels):
        read_labels(tmp_path / "labels.json")
    (tmp_path / "labels.parquet").write_text(content)
    with pytest.raises(InvalidLabels):
        read_labels(tmp_path / "labels.parquet")
