"""`wibam labels` against a real API: files in and out, without overwriting what somebody made, and agreement."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.labelled_job import TIMES_NS, labelled_job
from tests.service import TOKEN, LiveApi
from tests.site_dataset import boxes_at
from wibam_core.cli.labels import app
from wibam_core.client import WibamClient
from wibam_core.documents.hand_labels import HandLabels
from wibam_core.errors import ChangedMeanwhile, Conflict, InputError
from wibam_core.formats.labels import read_labels, write_labels
from wibam_core.scene import LabelledInstant, Vehicles3D


@pytest.fixture
def job(api: LiveApi, request: pytest.FixtureRequest) -> str:
    return labelled_job(api, request.node.name.encode())


def labels(command: str, api: LiveApi, *arguments: str) -> str:
    told = [command, *arguments, "--url", api.url, "--token", TOKEN]
    result = CliRunner().invoke(app, told, env={"COLUMNS": "200"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


def truth(time_ns: int, off_m: float = 0.0) -> LabelledInstant:
    """Both vehicles; no camera sees the second."""
    boxes = boxes_at(time_ns) + np.array([off_m, 0, 0, 0, 0, 0, 0])
    seen = {"north": np.array([0.75, 0.0]), "south": np.array([0.0, 0.0])}
    return LabelledInstant(Vehicles3D.of(time_ns, boxes, [0, 0], [7, 8]), seen, np.array([[5.0, 0.0], [0.0, 0.0]]))


def test_a_file_comes_back_as_it_was_sent(api: LiveApi, job: str, tmp_path: Path) -> None:
    sent, back = tmp_path / "sent.parquet", tmp_path / "back.parquet"
    elsewhere = TIMES_NS[-1] + 3_000_000_000
    write_labels(sent, [truth(TIMES_NS[0] + 200), truth(TIMES_NS[2]), truth(elsewhere)])
    said = labels("put", api, job, str(sent), "--author", "anna")
    assert "2 instants are labelled in the set main; 1 of the file are none of the job's" in said
    assert str(back) in labels("get", api, job, "--out", str(back)).replace("\n", "")
    found = read_labels(back)
    assert [one.vehicles.time_ns for one in found] == [TIMES_NS[0], TIMES_NS[2]]
    np.testing.assert_allclose(found[1].vehicles.boxes, boxes_at(TIMES_NS[2]), atol=1e-9)
    np.testing.assert_allclose(found[1].velocities_mps, [[5, 0], [0, 0]], atol=1e-9)
    assert found[1].visibility["north"].tolist() == [0.75, 0.0]
    assert found[1].visibility["south"][1] == 0.0, "whom no camera saw is not asked for"


def test_nothing_is_overwritten_unless_one_says_so(api: LiveApi, job: str, tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    write_labels(path, [truth(TIMES_NS[1])])
    labels("put", api, job, str(path), "--author", "anna")
    with pytest.raises(Conflict, match="1 of these instants are labelled"):
        labels("put", api, job, str(path), "--author", "ben")
    labels("put", api, job, str(path), "--author", "ben", "--replace")
    with WibamClient(api.url, TOKEN) as client:
        kept, version = client.labels(job, TIMES_NS[1])
        assert (version, len(kept.vehicles), kept.vehicles[1].ignored) == (2, 2, True)
        assert client.save_labels(job, kept, "anna", 2) == 3
        with pytest.raises(ChangedMeanwhile):
            client.save_labels(job, HandLabels(time_ns=TIMES_NS[1]), "ben", 2)


def test_a_file_of_other_footage_is_refused(api: LiveApi, job: str, tmp_path: Path) -> None:
    path = tmp_path / "labels.parquet"
    write_labels(path, [truth(TIMES_NS[0] + 500_000_000_000)])
    with pytest.raises(InputError, match="none of the 1 instants"):
        labels("put", api, job, str(path), "--author", "anna")


def test_agreement_says_how_far_two_people_are_apart(api: LiveApi, job: str, tmp_path: Path) -> None:
    for name, off_m in (("anna", 0.0), ("ben", 0.3)):
        path = tmp_path / f"{name}.parquet"
        write_labels(path, [truth(time_ns, off_m) for time_ns in TIMES_NS[:2]])
        labels("put", api, job, str(path), "--author", name, "--set", name)
    said = labels("agreement", api, job, "anna", "ben")
    assert "2 instants, 2 vehicles of both, 0 only in anna, 0 only in ben; same class: 100%" in said
    [distance] = [line for line in said.splitlines() if "distance of centres" in line]
    assert distance.split()[-2:] == ["0.300", "0.000"]
