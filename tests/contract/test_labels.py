"""Hand labels over HTTP: versions that nobody overwrites unseen, proposals, exports, an evaluation without training."""

from __future__ import annotations

import io
import json
import zipfile
from typing import Any

import numpy as np
import pytest

from tests.labelled_job import FIT_ERROR, TIMES_NS, labelled_job
from tests.service import LiveApi
from tests.site_dataset import boxes_at
from wibam_core.formats.labels import read_labels

CAR = {"id": 7, "class": "car", "box": [0.0, 1.0, 0.75, 4.4, 1.8, 1.5, 0.0], "velocity_mps": [5.0, 0.0]}


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return labelled_job(api)


def save(api: LiveApi, job: str, time_ns: int, etag: str, name: str = "main", **body: Any) -> Any:
    return api.http.put(
        f"/v1/jobs/{job}/labels/instants/{time_ns}",
        params={"set": name},
        headers={"If-Match": etag},
        json={"author": "anna", "vehicles": [CAR], **body},
    )


def test_the_second_of_two_who_save_is_told(api: LiveApi, job: str) -> None:
    address = f"/v1/jobs/{job}/labels/instants/{TIMES_NS[0]}"
    nobody = api.http.get(address)
    assert (nobody.headers["etag"], nobody.json()["version"], nobody.json()["labels"]["vehicles"]) == ('"0"', 0, [])
    first = save(api, job, TIMES_NS[0], nobody.headers["etag"])
    assert (first.status_code, first.headers["etag"]) == (200, '"1"')
    again = save(api, job, TIMES_NS[0], nobody.headers["etag"])
    assert (again.status_code, again.headers["etag"]) == (200, '"1"'), "the answer may have got lost on its way"
    second = save(api, job, TIMES_NS[0], nobody.headers["etag"], author="ben", vehicles=[])
    assert second.status_code == 412
    assert second.json()["code"] == "changed_meanwhile"
    assert second.json()["details"] == {"version": 1, "author": "anna"}
    assert api.http.get(address).json()["labels"]["vehicles"][0]["id"] == 7
    assert save(api, job, TIMES_NS[0], '"1"', author="ben", vehicles=[]).headers["etag"] == '"2"'
    listed = api.http.get(f"{address}/versions").json()
    assert [(one["version"], one["author"], one["vehicles"]) for one in listed] == [(1, "anna", 1), (2, "ben", 0)]
    assert api.http.get(address, params={"version": 1}).json()["labels"]["vehicles"][0]["box"] == CAR["box"]


def test_labels_are_those_of_all_jobs_on_the_footage_and_outlive_them(api: LiveApi) -> None:
    job = labelled_job(api, b"outlived")
    save(api, job, TIMES_NS[0], '"0"', finished=True)
    site = api.http.get(f"/v1/jobs/{job}").json()["site_id"]
    other = api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"]
    api.http.post(f"/v1/jobs/{other}/cancel")  # a job at work would keep others from what it has yet to find
    assert api.http.delete(f"/v1/jobs/{job}").status_code == 204
    [kept] = api.http.get(f"/v1/jobs/{other}/labels").json()["instants"]
    assert (kept["time_ns"], kept["vehicles"], kept["finished"], kept["author"]) == (TIMES_NS[0], 1, True, "anna")


@pytest.mark.parametrize(
    ("vehicles", "said"),
    [
        ([CAR, CAR], "twice"),
        ([{**CAR, "box": [0, 0, 0, -1, 2, 2, 0]}], "greater"),
        ([{**CAR, "class": "tank"}], "car"),
        ([{**CAR, "colour": "red"}], "colour"),
    ],
)
def test_what_cannot_be_is_refused(api: LiveApi, job: str, vehicles: list[Any], said: str) -> None:
    answer = save(api, job, TIMES_NS[3], '"0"', vehicles=vehicles)
    assert answer.status_code == 422
    assert said in answer.text
    assert save(api, job, TIMES_NS[3], "W/whatever").status_code == 422
    assert save(api, job, 5, '"0"').status_code == 404, "there is no such instant"


def test_the_proposal_is_the_fits_moved_to_the_instant(api: LiveApi, job: str) -> None:
    for time_ns in TIMES_NS:
        found = api.http.get(f"/v1/jobs/{job}/labels/instants/{time_ns}/proposal").json()
        assert [one["id"] for one in found] == [7, 8]
        np.testing.assert_allclose([one["box"] for one in found], boxes_at(time_ns) + FIT_ERROR, atol=1e-6)
        np.testing.assert_allclose([one["velocity_mps"] for one in found], [[5, 0], [0, 0]], atol=1e-6)


def test_visibility_may_be_of_a_view_that_is_cut_from_a_picture(api: LiveApi, job: str) -> None:
    seen = [{**CAR, "visibility": {"north": 0.25, "omni.1": 0.5}}]
    answer = save(api, job, TIMES_NS[0], '"0"', "views", vehicles=seen)
    assert answer.status_code == 200, answer.text
    assert answer.json()["labels"]["vehicles"][0]["visibility"] == {"north": 0.25, "omni.1": 0.5}
    assert answer.json()["visibility"]["north"] == [0.25]


def test_suggestions_leave_out_what_is_labelled(api: LiveApi, job: str) -> None:
    address = f"/v1/jobs/{job}/labels/suggestions"
    save(api, job, TIMES_NS[1], '"0"', "suggested")
    found = api.http.get(address, params={"set": "suggested"}).json()
    assert [one["time_ns"] for one in found] == [TIMES_NS[0], TIMES_NS[2], TIMES_NS[3]]
    assert all(one["vehicles"] == 2 and 0 < one["disagreement"] < 1 for one in found)
    assert len(api.http.get(address, params={"set": "suggested", "count": 2}).json()) == 2


def test_only_finished_instants_are_exported(api: LiveApi, job: str, tmp_path: Any) -> None:
    address = f"/v1/jobs/{job}/labels/export"
    save(api, job, TIMES_NS[0], '"0"', "exported")
    assert api.http.get(f"{address}/json", params={"set": "exported"}).status_code == 409
    assert save(api, job, TIMES_NS[2], '"0"', "exported", finished=True).status_code == 200
    for name in ("parquet", "json"):
        path = tmp_path / f"labels.{name}"
        path.write_bytes(api.http.get(f"{address}/{name}", params={"set": "exported"}).content)
        [instant] = read_labels(path)
        assert instant.vehicles.time_ns == TIMES_NS[2]
        np.testing.assert_allclose(instant.vehicles.boxes, [CAR["box"]])
        assert instant.velocities_mps.tolist() == [[5.0, 0.0]]
        assert set(instant.visibility) == {"north", "east", "south"}
    coco = api.http.get(f"{address}/coco", params={"set": "exported"}).json()
    assert {one["track_id"] for one in coco["annotations"]} == {7}
    assert len(coco["annotations"]) == sum(int((shares > 0).sum()) for shares in instant.visibility.values())
    layout = zipfile.ZipFile(io.BytesIO(api.http.get(f"{address}/wibam-dataset", params={"set": "exported"}).content))
    objects = [json.loads(layout.read(name)) for name in layout.namelist() if "hand_labels" in name]
    assert objects and all(next(iter(one.values()))["size"] == CAR["box"][3:6] for one in objects)  # type: ignore[index]
    assert any(name.endswith(".jpg") for name in layout.namelist())


def test_two_annotators_are_compared(api: LiveApi, job: str) -> None:
    shifted = {**CAR, "box": [0.2, 1.0, 0.75, 4.4, 1.8, 1.5, 0.1], "class": "van"}
    save(api, job, TIMES_NS[1], '"0"', "one", finished=True)
    save(
        api,
        job,
        TIMES_NS[1],
        '"0"',
        "two",
        finished=True,
        vehicles=[shifted, {**CAR, "id": 9, "box": [9, 9, *CAR["box"][2:]]}],
    )  # type: ignore[misc]
    found = api.http.get(f"/v1/jobs/{job}/labels/agreement", params={"first": "one", "second": "two"}).json()
    assert (found["instants"], found["pairs"], found["only_first"], found["only_second"]) == (1, 1, 0, 1)
    assert found["ate_m"]["mean"] == pytest.approx(0.2)
    assert found["aoe_deg"]["mean"] == pytest.approx(np.degrees(0.1))
    assert found["same_class"] == 0.0


def test_evaluating_runs_what_labels_matter_for_and_trains_nothing(api: LiveApi) -> None:
    job = labelled_job(api, b"evaluated")
    save(api, job, TIMES_NS[2], '"0"', finished=True)
    answer = api.http.post(f"/v1/jobs/{job}/labels/evaluate", json={"set": "main"})
    assert answer.status_code == 202, answer.text
    there = ("succeeded", "reused")
    running = {stage["name"] for stage in answer.json()["stages"] if stage["state"] not in there}
    assert {"evaluate", "report"} <= running <= {"preflight", "evaluate", "report"}
    labels = api.services.jobs.job(job).assets["labels"]
    [instant] = read_labels(api.services.folder.file(labels))
    np.testing.assert_allclose(instant.vehicles.boxes, [CAR["box"]])
    assert api.http.post(f"/v1/jobs/{job}/labels/evaluate", json={"set": "main"}).status_code == 409, "it is running"
