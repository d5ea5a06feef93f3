"""MOTChallenge: what is written comes back as far as the format goes, and motmetrics reads it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.exchange_content import PERIOD_NS, content
from wibam_core.errors import InputError
from wibam_core.exchange.motchallenge import MotChallenge
from wibam_core.scene import AnnotatedInstant, Detections2D


def test_round_trip_keeps_boxes_scores_and_identities(tmp_path: Path) -> None:
    given = content().instants or ()
    MotChallenge().write(content(), tmp_path)
    read = MotChallenge().read(tmp_path).instants or ()
    assert [instant.time_ns for instant in read] == [instant.time_ns for instant in given]
    for a, b in zip(read, given, strict=True):
        assert a.detections.keys() == b.detections.keys()
        for camera_id, seen in a.detections.items():
            np.testing.assert_allclose(seen.boxes, b.detections[camera_id].boxes, rtol=0, atol=2e-3)
            np.testing.assert_allclose(seen.scores, b.detections[camera_id].scores)
            assert seen.frame_time_ns == a.time_ns
        assert [(v.track_id, v.views) for v in a.vehicles] == [(v.track_id, v.views) for v in b.vehicles]


def test_semicolons_and_decimal_commas_are_read(tmp_path: Path) -> None:
    MotChallenge().write(content(), tmp_path)
    plain = MotChallenge().read(tmp_path).instants or ()
    for path in tmp_path.glob("*/*/*.txt"):
        path.write_text(path.read_text().replace(",", ";").replace(".", ","), encoding="utf-16")
    read = MotChallenge().read(tmp_path).instants or ()
    for a, b in zip(read, plain, strict=True):
        for camera_id, seen in a.detections.items():
            np.testing.assert_array_equal(seen.boxes, b.detections[camera_id].boxes)


def test_one_sequence_can_be_read_alone(tmp_path: Path) -> None:
    MotChallenge().write(content(), tmp_path)
    read = MotChallenge().read(tmp_path / "cam2").instants or ()
    assert [list(instant.detections) for instant in read] == [["cam2"]] * 5


def test_a_gap_in_time_is_a_gap_in_the_frames(tmp_path: Path) -> None:
    instants = list(content().instants or ())
    MotChallenge().write(replace(content(), instants=[instants[0], instants[1], instants[4]]), tmp_path)
    frames = {int(line.split(",")[0]) for line in (tmp_path / "cam1/gt/gt.txt").read_text().splitlines()}
    assert frames == {1, 2, 5}
    read = MotChallenge().read(tmp_path).instants or ()
    assert [instant.time_ns // PERIOD_NS for instant in read if len(instant.vehicles)] == [0, 1, 4]


def left_top(vehicle: int) -> list[float]:
    """Of a vehicle's box in the first camera at the first instant, from the corner of the image, px."""
    instant = (content().instants or ())[0]
    index = instant.vehicles[vehicle].views["cam1"]
    return [float(value + 0.5) for value in instant.detections["cam1"].boxes[index, :2]]


def test_motmetrics_reads_identities_and_finds_the_tracks_perfect_against_themselves(tmp_path: Path) -> None:
    motmetrics = pytest.importorskip("motmetrics", reason="motmetrics is not installed")
    MotChallenge().write(content(), tmp_path)
    path = tmp_path / "cam1" / "gt" / "gt.txt"
    truth = motmetrics.io.loadtxt(str(path), fmt="mot16", min_confidence=1)
    assert sorted(set(truth.index.get_level_values("Id"))) == [11, 12]  # track ids from 1 on
    assert set(truth["ClassId"]) == {3}
    assert truth.loc[(1, 11)][["X", "Y"]].tolist() == pytest.approx(left_top(0), abs=2e-3)  # motmetrics counts from 0
    accumulator = motmetrics.MOTAccumulator()
    for frame, rows in truth.groupby("FrameId"):
        ids = rows.index.get_level_values("Id").to_numpy()
        accumulator.update(ids, ids, np.where(np.eye(len(ids)), 0.0, np.nan), frame)
    figures = motmetrics.metrics.create().compute(accumulator, metrics=["mota", "idf1", "num_frames"], name="all")
    assert figures.loc["all"].tolist() == [1.0, 1.0, 5]
    seen = motmetrics.io.loadtxt(str(tmp_path / "cam1/det/det.txt"), fmt="mot15-2D", min_confidence=0.6)
    assert len(seen) == 10  # of three boxes at five instants, the two above the score


def test_convention_motchallenge_pixels_and_frames_begin_at_one(tmp_path: Path) -> None:
    whole = Detections2D("cam1", 0, np.array([[-0.5, -0.5, 639.5, 359.5]]), np.ones(1), np.zeros(1, np.int64))
    MotChallenge().write(replace(content(), instants=[AnnotatedInstant(0, {"cam1": whole})]), tmp_path)
    (line,) = (tmp_path / "cam1/det/det.txt").read_text().splitlines()
    assert line == "1,-1,1.000,1.000,640.000,360.000,1,3,-1,-1"


def theirs(folder: Path, *, gt: str = "", info: str = "frameRate=30\nseqLength=2\n") -> Path:
    sequence = folder / "MOT17-02"
    (sequence / "gt").mkdir(parents=True)
    (sequence / "seqinfo.ini").write_text(f"[Sequence]\nname=MOT17-02\n{info}")
    (sequence / "gt" / "gt.txt").write_text(gt)
    return sequence


def test_a_sequence_of_the_benchmark_is_read(tmp_path: Path) -> None:
    gt = "2,5,11,21,30,40,1,3,0.8\n2,6,1,1,30,40,1,12,1\n2,7,1,1,9,9,0,3,1\n"
    read = MotChallenge().read(theirs(tmp_path, gt=gt))
    first, second = read.instants or ()
    assert (first.time_ns, second.time_ns) == (0, 33_333_333)
    assert second.detections["MOT17-02"].boxes.tolist() == [[9.5, 19.5, 39.5, 59.5]]
    assert [vehicle.track_id for vehicle in second.vehicles] == [4]
    assert read.notes == (
        "1 boxes of class 12 were left out",
        "1 boxes of kinds that the benchmark ignores were left out",
    )


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"gt": "1,2,3\n"}, "gt.txt: line 1"),
        ({"gt": "\n1,1,0,0,x,4,1,3\n"}, "gt.txt: line 2"),
        ({"gt": "3,1,0,0,4,4,1,3\n"}, "frame 3 is not one of the 2"),
        ({"gt": "1,1,0,0,-4,4,1,3\n"}, "no negative width"),
        ({"gt": "1,1,0,0,nan,4,1,3\n"}, "finite numbers"),
        ({"info": "frameRate=0\nseqLength=2\n"}, "seqinfo.ini: Sequence"),
        ({"info": "frameRate=30\nseqLength=2000000\n"}, "seqinfo.ini: seqLength"),
        ({"info": "frameRate=30\n"}, "seqinfo.ini: Sequence"),
    ],
)
def test_what_cannot_be_is_refused_by_file_and_line(tmp_path: Path, given: dict[str, str], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        MotChallenge().read(theirs(tmp_path, **given))


def test_a_folder_without_a_sequence_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no MOTChallenge sequence"):
        MotChallenge().read(tmp_path)
