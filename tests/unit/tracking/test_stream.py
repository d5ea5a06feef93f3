from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from wibam_core.config import TrackConfig
from wibam_core.errors import InputError
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track, Vehicles3D
from wibam_core.tracking.stream import LAG_S, TrackStream, read_stream, write_stream
from wibam_core.tracking.tracker import Tracker

PERIOD_NS = 200_000_000
#: A third of the usual lag, for what does not depend on it: then a third of the footage shows it.
SHORT_LAG_S = LAG_S / 3
Place = Callable[[float], tuple[float, float, float]]
Detections = list[tuple[int, Vehicles3D]]


def driving(start_s: float, end_s: float, y: float) -> Place:
    """Somebody who drives past between two times."""

    def at(t: float) -> tuple[float, float, float]:
        return (-40.0 + 8.0 * (t - start_s), y, 0.0) if start_s <= t <= end_s else (np.nan, 0.0, 0.0)

    return at


def parked(x: float, y: float) -> Place:
    return lambda t: (x, y, 0.5)


def seen(places: list[Place], seconds: float, seed: int = 0) -> Detections:
    """What one camera detects, with noise."""
    rng = np.random.default_rng(seed)
    found: Detections = []
    for time_ns in range(0, int(seconds * 1e9), PERIOD_NS):
        rows = [at(time_ns * 1e-9) for at in places]
        boxes = np.array([[x, y, 0.75, 4.5, 1.8, 1.5, yaw] for x, y, yaw in rows if np.isfinite(x)]).reshape(-1, 7)
        boxes[:, :2] += rng.normal(0, 0.2, (len(boxes), 2))
        boxes[:, 6] += rng.normal(0, 0.05, len(boxes))
        n = len(boxes)
        sd = np.tile([0.3, 0.3, 0.1, 0.3, 0.1, 0.1, 0.1], (n, 1))
        classes = np.full(n, RoadUserClass.CAR.number)
        ids, scores = np.full(n, -1), np.full(n, 0.9)
        found.append((time_ns, Vehicles3D(time_ns, boxes, classes, ids, scores, sd, "camera")))
    return found


def streamed(stream: TrackStream, detections: Detections, every_s: float = 20.0) -> list[Track]:
    pieces, next_ns = [], every_s * 1e9
    for time_ns, found in detections:
        stream.step(time_ns, [found])
        if time_ns >= next_ns:
            pieces += stream.settled()
            next_ns += every_s * 1e9
    return pieces


def by_id(pieces: list[Track]) -> dict[int, Track]:
    """Whole tracks of their pieces."""
    whole: dict[int, Track] = {}
    for piece in pieces:
        before = whole.get(piece.track_id)
        if before is not None:
            assert piece.times_ns[0] > before.times_ns[-1], "pieces ascend"
            assert piece.vehicle_class is before.vehicle_class
            piece = Track(
                piece.track_id,
                piece.vehicle_class,
                *(
                    np.concatenate([getattr(before, name), getattr(piece, name)])
                    for name in ("times_ns", "boxes", "sd", "velocities_mps", "yaw_rates_radps")
                ),
            )
        whole[piece.track_id] = piece
    return whole


def whole_run(detections: Detections) -> list[Track]:
    tracker = Tracker(TrackConfig())
    for time_ns, found in detections:
        tracker.step(time_ns, [found])
    return tracker.tracks()


def test_who_drives_past_has_the_states_of_a_whole_run() -> None:
    detections = seen([driving(5 + 12 * k, 15 + 12 * k, 4.0 * (k % 3)) for k in range(6)], 90)
    stream = TrackStream(TrackConfig())
    found = by_id(streamed(stream, detections) + stream.ended())
    expected = whole_run(detections)
    assert len(expected) == 6 == len(found)
    for track in expected:
        same = next(other for other in found.values() if other.times_ns[0] == track.times_ns[0])
        np.testing.assert_array_equal(same.times_ns, track.times_ns)
        np.testing.assert_array_equal(same.boxes, track.boxes)
        np.testing.assert_array_equal(same.sd, track.sd)


def test_who_stays_is_one_track_of_all_instants_near_where_a_whole_run_has_it() -> None:
    seconds = 6 * LAG_S
    detections = seen([parked(3.0, 5.0), *(driving(10 + 40 * k, 20 + 40 * k, 0.0) for k in range(8))], seconds)
    stream = TrackStream(TrackConfig())
    found = by_id(streamed(stream, detections, every_s=60) + stream.ended())
    expected = whole_run(detections)
    assert len(found) == len(expected) == 9
    longest = max(found.values(), key=len)
    np.testing.assert_array_equal(longest.times_ns, [time_ns for time_ns, _ in detections])
    reference = max(expected, key=len)
    assert np.abs(longest.boxes - reference.boxes)[:, [0, 1, 6]].max() < 0.15
    assert len(np.unique(longest.boxes[:, 3:6], axis=0)) == 1, "one size"


def test_what_is_remembered_does_not_grow_with_the_footage() -> None:
    stream = TrackStream(TrackConfig(), SHORT_LAG_S)
    streamed(stream, seen([parked(3.0, 5.0)], 10 * SHORT_LAG_S))
    arrays = stream.to_arrays()
    most = 3 * SHORT_LAG_S * 1e9 / PERIOD_NS
    assert arrays["hits"].sum() < most
    assert len(arrays["instants"]) < most


def test_nothing_comes_before_what_is_pending() -> None:
    detections = seen([parked(3.0, 5.0), *(driving(10 + 30 * k, 20 + 30 * k, 0.0) for k in range(3))], 5 * SHORT_LAG_S)
    stream = TrackStream(TrackConfig(), SHORT_LAG_S)
    pending_ns = -1
    for number, (time_ns, found) in enumerate(detections):
        stream.step(time_ns, [found])
        if number % 50 == 49:
            assert all(piece.times_ns[0] >= pending_ns for piece in stream.settled())
            pending_ns = stream.pending_ns
    assert pending_ns > detections[-1][0] - 3 * SHORT_LAG_S * 1e9


def test_another_stream_goes_on_with_the_same_ids(tmp_path: Path) -> None:
    detections = seen([parked(3.0, 5.0), driving(25, 35, 0.0), driving(5, 15, 4.0)], 60)
    joint = 150  # 30 s: the first is parked, the second is driving past
    first = TrackStream(TrackConfig())
    before = by_id(streamed(first, detections[:joint]) + first.ended())
    write_stream(tmp_path / "open.npz", first)
    second = read_stream(tmp_path / "open.npz", TrackConfig())
    after = by_id(streamed(second, detections[joint:]) + second.ended())
    assert len(before) == 3
    assert len(after) == 2, "who has left before the joint is not there again"
    both = by_id([*before.values(), *after.values()])
    expected = whole_run(detections)
    assert len(both) == len(expected) == 3
    for track in expected:
        same = min(both.values(), key=lambda other: abs(int(other.times_ns[0] - track.times_ns[0])))
        np.testing.assert_array_equal(same.times_ns, track.times_ns)


def test_a_stream_goes_on_to_the_bit(tmp_path: Path) -> None:
    detections = seen([parked(3.0, 5.0), *(driving(10 + 30 * k, 20 + 30 * k, 0.0) for k in range(3))], 5 * SHORT_LAG_S)
    straight = TrackStream(TrackConfig(), SHORT_LAG_S)
    expected = streamed(straight, detections) + straight.ended()
    broken = TrackStream(TrackConfig(), SHORT_LAG_S)
    found: list[Track] = []
    for _number, (time_ns, of_camera) in enumerate(detections):
        broken.step(time_ns, [of_camera])
        if time_ns > 0 and time_ns % 20_000_000_000 == 0:
            found += broken.settled()
            write_stream(tmp_path / "open.npz", broken)
            broken = read_stream(tmp_path / "open.npz", TrackConfig(), SHORT_LAG_S)
    found += broken.ended()
    assert len(expected) > len(by_id(expected)) == 4, "the one that is parked comes in pieces"
    assert [track.track_id for track in found] == [track.track_id for track in expected]
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.boxes, other.boxes)


def test_what_is_no_stream_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "open.npz"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match="does not hold tracks to go on with"):
        read_stream(path, TrackConfig())
    stream = TrackStream(TrackConfig())
    streamed(stream, seen([parked(3.0, 5.0)], 10))
    arrays = stream.to_arrays()
    with path.open("wb") as file:
        np.savez(file, **(arrays | {"boxes": arrays["boxes"][:, :5]}))
    with pytest.raises(InputError, match="boxes has shape"):
        read_stream(path, TrackConfig())


def test_who_stands_is_waited_for_and_as_large_though_what_was_seen_first_is_forgotten() -> None:
    sizes: list[np.ndarray] = []
    for forgotten in (0, 39):
        tracker = Tracker(TrackConfig())
        detections = seen([parked(3.0, 5.0)], 10.0)
        for number, (_, found) in enumerate(detections):  # larger and larger boxes
            found.boxes[:, 3] = 4.0 + 0.01 * number
        for time_ns, found in detections[:40]:
            tracker.step(time_ns, [found])
        (hits,) = tracker.active
        del hits[:forgotten]
        for time_ns, found in detections[40:49]:
            tracker.step(time_ns, [found.where(np.zeros(1, bool))])
        assert tracker.active == (hits,), "hidden for longer than somebody who drives may be"
        tracker.step(detections[49][0], [detections[49][1]])
        assert tracker.active == (hits,) and hits[-1].time_ns == detections[49][0]
        sizes.append(tracker.to_arrays()["boxes"][:, 3])
    np.testing.assert_array_equal(sizes[0], sizes[1])
