"""Predictions are written and read instant by instant, and hold what was found, and where nobody was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from wibam_core.errors import InputError
from wibam_core.formats.predictions import Predictions, PredictionsWriter
from wibam_core.formats.vehicles3d import write_vehicles3d
from wibam_core.scene import Vehicles3D


def found(time_ns: int, camera_id: str, count: int) -> Vehicles3D:
    """Boxes that no other image holds; one in two has no standard deviation."""
    rng = np.random.default_rng([time_ns, count])
    sd = rng.uniform(0.1, 1, (count, 7))
    sd[::2] = np.nan
    boxes = rng.uniform(0.5, 3, (count, 7))
    classes = np.arange(count) % 2
    return Vehicles3D.of(time_ns, boxes, classes=classes, scores=rng.random(count), sd=sd, camera_id=camera_id)


def written(path: Path, counts: dict[int, dict[str, int]]) -> dict[int, dict[str, Vehicles3D]]:
    everything = {t: {id_: found(t, id_, n) for id_, n in of_instant.items()} for t, of_instant in counts.items()}
    with PredictionsWriter(path) as writer:
        for of_instant in everything.values():
            writer.add(list(of_instant.values()))
    return everything


def assert_same(read: dict[str, Vehicles3D], want: dict[str, Vehicles3D]) -> None:
    assert read.keys() == want.keys()
    for camera_id, vehicles in want.items():
        assert read[camera_id].time_ns == vehicles.time_ns
        for name in ("boxes", "classes", "ids", "scores", "sd"):
            np.testing.assert_array_equal(getattr(read[camera_id], name), getattr(vehicles, name))


def test_what_is_written_is_read_to_the_bit(tmp_path: Path) -> None:
    counts = {k * 80: {"east": 40 * (k % 3), "west": k % 5} for k in range(400)}
    want = written(tmp_path / "p", counts)
    assert pq.ParquetFile(tmp_path / "p").num_row_groups > 2
    read = dict(Predictions(tmp_path / "p").at(list(counts)))
    assert list(read) == sorted(counts)
    for time_ns, of_instant in want.items():
        assert_same(read[time_ns], of_instant)


def test_some_instants_are_read_in_order_of_time_and_others_do_not_come(tmp_path: Path) -> None:
    want = written(tmp_path / "p", {10: {"a": 2, "b": 0}, 20: {"a": 0}, 30: {"a": 1}, 40: {"b": 3}, 50: {"b": 0}})
    read = dict(Predictions(tmp_path / "p").at([50, 30, 10, 30, 25, 60, -5]))
    assert list(read) == [10, 30, 50]
    for time_ns in read:
        assert_same(read[time_ns], want[time_ns])


def test_reading_opens_the_parts_of_the_file_that_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path / "p", {k: {"a": 500} for k in range(60)})
    opened: list[int] = []
    read_row_group = pq.ParquetFile.read_row_group

    def watched(file: pq.ParquetFile, number: int) -> object:
        opened.append(number)
        return read_row_group(file, number)

    monkeypatch.setattr(pq.ParquetFile, "read_row_group", watched)
    assert [time_ns for time_ns, _ in Predictions(tmp_path / "p").at([20, 21, 59])] == [20, 21, 59]
    assert opened == [2, 6]


def test_nobody_anywhere(tmp_path: Path) -> None:
    written(tmp_path / "p", {10: {"a": 0}})
    read = dict(Predictions(tmp_path / "p").at([10, 20]))
    assert list(read) == [10] and len(read[10]["a"]) == 0


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no table")
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        Predictions(tmp_path / "text")
    write_vehicles3d(tmp_path / "vehicles", [found(1, "a", 2)])
    with pytest.raises(InputError, match="holds no predictions"):
        Predictions(tmp_path / "vehicles")


@pytest.mark.parametrize("said", [b"[[1", b"{}", b"null", b"[1, 2]", b'[["a", "b"]]', b"\xff"])
def test_what_it_says_of_empty_images_may_be_damaged(tmp_path: Path, said: bytes) -> None:
    written(tmp_path / "p", {10: {"a": 2, "b": 0}})
    table = pq.read_table(tmp_path / "p")
    pq.write_table(table.replace_schema_metadata({b"wibam.empty_images": said}), tmp_path / "damaged")
    with pytest.raises(InputError, match="damaged holds no predictions"):
        Predictions(tmp_path / "damaged")
