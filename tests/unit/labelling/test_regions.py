"""Regions where nobody looked closely, from what is drawn to what evaluates, through a file and back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from pydantic import ValidationError

from tests.builders import corner_rig
from wibam_core.documents.hand_labels import HandLabels, HandRegion, HandVehicle
from wibam_core.errors import InvalidLabels
from wibam_core.formats.labels import read_labels, write_labels
from wibam_core.labelling.labels import hand_labels, labelled_instant

YARD = ((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0))


def labels() -> HandLabels:
    """A car in the yard that nobody cares for, and one outside."""
    cars = tuple(
        HandVehicle(id=n, vehicle_class="car", box=(x, 0.0, 0.75, 4.5, 1.8, 1.5, 0.0)) for n, x in ((1, 1.0), (2, 8.0))
    )
    return HandLabels(time_ns=5, vehicles=cars, regions=(HandRegion(kind="do_not_care", polygon=YARD),), finished=True)


def test_nobody_is_asked_for_whoever_stands_in_one() -> None:
    found = labelled_instant(labels(), corner_rig(2))
    for shares in found.visibility.values():
        assert shares[0] == 0 and shares[1] > 0.9
    np.testing.assert_allclose(found.do_not_care, [YARD])


@pytest.mark.parametrize("name", ["labels.parquet", "labels.json"])
def test_files_keep_them(tmp_path: Path, name: str) -> None:
    write_labels(tmp_path / name, [labelled_instant(labels(), corner_rig(2))])
    [found] = read_labels(tmp_path / name)
    np.testing.assert_allclose(found.do_not_care, [YARD])
    assert hand_labels(found).regions == labels().regions


def test_regions_that_are_none_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    for regions, said in (
        ([{"time_ns": 5, "polygon": [[0, 0], [1, 1]]}], "a polygon that is none"),
        ([{"time_ns": 5}], "no list of regions"),
        ([{"time_ns": 6, "polygon": [[0, 0], [1, 0], [0, 1]]}], "nothing is labelled"),
    ):
        path.write_text(json.dumps({"labels": [], "empty_instants": [5], "do_not_care": regions}))
        with pytest.raises(InvalidLabels, match=said):
            read_labels(path)
    for wrong in ({"kind": "hidden"}, {"kind": "do_not_care", "camera": "cam1"}):
        with pytest.raises(ValidationError, match="names its camera"):
            HandRegion.model_validate({**wrong, "polygon": YARD})


def circle(corners: int) -> list[list[float]]:
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    return np.column_stack([np.cos(angles), np.sin(angles)]).tolist()


@pytest.mark.parametrize(
    ("corners", "regions", "said"),
    [
        (100, 200, ""),
        (101, 1, "a polygon of 101 corners at 0 ns, 100 at most"),
        (3, 201, "201 regions at 0 ns, and an instant has 200 at most"),
    ],
)
def test_a_file_has_no_more_than_can_be_labelled(tmp_path: Path, corners: int, regions: int, said: str) -> None:
    path = tmp_path / "labels.json"
    given = [{"time_ns": time_ns, "polygon": circle(corners)} for time_ns in (0, 4) for _ in range(regions - time_ns)]
    path.write_text(json.dumps({"labels": [], "empty_instants": [0, 4], "do_not_care": given}))
    if said:
        with pytest.raises(InvalidLabels, match=said) as refused:
            read_labels(path)
        assert refused.value.hint
    else:
        assert len(hand_labels(read_labels(path)[0]).regions) == regions


@pytest.mark.parametrize("key", ["wibam.do_not_care", "wibam.empty_instants"])
@pytest.mark.parametrize(
    "note", [b"[{", b"\xff", b"", b"5", b"[1]", b'[["a", null]]', b"[[1e999, null]]", b"[" * 100_000]
)
def test_metadata_that_are_none_are_refused(tmp_path: Path, key: str, note: bytes) -> None:
    path = tmp_path / "labels.parquet"
    write_labels(path, [labelled_instant(labels(), corner_rig(2))])
    table = pq.read_table(path)
    pq.write_table(table.replace_schema_metadata({**table.schema.metadata, key.encode(): note}), path)
    with pytest.raises(InvalidLabels, match=key.removeprefix("wibam.")) as refused:
        read_labels(path)
    assert refused.value.hint
