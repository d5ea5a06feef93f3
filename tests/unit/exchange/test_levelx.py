"""levelX CSV: what is written comes back, levelX's own columns are read, and a reader from PyPI agrees."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.exchange_content import PERIOD_NS, content
from wibam_core.errors import InputError
from wibam_core.exchange import motion
from wibam_core.exchange.base import Content
from wibam_core.exchange.levelx import LevelX
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track
from wibam_core.site import Origin


def test_round_trip_keeps_ids_classes_times_places_headings_and_velocities(tmp_path: Path) -> None:
    given_tracks = content().tracks or ()
    LevelX().write(content(), tmp_path)
    read = LevelX().read(tmp_path).tracks or ()
    assert [(t.track_id, t.vehicle_class) for t in read] == [(t.track_id, t.vehicle_class) for t in given_tracks]
    for a, b in zip(read, given_tracks, strict=True):
        np.testing.assert_array_equal(a.times_ns, b.times_ns)
        np.testing.assert_allclose(a.boxes[:, [0, 1, 3, 4, 6]], b.boxes[:, [0, 1, 3, 4, 6]], atol=1e-6)
        np.testing.assert_allclose(a.velocities_mps, b.velocities_mps, atol=1e-6)
        np.testing.assert_allclose(a.yaw_rates_radps, 0, atol=1e-6)
        np.testing.assert_allclose(a.boxes[:, 2], a.boxes[:, 5] / 2)  # on the ground
        assert np.isnan(a.sd).all()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    ("delimiter", "decimal", "line_end"), [(";", ",", "\r\n"), (";", ".", "\n"), ("\t", ",", "\n")]
)
def test_spreadsheets_of_other_countries_are_read(
    tmp_path: Path, delimiter: str, decimal: str, line_end: str, encoding: str
) -> None:
    LevelX().write(content(), tmp_path)
    plain = LevelX().read(tmp_path).tracks or ()
    for path in tmp_path.iterdir():
        with path.open(newline="") as file:
            rows = [[cell.replace(".", decimal) for cell in row] for row in csv.reader(file)]
        path.write_bytes(line_end.join([*(delimiter.join(row) for row in rows), ""]).encode(encoding))
    read = LevelX().read(tmp_path).tracks or ()
    assert [(t.track_id, t.vehicle_class) for t in read] == [(t.track_id, t.vehicle_class) for t in plain]
    for a, b in zip(read, plain, strict=True):
        np.testing.assert_array_equal(a.boxes, b.boxes)
        np.testing.assert_array_equal(a.velocities_mps, b.velocities_mps)


def test_two_decimal_marks_in_one_table_are_refused(tmp_path: Path) -> None:
    LevelX().write(content(), tmp_path)
    path = tmp_path / "00_recordingMeta.csv"
    names, values = path.read_text().splitlines()
    frame_rate = names.split(",").index("frameRate")
    cells = values.split(",")
    cells[frame_rate] = "12,5"
    path.write_text(f"{names.replace(',', ';')}\n{';'.join(cells)}\n")
    with pytest.raises(InputError, match="some have a decimal point and some a decimal comma"):
        LevelX().read(tmp_path)


def test_convention_heading_is_in_degrees_counter_clockwise_from_x(tmp_path: Path) -> None:
    (tracks_path, _, recording_path) = LevelX().write(content(), tmp_path)
    rows = list(csv.DictReader(tracks_path.open()))
    by_track = {int(row["trackId"]): row for row in rows if row["frame"] == "1"}
    assert float(by_track[10]["heading"]) == 0
    assert float(by_track[11]["heading"]) == pytest.approx(135)
    assert float(by_track[12]["heading"]) == pytest.approx(360 - np.degrees(2.0))
    assert float(by_track[11]["lonVelocity"]) == pytest.approx(np.hypot(6.25, 6.25))
    assert float(by_track[11]["latVelocity"]) == pytest.approx(0, abs=1e-6)
    (recording,) = csv.DictReader(recording_path.open())
    assert float(recording["frameRate"]) == 12.5  # 80 ms apart
    assert (recording["numTracks"], recording["numVehicles"], recording["numVRUs"]) == ("3", "3", "0")


def test_a_recording_says_where_its_site_lies_if_the_site_does(tmp_path: Path) -> None:
    given_content = content()
    assert given_content.site is not None
    site = given_content.site.model_copy(update={"origin": Origin(latitude_deg=50.779, longitude_deg=6.165)})
    (*_, path) = LevelX().write(replace(given_content, site=site), tmp_path)
    (recording,) = csv.DictReader(path.open())
    assert (recording["latLocation"], recording["lonLocation"]) == ("50.779", "6.165")
    (*_, path) = LevelX().write(given_content, tmp_path)
    (recording,) = csv.DictReader(path.open())
    assert (recording["latLocation"], recording["xUtmOrigin"]) == ("", "")


def test_highd_counts_y_downwards_and_calls_length_width(tmp_path: Path) -> None:
    (tmp_path / "07_recordingMeta.csv").write_text("id,frameRate,locationId\n7,25,2\n")
    (tmp_path / "07_tracksMeta.csv").write_text(
        "id,width,height,class,drivingDirection\n1,4.0,2.0,Car,1\n2,12,3,Truck,2\n"
    )
    (tmp_path / "07_tracks.csv").write_text(
        "frame,id,x,y,width,height,xVelocity,yVelocity\n"
        "1,1,100.0,10.0,4.0,2.0,-30.0,0.5\n2,1,98.8,10.02,4.0,2.0,-30.0,0.5\n1,2,50,20,12,3,25,0\n"
    )
    car, truck = LevelX().read(tmp_path).tracks or ()
    assert (car.vehicle_class, truck.vehicle_class) == (RoadUserClass.CAR, RoadUserClass.TRUCK)
    np.testing.assert_array_equal(car.times_ns, [40_000_000, 80_000_000])
    np.testing.assert_allclose(car.boxes[0, [0, 1, 3, 4]], [102.0, -11.0, 4.0, 2.0])
    np.testing.assert_allclose(car.boxes[:, 6], np.pi)
    np.testing.assert_allclose(car.velocities_mps[0], [-30.0, -0.5])
    np.testing.assert_allclose(truck.boxes[0, [0, 1, 6]], [56.0, -21.5, 0.0])


def _ind(folder: Path, *, tracks: str = "3,0,1,2,90,4,2,0,10\n", meta: str = "3,car\n", rate: str = "25") -> Path:
    (folder / "00_recordingMeta.csv").write_text(f"recordingId,frameRate\n0,{rate}\n")
    (folder / "00_tracksMeta.csv").write_text(f"trackId,class\n{meta}")
    path = folder / "00_tracks.csv"
    path.write_text(f"trackId,frame,xCenter,yCenter,heading,length,width,xVelocity,yVelocity\n{tracks}")
    return path


def test_what_is_no_road_user_of_ours_is_left_out_and_noted(tmp_path: Path) -> None:
    read = LevelX().read(
        _ind(tmp_path, tracks="3,0,1,2,90,4,2,0,10\n4,0,0,0,0,1,1,0,0\n", meta="3,truck_bus\n4,trailer\n")
    )
    assert [track.track_id for track in read.tracks or ()] == [3]
    assert read.notes == ("1 tracks of class 'trailer' are left out.",)


def test_a_road_user_without_an_extent_gets_the_usual_one(tmp_path: Path) -> None:
    (track,) = LevelX().read(_ind(tmp_path, tracks="3,0,1,2,90,0,0,0,10\n")).tracks or ()
    np.testing.assert_allclose(track.boxes[0, 3:6], RoadUserClass.CAR.traits.size.size_m)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rate": "0"}, "00_recordingMeta.csv: frameRate: .*positive"),
        ({"rate": "25\n1,25"}, "one line"),
        ({"meta": "5,car\n"}, "00_tracks.csv: trackId: track 3 has no line"),
        ({"tracks": "3,0,1,2,90,4,2,0,10\n3,0,1,2,90,4,2,0,10\n"}, "track 3 has two states in one frame"),
        ({"tracks": "3,0,1,2,inf,4,2,0,10\n"}, "heading: has a value that is no number, or beyond"),
        ({"tracks": "3,0,1,2,,4,2,0,10\n"}, "heading has empty values"),
        ({"tracks": "3,zero,1,2,90,4,2,0,10\n"}, "column frame must be int64"),
        ({"tracks": f"3,{10**18},1,2,90,4,2,0,10\n"}, "lasts beyond"),
        ({"tracks": "3,0,1\n"}, "00_tracks.csv: the table: "),
    ],
)
def test_what_cannot_be_is_refused_by_file_and_field(tmp_path: Path, change: dict[str, str], words: str) -> None:
    with pytest.raises(InputError, match=words):
        LevelX().read(_ind(tmp_path, **change))


def test_a_folder_of_several_recordings_must_be_narrowed_down(tmp_path: Path) -> None:
    _ind(tmp_path)
    (tmp_path / "01_tracks.csv").write_text("")
    with pytest.raises(InputError, match="holds 2 recordings"):
        LevelX().read(tmp_path)


def test_a_recording_without_tracks_comes_back_as_one(tmp_path: Path) -> None:
    LevelX().write(Content(tracks=[]), tmp_path)
    assert LevelX().read(tmp_path).tracks == []


@given(st.lists(st.integers(0, 10**12), min_size=2, max_size=30, unique=True))
@settings(max_examples=50)
def test_no_two_instants_get_the_same_frame(times: list[int]) -> None:
    times_ns = np.sort(np.array(times))
    frames = motion.frame_numbers(times_ns, motion.frame_period_ns([times_ns]))
    assert (np.diff(frames) > 0).all()


def test_acceleration_is_the_change_of_velocity() -> None:
    times_ns = np.array([0, 1, 2, 4]) * PERIOD_NS
    track = (content().tracks or ())[0]
    speeding_up = Track(
        1,
        track.vehicle_class,
        times_ns,
        track.boxes[:4],
        track.sd[:4],
        np.stack([2.0 * times_ns * 1e-9, -1.0 * times_ns * 1e-9], axis=1),
        np.zeros(4),
    )
    np.testing.assert_allclose(motion.accelerations_mps2(speeding_up), np.tile([2.0, -1.0], (4, 1)))


def test_levelx_s_reader_from_pypi_reads_tracks_and_frames(tmp_path: Path) -> None:
    recording_module = pytest.importorskip("lxd_io.recording", reason="lxd-io is not installed")
    tracks_path, meta_path, recording_path = LevelX().write(content(), tmp_path)
    recording = recording_module.Recording(0, recording_path, meta_path, tracks_path, tmp_path / "none.png")
    assert recording.track_ids == [10, 11, 12]
    assert recording.get_track_ids_at_frame(4) == [10, 11, 12]
    expected = (content().tracks or ())[1]
    track = recording.get_track(11)
    assert track.get_meta_data("class") == "van"
    np.testing.assert_allclose(track.get_data("xCenter"), expected.boxes[:, 0], atol=1e-6)
    np.testing.assert_allclose(np.radians(track.get_data("heading")), expected.boxes[:, 6], atol=1e-6)
    np.testing.assert_allclose(track.get_data("xVelocity"), expected.velocities_mps[:, 0], atol=1e-6)


def test_content_without_tracks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without tracks"):
        LevelX().write(replace(content(), tracks=None), tmp_path)
