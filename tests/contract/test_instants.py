"""What was found at one instant, over HTTP: boxes, how they were associated, fits, and what networks said."""

from __future__ import annotations

import numpy as np
import pytest

from tests.finished import finished_job
from tests.labelled_job import FIT_ERROR, TIMES_NS, label_anew, labelled_job
from tests.service import LiveApi
from tests.site_dataset import boxes_at, tiny_rig
from wibam_core.geometry.projection import project_boxes


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return labelled_job(api)


@pytest.mark.parametrize("time_ns", TIMES_NS)
def test_boxes_belong_to_the_vehicles_that_they_show(api: LiveApi, job: str, time_ns: int) -> None:
    found = api.http.get(f"/v1/jobs/{job}/instants/{time_ns}").json()
    truth = boxes_at(time_ns)
    tracks = {vehicle["id"]: vehicle["track"] for vehicle in found["vehicles"]}
    assert found["time_ns"] == time_ns and sorted(tracks.values()) == [7, 8]
    seen_by: dict[int, set[str]] = {vehicle["id"]: set() for vehicle in found["vehicles"]}
    for camera_id, boxes in found["detections"].items():
        expected = project_boxes(tiny_rig()[camera_id], truth)
        for box in boxes:
            apart = np.abs(expected - box["box_px"]).max(axis=1)
            row = int(np.nanargmin(apart))
            assert apart[row] < 2.0, "each is the reprojection of a painted vehicle"
            assert tracks[box["vehicle"]] == (7, 8)[row]
            assert np.linalg.norm(np.array(box["ground_m"]) - truth[row, :2]) < 2.0, "its ray meets the ground there"
            seen_by[box["vehicle"]].add(camera_id)
    assert {one["id"]: set(one["cameras"]) for one in found["vehicles"]} == seen_by
    fits = sorted(found["fits"], key=lambda fit: fit["id"])
    np.testing.assert_allclose([fit["box"] for fit in fits], truth + FIT_ERROR, atol=1e-9)
    assert (found["baseline"], found["finetuned"]) == ({}, {}), "that job has not evaluated"


def test_an_instant_that_is_not_there_is_said(api: LiveApi, job: str) -> None:
    answer = api.http.get(f"/v1/jobs/{job}/instants/5")
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
    assert api.http.get(f"/v1/jobs/{job}/instants/soon").status_code == 422
    assert api.http.get(f"/v1/jobs/{finished_job(api)}/instants/0").status_code == 404, "it has no frames"


def test_stored_instants_are_listed_for_a_stretch(api: LiveApi, job: str) -> None:
    whole = api.http.get(f"/v1/jobs/{job}/instants").json()
    assert whole["times_ns"] == list(TIMES_NS)
    params = {"start_ns": TIMES_NS[1], "end_ns": TIMES_NS[3]}
    part = api.http.get(f"/v1/jobs/{job}/instants", params=params).json()
    assert part["times_ns"] == list(TIMES_NS[1:3]), "the start counts in, the end does not"
    assert part["frame_times_ns"] == {camera: times[1:3] for camera, times in whole["frame_times_ns"].items()}
    assert api.http.get(f"/v1/jobs/{job}/instants", params={"from": 1}).status_code == 422


def test_a_frame_that_is_kept_is_asked_for_again_since_a_restart_may_make_others(api: LiveApi) -> None:
    job = labelled_job(api, b"with other frames soon")
    address = f"/v1/jobs/{job}/frames/north?time_ns={TIMES_NS[1]}&width_px=320"
    first = api.http.get(address)
    assert first.headers["cache-control"] == "private, no-cache"
    kept = api.http.get(address, headers={"If-None-Match": first.headers["etag"]})
    assert (kept.status_code, kept.content) == (304, b"")
    options = {"options": {"frames": {"rate_hz": 2.0}}}
    assert api.http.post(f"/v1/jobs/{job}/restart", json=options).status_code == 202
    assert api.http.get(address, headers={"If-None-Match": first.headers["etag"]}).status_code == 409
    label_anew(api, job)
    anew = api.http.get(address, headers={"If-None-Match": first.headers["etag"]})
    assert anew.status_code == 200, "a frame at the same time, of other frames"
    assert anew.headers["etag"] != first.headers["etag"]
