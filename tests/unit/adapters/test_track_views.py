"""What is said of many tracks in little space: equal to what their rows say, thinned within a stated tolerance."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.adapters import track_views
from wibam_core.adapters.track_query import TrackQuery
from wibam_core.formats.tracks import write_tracks
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track

PERIOD_NS = 160_000_000
EVERYTHING = TrackQuery()


def track(number: int, places: np.ndarray, first: int = 0, kind: RoadUserClass = RoadUserClass.CAR) -> Track:
    """One that is at (N, 2) places in m, from the ``first`` instant on."""
    count = len(places)
    boxes = np.column_stack([places, np.tile([0.75, 4.5, 1.8, 1.5], (count, 1)), np.linspace(0.0, 1.0, count)])
    velocities = np.gradient(places, axis=0) / (PERIOD_NS / 1e9) if count > 1 else np.zeros((count, 2))
    times = (first + np.arange(count)) * PERIOD_NS
    return Track(number, kind, times, boxes, np.full((count, 7), 0.1), velocities, np.zeros(count))


def turning(count: int = 200) -> np.ndarray:
    """A quarter of a circle of 15 m, then straight on, far from the world's origin; with a little noise."""
    along = np.linspace(0.0, 60.0, count)
    angle = np.minimum(along / 15.0, np.pi / 2)
    rest = np.maximum(along - 15.0 * np.pi / 2, 0.0)
    places = np.column_stack([15.0 * np.sin(angle), 15.0 * (1 - np.cos(angle)) + rest])
    return places + np.array([512_345.0, 5_403_210.0]) + np.random.default_rng(0).normal(0.0, 0.02, places.shape)


@pytest.fixture(scope="module")
def tracks() -> list[Track]:
    still = np.tile([512_350.0, 5_403_205.0], (400, 1))
    return [track(3, turning()), track(7, still, 90, RoadUserClass.BUS), track(8, turning(60), 500)]


@pytest.fixture(scope="module")
def path(tracks: list[Track], tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("views") / "tracks.parquet"
    write_tracks(found, tracks)
    return found


def test_a_summary_counts_what_is_there(path: Path, tracks: list[Track]) -> None:
    found = track_views.summary(path, EVERYTHING)
    assert (found.states, found.tracks) == (660, 3)
    assert (found.first_ns, found.last_ns, found.period_ns) == (0, 559 * PERIOD_NS, PERIOD_NS)
    assert [(one.road_user_class, one.tracks, one.states) for one in found.classes] == [
        ("bus", 1, 400),
        ("car", 2, 260),
    ]
    places = np.concatenate([one.boxes[:, :2] for one in tracks])
    assert found.bounds_m == pytest.approx([*places.min(axis=0), *places.max(axis=0)], abs=0.006)
    assert found.fastest_mps == pytest.approx(max(np.hypot(*one.velocities_mps.T).max() for one in tracks), abs=0.006)


def test_a_summary_is_of_what_is_asked_for(path: Path) -> None:
    found = track_views.summary(path, TrackQuery(classes=(RoadUserClass.CAR,), start_ns=10 * PERIOD_NS))
    assert (found.states, found.tracks, found.first_ns) == (250, 2, 10 * PERIOD_NS)
    nothing = track_views.summary(path, TrackQuery(track_ids=(99,)))
    assert (nothing.states, nothing.tracks, nothing.classes) == (0, 0, [])
    assert (nothing.first_ns, nothing.period_ns, nothing.bounds_m, nothing.fastest_mps) == (None, None, None, None)


def test_compact_states_are_the_rows_rounded(path: Path, tracks: list[Track]) -> None:
    found = track_views.compact(path, TrackQuery(start_ns=80 * PERIOD_NS, end_ns=120 * PERIOD_NS, limit=1000))
    assert found.times_ns == [number * PERIOD_NS for number in range(80, 120)]
    assert found.next is None
    driven, stood = found.tracks
    assert (driven.track_id, driven.road_user_class, driven.at) == (3, "car", list(range(40)))
    assert (stood.track_id, stood.road_user_class, stood.at) == (7, "bus", list(range(10, 40)))
    assert driven.x_m == pytest.approx(tracks[0].boxes[80:120, 0], abs=0.0051)
    assert driven.yaw_rad == pytest.approx(tracks[0].boxes[80:120, 6], abs=0.00051)
    assert (driven.length_m, stood.x_m, stood.speed_mps) == ([4.5], [512_350.0], [0.0]), "what stays stands there once"


def test_pages_of_compact_states_are_the_whole(path: Path) -> None:
    from wibam_core.adapters.track_query import parse_cursor

    seen: list[tuple[int, int]] = []
    after = None
    while True:
        page = track_views.compact(path, TrackQuery(after=after, limit=77))
        seen += sorted((page.times_ns[at], one.track_id) for one in page.tracks for at in one.at)
        if page.next is None:
            break
        after = parse_cursor(page.next)
    assert len(seen) == len(set(seen)) == 660
    assert seen == sorted(seen)


def test_nobody_is_further_from_a_path_than_its_tolerance(path: Path, tracks: list[Track]) -> None:
    found = track_views.paths(path, EVERYTHING)
    assert (found.tracks, found.tolerance_m, found.period_ns) == (3, 0.2, PERIOD_NS)
    assert [one.track_id for one in found.paths] == [3, 7, 8]
    for one, way in zip(found.paths, tracks, strict=True):
        corners = np.column_stack([one.x_m, one.y_m])
        assert farthest(way.boxes[:, :2], corners) <= 0.2 + 1e-6
    assert 4 < len(found.paths[0].x_m) < 20, "a turn needs some corners, and not 200"
    assert len(found.paths[1].x_m) == 1, "who stands has one place"


def farthest(places: np.ndarray, corners: np.ndarray) -> float:
    """The largest distance of a place from a line of corners, m."""
    if len(corners) == 1:
        return float(np.hypot(*(places - corners[0]).T).max())
    distances = []
    for a, b in pairwise(corners):
        length = (b - a) @ (b - a)
        share = np.clip(((places - a) @ (b - a)) / length, 0.0, 1.0) if length else np.zeros(len(places))
        distances.append(np.hypot(*(places - a - share[:, None] * (b - a)).T))
    return float(np.min(distances, axis=0).max())


def test_paths_of_many_stay_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("_PATH_STATES", 700), ("_PATH_CORNERS", 100), ("_PATHS", 25)):
        monkeypatch.setattr(track_views, name, value)
    write_tracks(tmp_path / "t.parquet", [track(number, turning(40), number) for number in range(70)])
    found = track_views.paths(tmp_path / "t.parquet", EVERYTHING)
    assert found.tracks == 70
    assert [one.track_id for one in found.paths] == list(range(0, 70, 3))
    assert found.period_ns == 4 * PERIOD_NS, "every fourth instant of 2,800 states"
    assert sum(len(one.x_m) for one in found.paths) <= 100
    assert 0.2 < found.tolerance_m <= 6.4
    looked_at = [number for number in range(109) if number % 4 == 0]
    for one in found.paths:
        rows = [number - one.track_id for number in looked_at if 0 <= number - one.track_id < 40]
        assert farthest(turning(40)[rows], np.column_stack([one.x_m, one.y_m])) <= found.tolerance_m + 1e-6


def test_paths_of_a_few_states_of_many_are_not_thinned(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(track_views, "_PATH_STATES", 100)
    found = track_views.paths(path, TrackQuery(start_ns=500 * PERIOD_NS))
    assert found.period_ns == PERIOD_NS, "60 of 660 states match"


def test_who_is_there_between_the_instants_that_are_looked_at_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(track_views, "_PATH_STATES", 50)
    write_tracks(tmp_path / "t.parquet", [track(1, turning(100)), track(2, turning(1), 52)])
    found = track_views.paths(tmp_path / "t.parquet", EVERYTHING)
    assert (found.tracks, [one.track_id for one in found.paths]) == (2, [1])


STEPS = st.lists(st.tuples(*[st.floats(-3.0, 3.0)] * 2), min_size=1, max_size=60)


@given(
    steps=STEPS, closed=st.booleans(), jitter=st.sampled_from([0.0, 0.1, 0.5]), tolerance_m=st.sampled_from([0.2, 1.6])
)
def test_corners_keep_the_tolerance(
    steps: list[tuple[float, float]], closed: bool, jitter: float, tolerance_m: float
) -> None:
    line = np.array([512_345.0, 5_403_210.0]) + np.cumsum(steps, axis=0)
    line += jitter * np.random.default_rng(len(steps)).normal(size=line.shape)
    if closed:
        line = np.concatenate([line, line[::-1], line[:1]])
    corners = track_views.corners_of(line, tolerance_m)
    assert farthest(line, corners) <= tolerance_m + 1e-6
    assert np.hypot(*(corners[0] - line[0])) <= 0.01
    if len(corners) > 1:
        assert np.hypot(*(corners[-1] - line[-1])) <= 0.01


def test_speeds_are_rounded_down(tmp_path: Path) -> None:
    speeds = np.array([0.29, 4.994, 4.996, 5.0, 5.009, 0.0, 0.999999])
    there = replace(track(1, turning(len(speeds))), velocities_mps=np.column_stack([speeds, np.zeros(len(speeds))]))
    write_tracks(tmp_path / "t.parquet", [there])
    [found] = track_views.compact(tmp_path / "t.parquet", EVERYTHING).tracks
    assert found.speed_mps == [0.29, 4.99, 4.99, 5.0, 5.0, 0.0, 0.99]
