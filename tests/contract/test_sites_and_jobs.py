"""Sites and jobs over real HTTP, without a worker: what is created, refused, followed and deleted."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest

from tests.builders import corner_rig, site_of
from tests.service import LiveApi
from wibam_core.adapters.job_rows import StageKey
from wibam_core.site import Site
from wibam_core.stages.graph import STAGES

SITE = site_of(corner_rig(2)).model_dump(mode="json")


@pytest.fixture
def site(api: LiveApi) -> str:
    return api.site(cameras=1)


@pytest.fixture
def ready_site(api: LiveApi, site: str) -> str:
    api.upload(site, b"a recording")
    return site


def assert_problem(response: httpx.Response, status: int, code: str) -> dict[str, Any]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    body: dict[str, Any] = response.json()
    assert body["code"] == code
    assert body["type"] == f"urn:wibam:problem:{code}"
    assert body["status"] == status
    assert body["detail"]
    return body


class TestToken:
    @pytest.mark.parametrize("header", [None, "", "Bearer", "Bearer wrong", "Basic a-token-for-tests"])
    @pytest.mark.parametrize(
        ("method", "path"), [("GET", "/v1/sites"), ("POST", "/v1/uploads"), ("GET", "/v1/nothing")]
    )
    def test_nothing_without_it(self, api: LiveApi, method: str, path: str, header: str | None) -> None:
        headers = {} if header is None else {"Authorization": header}
        response = httpx.request(method, api.url + path, headers=headers)
        body = assert_problem(response, 401, "unauthorised")
        assert "Bearer" in body["hint"]
        assert response.headers["www-authenticate"] == "Bearer"

    def test_not_in_the_address(self, api: LiveApi) -> None:
        assert httpx.get(f"{api.url}/v1/sites?token=a-token-for-tests", timeout=300).status_code == 401

    def test_health_and_documentation_are_open(self, api: LiveApi) -> None:
        for path in ("/healthz", "/version", "/openapi.json", "/docs"):
            assert httpx.get(api.url + path, timeout=300).status_code == 200

    def test_readiness_names_what_is_missing(self, api: LiveApi) -> None:
        body = assert_problem(httpx.get(f"{api.url}/readyz", timeout=300), 503, "service_unavailable")
        assert "broker" in body["detail"]


class TestSites:
    def test_come_back_as_they_were_given(self, api: LiveApi) -> None:
        created = api.http.post("/v1/sites", json=SITE)
        assert created.status_code == 201
        found = api.http.get(f"/v1/sites/{created.json()['id']}").json()
        assert found["site"] == SITE
        assert found["cameras"] == ["cam1", "cam2"]
        assert found in api.http.get("/v1/sites").json()

    @pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
    def test_come_in_any_unicode(self, api: LiveApi, encoding: str) -> None:
        body = json.dumps({**SITE, "name": "Knotenpunkt Süd"}, ensure_ascii=False).encode(encoding)
        created = api.http.post("/v1/sites", content=body, headers={"Content-Type": "application/json"})
        assert created.status_code == 201, created.text
        assert created.json()["name"] == "Knotenpunkt Süd"

    def test_a_wrong_field_is_named(self, api: LiveApi) -> None:
        wrong = json.loads(json.dumps(SITE))
        wrong["cameras"][1]["width_px"] = -1
        body = assert_problem(api.http.post("/v1/sites", json=wrong), 422, "invalid_input")
        assert body["detail"].startswith("body.cameras.1.width_px")
        assert body["details"]["errors"][0]["field"] == "body.cameras.1.width_px"

    @pytest.mark.parametrize("camera_id", ["../x", "a b", "", "x" * 65])
    def test_camera_ids_are_plain(self, api: LiveApi, camera_id: str) -> None:
        wrong = json.loads(json.dumps(SITE))
        wrong["cameras"][0]["id"] = camera_id
        assert_problem(api.http.post("/v1/sites", json=wrong), 422, "invalid_input")

    def test_what_is_no_json_or_too_much(self, api: LiveApi) -> None:
        headers = {"Content-Type": "application/json"}
        for undecodable in (b"{", b'{"name": "\xff"}'):
            body = assert_problem(api.http.post("/v1/sites", content=undecodable, headers=headers), 400, "invalid_json")
            assert "UTF-8" in body["hint"]
        chunks = (b" " * 100_000 for _ in range(50))
        for large in (b" " * 4_000_001, chunks):
            body = assert_problem(api.http.post("/v1/sites", content=large, headers=headers), 413, "too_large")
            assert "/v1/uploads" in body["hint"]

    def test_a_flood_of_empty_cameras_or_unknown_fields(self, api: LiveApi) -> None:
        body = assert_problem(
            api.http.post("/v1/sites", json={"name": "x", "cameras": [{}] * 50_000}), 422, "invalid_input"
        )
        assert len(body["details"]["errors"]) <= 20
        unknown = dict.fromkeys(map(str, range(50_000)), 0)
        assert_problem(api.http.post("/v1/sites", json={"name": "x", "cameras": [], **unknown}), 413, "too_large")

    def test_unknown_paths_and_methods(self, api: LiveApi) -> None:
        body = assert_problem(api.http.get("/v1/nothing"), 404, "not_found")
        assert "/v1/nothing" in body["detail"]
        assert "/docs" in body["hint"]
        refused = api.http.put("/v1/sites")
        body = assert_problem(refused, 405, "method_not_allowed")
        assert body["hint"] == "It takes GET, POST."
        assert refused.headers["allow"] == "GET, POST"
        body = assert_problem(api.http.get("/v1/sites/site_0000000000000000"), 404, "not_found")
        assert "List the sites" in body["hint"]

    def test_a_nul_leads_nowhere(self, api: LiveApi, ready_site: str) -> None:
        body = assert_problem(api.http.get("/v1/jobs/a%00b"), 404, "not_found")
        assert "%00" in body["hint"]
        assert_problem(api.http.get("/v1/jobs?site=a%00b"), 422, "invalid_input")
        assert_problem(api.begin(f"{ready_site}\0", 10), 422, "invalid_input")
        for place in ("name", "signal"):
            wrong = json.loads(json.dumps(SITE))
            if place == "name":
                wrong["name"] = "a\0b"
            else:
                wrong["cameras"][0]["signals"] = [{"id": "a\0b", "region": [1, 2, 3, 4]}]
            assert_problem(api.http.post("/v1/sites", json=wrong), 422, "invalid_site")

    def test_what_no_recording_can_fit_is_refused_at_once(self, api: LiveApi, ready_site: str) -> None:
        before = api.http.get(f"/v1/sites/{ready_site}").json()
        wrong = json.loads(json.dumps(SITE))
        wrong["cameras"][1]["signals"] = [{"id": "left", "region": [10, 20, -5, 40]}]
        for refused in (api.http.post("/v1/sites", json=wrong), api.http.put(f"/v1/sites/{ready_site}", json=wrong)):
            body = assert_problem(refused, 422, "invalid_site")
            assert body["details"] == {"camera": "cam2", "signal": "left"}
            assert "camera cam2, signal left" in body["detail"]
            assert body["hint"]
        assert api.http.get(f"/v1/sites/{ready_site}").json() == before

    def test_that_were_let_in_before_are_still_shown(self, api: LiveApi) -> None:
        wrong = json.loads(json.dumps(SITE))
        wrong["cameras"][0]["signals"] = [{"id": "left", "region": [10, 20, 0, 0]}]
        kept = api.services.sites.add_site(Site.model_validate(wrong))
        assert kept.id in {site["id"] for site in api.http.get("/v1/sites").json()}

    def test_are_kept_while_they_have_jobs(self, api: LiveApi, ready_site: str) -> None:
        job = api.http.post(f"/v1/sites/{ready_site}/jobs", json={}).json()["id"]
        assert_problem(api.http.delete(f"/v1/sites/{ready_site}"), 409, "conflict")
        api.http.post(f"/v1/jobs/{job}/cancel")
        assert api.http.delete(f"/v1/jobs/{job}").status_code == 204
        assert api.http.delete(f"/v1/sites/{ready_site}").status_code == 204
        assert api.http.get(f"/v1/sites/{ready_site}").status_code == 404

    def test_can_be_described_anew_and_keep_their_recordings(self, api: LiveApi, ready_site: str) -> None:
        before = api.http.get(f"/v1/sites/{ready_site}").json()
        corrected = json.loads(json.dumps(before["site"]))
        corrected["cameras"][0]["signals"] = [{"id": "a", "region": [1, 2, 3, 4]}]
        replaced = api.http.put(f"/v1/sites/{ready_site}", json=corrected)
        assert replaced.status_code == 200
        assert replaced.json() == {**before, "site": corrected}
        assert api.http.get(f"/v1/sites/{ready_site}").json() == replaced.json()
        assert [file["camera"] for file in api.http.get(f"/v1/sites/{ready_site}/recordings").json()] == ["cam1"]

    def test_the_second_of_two_who_describe_it_anew_is_told(self, api: LiveApi, ready_site: str) -> None:
        read = api.http.get(f"/v1/sites/{ready_site}")
        mine, theirs = ({**read.json()["site"], "name": name} for name in ("mine", "theirs"))
        match = {"If-Match": read.headers["etag"]}
        first = api.http.put(f"/v1/sites/{ready_site}", json=theirs, headers=match)
        assert first.headers["etag"] == api.http.get(f"/v1/sites/{ready_site}").headers["etag"] != read.headers["etag"]
        again = api.http.put(f"/v1/sites/{ready_site}", json=theirs, headers=match)
        assert again.status_code == 200, "the answer may have got lost on its way"
        assert_problem(api.http.put(f"/v1/sites/{ready_site}", json=mine, headers=match), 412, "changed_meanwhile")
        assert api.http.get(f"/v1/sites/{ready_site}").json()["name"] == "theirs"
        for how in ({"If-Match": first.headers["etag"]}, {"If-Match": "*"}, {}):
            assert api.http.put(f"/v1/sites/{ready_site}", json=mine, headers=how).status_code == 200

    def test_cameras_that_are_gone_take_their_recordings_along(self, api: LiveApi) -> None:
        site = api.site(cameras=2)
        for camera in ("cam1", "cam2"):
            api.upload(site, b"video of " + camera.encode(), camera=camera)
        unfinished = api.begin(site, 10, camera="cam2").headers["Location"]
        replaced = api.http.put(f"/v1/sites/{site}", json={**SITE, "cameras": SITE["cameras"][:1]})
        assert replaced.json()["cameras"] == ["cam1"]
        assert [file["camera"] for file in api.http.get(f"/v1/sites/{site}/recordings").json()] == ["cam1"]
        assert api.send(unfinished, 0, b"x" * 10).status_code == 404
        assert api.http.post(f"/v1/sites/{site}/jobs", json={}).status_code == 201

    def test_jobs_keep_the_description_that_they_were_created_with(self, api: LiveApi, ready_site: str) -> None:
        old = api.http.get(f"/v1/sites/{ready_site}").json()["site"]
        path = f"/v1/sites/{ready_site}/jobs"
        job = api.http.post(path, json={}).json()
        corrected = json.loads(json.dumps(old))
        corrected["cameras"][0]["signals"] = [{"id": "a", "region": [1, 2, 3, 4]}]
        assert api.http.put(f"/v1/sites/{ready_site}", json=corrected).status_code == 200
        api.http.post(f"/v1/jobs/{job['id']}/cancel")
        restarted = api.http.post(f"/v1/jobs/{job['id']}/restart", json={}).json()
        assert api.services.jobs.job(job["id"]).site.model_dump(mode="json") == old
        hashes = [{stage["name"]: stage["hash"] for stage in j["stages"]} for j in (job, restarted)]
        assert hashes[0] == hashes[1]
        new = {stage["name"]: stage["hash"] for stage in api.http.post(path, json={}).json()["stages"]}
        assert new["preflight"] == hashes[0]["preflight"]
        assert new["sync"] != hashes[0]["sync"]

    def test_a_wrong_new_description_changes_nothing(self, api: LiveApi, ready_site: str) -> None:
        before = api.http.get(f"/v1/sites/{ready_site}").json()
        assert_problem(api.http.put(f"/v1/sites/{ready_site}", json={"name": "x"}), 422, "invalid_input")
        assert api.http.get(f"/v1/sites/{ready_site}").json() == before
        assert_problem(api.http.put("/v1/sites/site_0000000000000000", json=SITE), 404, "not_found")

    def test_files_can_be_taken_off(self, api: LiveApi, ready_site: str) -> None:
        [file] = api.http.get(f"/v1/sites/{ready_site}/recordings").json()
        path = f"/v1/sites/{ready_site}/recordings/{file['id']}"
        assert api.http.delete(path).status_code == 204
        assert api.http.get(f"/v1/sites/{ready_site}/recordings").json() == []
        assert_problem(api.http.delete(path), 404, "not_found")


class TestCreatingJobs:
    def test_a_job_has_all_stages(self, api: LiveApi, ready_site: str) -> None:
        created = api.http.post(f"/v1/sites/{ready_site}/jobs", json={"options": {"finetune": {"steps": 7}}})
        assert created.status_code == 201
        job = created.json()
        assert created.headers["Location"] == f"/v1/jobs/{job['id']}"
        assert [stage["name"] for stage in job["stages"]] == list(STAGES)
        assert job["state"] == "queued"
        assert job["stages"][0]["state"] == "queued"
        assert job["options"] == {"finetune": {"steps": 7}}
        assert job["files"][0]["camera"] == "cam1"
        assert api.http.get(f"/v1/jobs/{job['id']}").json()["id"] == job["id"]
        listed = api.http.get("/v1/jobs", params={"site": ready_site}).json()
        assert [item["id"] for item in listed] == [job["id"]]

    def test_a_missing_camera_is_named(self, api: LiveApi, site: str) -> None:
        body = assert_problem(api.http.post(f"/v1/sites/{site}/jobs", json={}), 422, "missing_camera")
        assert body["details"] == {"cameras": ["cam1"]}
        assert "Upload a recording" in body["hint"]

    @pytest.mark.parametrize(
        ("options", "wrong", "name"),
        [
            ({"finetune": {"stepz": 1}}, "unknown", "finetune.stepz"),
            ({"cooking": {}}, "unknown", "cooking"),
            ({"finetune": {"steps": -1}}, "invalid", "finetune.steps"),
            ({"finetune": {"steps": "abc"}}, "invalid", "finetune.steps"),
            ({"finetune": "fast"}, "invalid", "finetune"),
            ({"finetune": {"seed": -1}}, "invalid", "finetune.seed"),
            ({"finetune": {"seed": 10**40}}, "invalid", "finetune.seed"),
        ],
    )
    def test_a_wrong_option_is_named(self, api: LiveApi, ready_site: str, options: dict, wrong: str, name: str) -> None:
        response = api.http.post(f"/v1/sites/{ready_site}/jobs", json={"options": options})
        body = assert_problem(response, 422, f"{wrong}_option")
        assert body["details"]["option"] == name
        assert body["hint"]

    def test_a_custom_detector_has_to_be_there(self, api: LiveApi, ready_site: str) -> None:
        options = {"options": {"detect": {"detector": "custom"}}}
        assert_problem(api.http.post(f"/v1/sites/{ready_site}/jobs", json=options), 422, "invalid_input")

    def test_unknown_fields_are_refused(self, api: LiveApi, ready_site: str) -> None:
        assert_problem(api.http.post(f"/v1/sites/{ready_site}/jobs", json={"option": {}}), 422, "invalid_input")

    def test_an_idempotency_key_makes_one_job(self, api: LiveApi, ready_site: str) -> None:
        path, headers = f"/v1/sites/{ready_site}/jobs", {"Idempotency-Key": "k1"}
        first = api.http.post(path, json={}, headers=headers).json()["id"]
        assert api.http.post(path, json={}, headers=headers).json()["id"] == first
        other = api.http.post(path, json={"options": {"report": {"examples": 2}}}, headers=headers)
        assert_problem(other, 409, "conflict")

    def test_a_plan_starts_nothing(self, api: LiveApi, ready_site: str) -> None:
        plan = api.http.post(f"/v1/sites/{ready_site}/plan", json={}).json()
        assert [stage["would"] for stage in plan] == ["run"] * len(STAGES)
        assert api.http.get("/v1/jobs", params={"site": ready_site}).json() == []

    def test_all_options_are_told(self, api: LiveApi) -> None:
        options = api.http.get("/v1/options").json()
        assert set(options["defaults"]) == set(STAGES) - {"predict"}  # which does what others ask for
        assert "description" in json.dumps(options["schema"])


class TestSteeringJobs:
    def job(self, api: LiveApi, site: str) -> str:
        return str(api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"])

    def test_cancel_and_restart(self, api: LiveApi, ready_site: str) -> None:
        job = self.job(api, ready_site)
        assert_problem(api.http.post(f"/v1/jobs/{job}/restart", json={}), 409, "conflict")
        cancelled = api.http.post(f"/v1/jobs/{job}/cancel")
        assert cancelled.status_code == 202
        assert cancelled.json()["state"] == "cancelled"
        body = {"from_stage": "sync", "options": {"sync": {"method": "none"}}}
        would = {stage["name"]: stage["would"] for stage in api.http.post(f"/v1/jobs/{job}/plan", json=body).json()}
        assert would["sync"] == "run"
        restarted = api.http.post(f"/v1/jobs/{job}/restart", json=body).json()
        assert restarted["state"] == "queued"
        assert restarted["restarts"] == 1
        assert restarted["options"] == body["options"]
        api.http.post(f"/v1/jobs/{job}/cancel")
        wrong = api.http.post(f"/v1/jobs/{job}/restart", json={"from_stage": "cooking"})
        assert_problem(wrong, 422, "unknown_option")

    def test_a_waiting_job_cannot_be_deleted(self, api: LiveApi, ready_site: str) -> None:
        assert_problem(api.http.delete(f"/v1/jobs/{self.job(api, ready_site)}"), 409, "conflict")

    def test_results_that_are_not_there_yet(self, api: LiveApi, ready_site: str) -> None:
        job = self.job(api, ready_site)
        for name in ("metrics", "model", "tracks", "conflicts", "report", "report-link"):
            body = assert_problem(api.http.get(f"/v1/jobs/{job}/{name}"), 409, "conflict")
            assert "Wait" in body["hint"]
        assert api.http.get(f"/v1/jobs/{job}/artifacts").json() == []

    def test_events_are_replayed_then_followed_to_the_end(self, api: LiveApi, ready_site: str) -> None:
        job = self.job(api, ready_site)
        claim = api.services.leases.claim(StageKey(job, "preflight"), "tests")
        assert claim is not None
        api.services.leases.progress(claim, 0.5, "half", {})
        seen: list[tuple[int, str, dict]] = []
        with api.http.stream("GET", f"/v1/jobs/{job}/events") as stream:
            assert stream.headers["content-type"].startswith("text/event-stream")
            for event in server_sent(stream):
                seen.append(event)
                if event[1] == "progress":
                    api.services.jobs.cancel(job)
                    api.services.leases.stopped(claim)
        assert [number for number, _, _ in seen] == list(range(1, len(seen) + 1))
        assert seen[0][2]["data"]["state"] == "queued"
        assert seen[-1][1:] == ("job", seen[-1][2])
        assert seen[-1][2]["data"]["state"] == "cancelled"
        with api.http.stream("GET", f"/v1/jobs/{job}/events", headers={"Last-Event-ID": "3"}) as stream:
            assert [number for number, _, _ in server_sent(stream)] == list(range(4, len(seen) + 1))

    def test_events_after_one_that_cannot_be(self, api: LiveApi, ready_site: str) -> None:
        path = f"/v1/jobs/{self.job(api, ready_site)}/events"
        assert_problem(api.http.get(path, headers={"Last-Event-ID": "9" * 60}), 422, "invalid_input")

    def test_events_of_nothing(self, api: LiveApi) -> None:
        assert_problem(api.http.get("/v1/jobs/job_0000000000000000/events"), 404, "not_found")

    def test_the_log_is_read_by_offset(self, api: LiveApi, ready_site: str) -> None:
        job = self.job(api, ready_site)
        path = f"/v1/jobs/{job}/log"
        assert api.http.get(path).json() == {"text": "", "next_offset": 0, "complete": False}
        log = api.services.folder.log(job)
        log.write_text("first\n")
        part = api.http.get(path).json()
        assert part == {"text": "first\n", "next_offset": 6, "complete": False}
        log.write_text("first\nsecond\n")
        api.http.post(f"/v1/jobs/{job}/cancel")
        part = api.http.get(path, params={"offset": part["next_offset"]}).json()
        assert part["text"] == "second\n"
        assert api.http.get(path, params={"offset": part["next_offset"]}).json()["complete"]
        for offset in ("-1", "99999999999999999999"):
            assert_problem(api.http.get(path, params={"offset": offset}), 422, "invalid_input")
        assert api.http.get(path, params={"offset": 2**40}).json() == {
            "text": "",
            "next_offset": 2**40,
            "complete": True,
        }


def server_sent(stream: httpx.Response) -> Any:
    fields: dict[str, str] = {}
    for line in stream.iter_lines():
        if line.startswith(":"):
            continue
        if line:
            name, _, value = line.partition(": ")
            fields[name] = value
        elif fields:
            yield int(fields["id"]), fields["event"], json.loads(fields["data"])
            fields = {}
