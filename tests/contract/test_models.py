"""Networks, footage, runs and the site's table of tracks, over HTTP, with outputs that nobody computed."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from tests.finished import METRICS, publish, tracks
from tests.service import LiveApi
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.documents.conflicts import Conflicts
from wibam_core.formats.usual import Found, Usual
from wibam_core.models.weights import bundled

DAY_S = 86_400
MIDNIGHT_NS = 1_782_950_400_000_000_000  # 2026-07-02T00:00:00Z
#: The tracks last 4.9 s: these cross midnight, UTC.
BEGIN, BEGIN_NS = "2026-07-02T01:59:58+02:00", MIDNIGHT_NS - 2_000_000_000


def made(start_ns: int = 0, weights: bytes | None = None):
    """Writes what stages would have made, with tracks from a time on."""

    def write(stage: str, folder: Path) -> None:
        writer = ArtifactWriter(stage, folder, made_by(stage))
        if stage == "finetune":
            writer.new_file(catalogue.WEIGHTS).write_bytes(weights or b"")
        if stage == "evaluate":
            writer.write(catalogue.METRICS, METRICS)
        if stage == "track":
            writer.write(catalogue.TRACKS, [replace(one, times_ns=one.times_ns + start_ns) for one in tracks()])
            writer.write(catalogue.USUAL, Usual({}, {"cam1": Found(10, 20, 0.8)}))
            writer.new_file(catalogue.OPEN_TRACKS).write_bytes(b"open tracks")
        if stage == "safety":
            writer.write(catalogue.CONFLICTS, Conflicts(thresholds={"ttc_s": 3.0}, conflicts=[]))

    return write


def footage(api: LiveApi, site: str, name: str, begin: str, camera: str = "cam1") -> str:
    api.upload(site, name.encode(), camera, purpose="footage", filename=name, started_at=begin)
    found = api.http.get(f"/v1/sites/{site}/footage", params={"camera": camera}).json()
    return str(next(file["id"] for file in found if file["filename"] == name))


@pytest.fixture(scope="module")
def model(api: LiveApi) -> dict:
    """The network of a finished job."""
    site = api.site(cameras=2)
    for camera in ("cam1", "cam2"):
        api.upload(site, b"not looked at", camera)
    created = api.http.post(f"/v1/sites/{site}/jobs", json={"name": "ten minutes"})
    publish(api, created.json()["id"], made(weights=bundled("mono_small.safetensors").read_bytes()))
    found = api.http.get("/v1/models", params={"job": created.json()["id"]}).json()
    assert len(found) == 1
    return dict(found[0])


@pytest.fixture(scope="module")
def run(api: LiveApi, model: dict) -> dict:
    """A finished run of it."""
    file = footage(api, model["site_id"], "a.mp4", BEGIN)
    created = api.http.post(f"/v1/models/{model['id']}/runs", json={"files": [file]})
    assert created.status_code == 201, created.text
    publish(api, created.json()["id"], made(BEGIN_NS))
    return dict(created.json())


class TestModels:
    def test_a_job_s_network_has_its_card(self, api: LiveApi, model: dict) -> None:
        assert model["name"] == "ten minutes"
        assert (model["version"], model["state"], model["watches"]) == (1, "candidate", True)
        about = model["about"]
        assert about["cameras"] == ["cam1", "cam2"]
        assert about["card"]["family"] == "wibam-small"
        assert about["parent"]["name"] == "bundled"
        assert about["training"]["options"]["network"] == "small"
        assert about["metrics"]["self_consistency"]["finetuned"]["other_views"] == {"mean": 0.7, "sd": 0.1}
        got = api.http.get(f"/v1/models/{model['id']}/file")
        assert got.content == bundled("mono_small.safetensors").read_bytes()
        assert got.headers["ETag"] == f'"{model["sha256"]}"'
        assert api.http.get(f"/v1/models/{model['id']}/file", params={"format": "onnx"}).status_code == 404

    def test_a_deleted_one_comes_back_only_where_it_is_asked_for(self, api: LiveApi) -> None:
        site = api.site(cameras=1)
        api.upload(site, b"not looked at", "cam1")
        job = api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"]
        publish(api, job, made(weights=bundled("mono_small.safetensors").read_bytes()))
        (first,) = api.http.get("/v1/models", params={"site": site}).json()
        assert api.http.delete(f"/v1/models/{first['id']}").status_code == 204
        assert api.http.get("/v1/models", params={"site": site}).json() == []
        assert api.http.get(f"/v1/models/{first['id']}").status_code == 404
        assert not api.services.folder.model(first["id"]).exists()
        asked = api.http.post("/v1/models", json={"job_id": job})
        assert (asked.status_code, asked.json()["version"]) == (201, 2)
        assert [one["id"] for one in api.http.get("/v1/models", params={"site": site}).json()] == [asked.json()["id"]]

    def test_folders_of_networks_that_nobody_knows_are_tidied(self, api: LiveApi, model: dict) -> None:
        folder = api.services.folder
        interrupted = folder.root / "models" / "model_0123456789abcdef.partial"
        interrupted.mkdir()
        folder.tidy_models(api.services.models.ids)
        assert interrupted.exists(), "it may be on its way"
        folder.tidy_models(api.services.models.ids, older_than_s=-1.0)
        assert not interrupted.exists()
        assert folder.model(model["id"]).exists()

    def test_one_at_most_is_promoted(self, api: LiveApi, model: dict) -> None:
        path = f"/v1/models/{model['id']}"
        assert api.http.patch(path, json={"state": "promoted"}).json()["state"] == "promoted"
        assert [one["id"] for one in api.http.get("/v1/models", params={"state": "promoted"}).json()] == [model["id"]]
        assert api.http.patch(path, json={"state": "retired", "name": "old"}).json()["name"] == "old"
        assert api.http.patch(path, json={"state": "best"}).status_code == 422
        api.http.patch(path, json={"state": "candidate", "name": "ten minutes"})

    @pytest.mark.parametrize(
        ("body", "status", "code"),
        [
            ({}, 422, "input"),
            ({"job_id": "job_0"}, 404, "not_found"),
            ({"job_id": "job_0", "file_id": "file_0"}, 422, "input"),
            ({"site_id": "site_0", "file_id": "file_0"}, 404, "not_found"),
        ],
    )
    def test_what_cannot_be_kept(self, api: LiveApi, body: dict, status: int, code: str) -> None:
        answer = api.http.post("/v1/models", json=body)
        assert answer.status_code == status
        if status == 404:
            assert answer.json()["code"] == code

    def test_an_upload_of_a_network_that_the_site_has_is_that_one(self, api: LiveApi, model: dict) -> None:
        weights = bundled("mono_small.safetensors").read_bytes()
        site, other = model["site_id"], api.site(cameras=1)

        def kept(at: str) -> dict:
            api.upload(at, weights, "", purpose="model", filename="again.safetensors")
            [file] = [one for one in api.services.sites.all_files(at) if one.purpose.value == "model"]
            answer = api.http.post("/v1/models", json={"site_id": at, "file_id": file.id})
            assert answer.status_code == 201, answer.text
            return dict(answer.json())

        before = {one["id"] for one in api.http.get("/v1/models").json()}
        assert kept(site) == api.http.get(f"/v1/models/{model['id']}").json()
        first = kept(other)
        assert kept(other) == first
        assert {one["id"] for one in api.http.get("/v1/models").json()} - before == {first["id"]}
        assert first["version"] == 1

    def test_an_upload_that_is_no_network_is_refused(self, api: LiveApi, model: dict) -> None:
        api.upload(model["site_id"], b"no network", "", purpose="model", filename="x.safetensors")
        files = api.services.sites.all_files(model["site_id"])
        file = next(one for one in files if one.purpose.value == "model")
        answer = api.http.post("/v1/models", json={"site_id": model["site_id"], "file_id": file.id})
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_weights")
        recording = next(one for one in files if one.purpose.value == "recording")
        answer = api.http.post("/v1/models", json={"site_id": model["site_id"], "file_id": recording.id})
        assert answer.status_code == 422


class TestFootage:
    def test_when_it_began_is_said_and_corrected(self, api: LiveApi, model: dict) -> None:
        site = model["site_id"]
        file = footage(api, site, "dated.mp4", "2026-07-01T08:00:00.25+02:00")
        listed = {one["id"]: one for one in api.http.get(f"/v1/sites/{site}/footage").json()}
        assert listed[file]["started_at"] == "2026-07-01T06:00:00.250000Z"
        path = f"/v1/sites/{site}/footage/{file}"
        assert (
            api.http.patch(path, json={"started_at": "2026-07-01 09:00:00Z"})
            .json()["started_at"]
            .startswith("2026-07-01T09")
        )
        assert api.http.patch(path, json={"started_at": "yesterday"}).status_code == 422
        assert api.http.patch(path, json={"started_at": "2026-07-01T08:00:00"}).status_code == 422, "no offset"
        assert api.http.patch(path, json={"started_at": None}).json()["started_at"] is None
        assert api.http.delete(path).status_code == 204
        assert api.http.patch(path, json={"started_at": None}).status_code == 404

    def test_footage_is_no_recording_of_jobs(self, api: LiveApi, model: dict) -> None:
        site = model["site_id"]
        footage(api, site, "more.mp4", BEGIN)
        purposes = [one["purpose"] for one in api.http.get(f"/v1/sites/{site}/recordings").json()]
        assert "footage" not in purposes


class TestRuns:
    def test_a_run_is_a_job_of_its_cameras_alone(self, api: LiveApi, model: dict, run: dict) -> None:
        assert (run["kind"], run["model_id"], run["continues"]) == ("run", model["id"], None)
        assert [stage["name"] for stage in run["stages"]] == ["preflight", "calibrate", "sync", "track", "safety"]
        assert {file["camera"] for file in run["files"]} == {"cam1"}
        assert run["id"] not in [job["id"] for job in api.http.get("/v1/jobs").json()]
        assert run["id"] in [job["id"] for job in api.http.get("/v1/jobs", params={"kind": "run"}).json()]
        assert len(api.http.get(f"/v1/jobs/{run['id']}/tracks").json()["states"]) == 100

    def test_it_is_restarted_with_other_options(self, api: LiveApi, run: dict) -> None:
        body = {"options": {"track": {"rate_hz": 2}}}
        would = {one["name"]: one["would"] for one in api.http.post(f"/v1/jobs/{run['id']}/plan", json=body).json()}
        assert would == {
            "preflight": "reuse", "calibrate": "reuse", "sync": "reuse", "track": "run", "safety": "run",
        }  # fmt: skip

    def test_it_goes_on_with_a_run_of_the_same_cameras(self, api: LiveApi, model: dict, run: dict) -> None:
        site, path = model["site_id"], f"/v1/models/{model['id']}/runs"
        later = footage(api, site, "b.mp4", "2026-07-02T00:00:03Z")
        other = footage(api, site, "b.mp4", "2026-07-02T00:00:03Z", "cam2")
        refused = api.http.post(path, json={"files": [other], "continues": run["id"]})
        assert refused.status_code == 409
        first = api.http.post(path, json={"files": [later], "continues": run["id"]}, headers={"Idempotency-Key": "k"})
        again = api.http.post(path, json={"files": [later], "continues": run["id"]}, headers={"Idempotency-Key": "k"})
        assert first.json()["id"] == again.json()["id"]
        assert first.json()["continues"] == run["id"]
        assert api.http.delete(f"/v1/models/{model['id']}").status_code == 409, "a run works with it"
        api.http.post(f"/v1/jobs/{first.json()['id']}/cancel")

    def test_what_is_refused(self, api: LiveApi, model: dict) -> None:
        path = f"/v1/models/{model['id']}/runs"
        assert api.http.post(path, json={"files": []}).status_code == 422
        assert api.http.post(path, json={"files": ["file_0"]}).status_code == 404
        assert api.http.post("/v1/models/model_0/runs", json={"files": ["file_0"]}).status_code == 404
        file = footage(api, model["site_id"], "c.mp4", BEGIN)
        wrong = api.http.post(path, json={"files": [file], "options": {"track": {"rate": 2}}})
        assert (wrong.status_code, wrong.json()["code"]) == (422, "unknown_option")


class TestSiteTracks:
    @pytest.fixture(autouse=True)
    def _there(self, run: dict) -> None:
        pass

    def states(self, api: LiveApi, site: str, **params: object) -> list[dict]:
        answer = api.http.get(f"/v1/sites/{site}/tracks", params=params)
        assert answer.status_code == 200, answer.text
        return list(answer.json()["states"])

    def test_all_states_on_the_one_clock(self, api: LiveApi, model: dict, run: dict) -> None:
        states = self.states(api, model["site_id"])
        assert len(states) == 100
        assert {(state["run_id"], state["first_run_id"], state["camera"]) for state in states} == {
            (run["id"], run["id"], "cam1")
        }
        times = [state["time_ns"] for state in states]
        assert times == sorted(times)
        assert times[0] == BEGIN_NS
        parts = api.http.get(f"/v1/sites/{model['site_id']}/tracks/parts").json()
        assert [(part["run_id"], part["states"]) for part in parts] == [(run["id"], 100)], "the job is not dated"

    def test_it_lies_by_day_and_camera(self, api: LiveApi, model: dict) -> None:
        root = api.services.folder.site_tracks / model["site_id"]
        found = sorted(path.parent.relative_to(root).as_posix() for path in root.glob("*/*/*"))
        assert found == ["day=2026-07-01/camera=cam1", "day=2026-07-02/camera=cam1"]
        for path in root.glob("*/*/*"):
            times = pyarrow.parquet.read_table(path)["time_ns"].to_numpy()
            assert (np.diff(times) >= 0).all()

    def test_filters(self, api: LiveApi, model: dict, run: dict) -> None:
        site = model["site_id"]
        assert len(self.states(api, site, **{"from": "2026-07-02T00:00:00Z"})) == 60
        assert len(self.states(api, site, to="2026-07-02T02:00:00+02:00")) == 40
        assert {one["track_id"] for one in self.states(api, site, **{"class": "bus"})} == {2}
        assert {one["track_id"] for one in self.states(api, site, min_speed_mps=1)} == {1}
        assert len(self.states(api, site, bounds="-1,-1,10.5,1")) == 11
        assert len(self.states(api, site, polygon="19,4;21,4;21,6;19,6")) == 50
        assert len(self.states(api, site, camera="cam1", run=run["id"], model=model["id"])) == 100
        assert self.states(api, site, camera="cam2") == []
        assert self.states(api, site, **{"from": "2027-01-01T00:00:00Z"}) == []
        assert api.http.get(f"/v1/sites/{site}/tracks", params={"from": "soon"}).status_code == 422
        assert api.http.get("/v1/sites/site_0/tracks").status_code == 404

    def test_pages_and_files(self, api: LiveApi, model: dict) -> None:
        path, found, cursor = f"/v1/sites/{model['site_id']}/tracks", [], None
        while True:
            page = api.http.get(path, params={"limit": 33} | ({} if cursor is None else {"cursor": cursor})).json()
            found += page["states"]
            cursor = page["next"]
            if cursor is None:
                break
        assert found == self.states(api, model["site_id"])
        table = pyarrow.parquet.read_table(io.BytesIO(api.http.get(path, params={"format": "parquet"}).content))
        assert table.num_rows == 100
        assert len(api.http.get(path, params={"format": "csv"}).text.splitlines()) == 101
        assert api.http.get(path, params={"cursor": "x"}).status_code == 422

    def test_counts(self, api: LiveApi, model: dict) -> None:
        path = f"/v1/sites/{model['site_id']}/tracks/counts"
        counts = api.http.get(path).json()
        assert [(one["start"], one["class"], one["road_users"]) for one in counts] == [
            ("2026-07-01T23:00:00Z", "bus", 1),
            ("2026-07-01T23:00:00Z", "car", 1),
            ("2026-07-02T00:00:00Z", "bus", 1),
            ("2026-07-02T00:00:00Z", "car", 1),
        ]
        (month,) = api.http.get(path, params={"by": "month", "class": "car"}).json()
        assert (month["start"], month["road_users"]) == ("2026-07-01T00:00:00Z", 1)
        assert month["mean_speed_mps"] == pytest.approx(10.0)

    def test_a_deleted_run_leaves_it(self, api: LiveApi, model: dict) -> None:
        file = footage(api, model["site_id"], "gone.mp4", "2026-08-01T00:00:00Z")
        created = api.http.post(f"/v1/models/{model['id']}/runs", json={"files": [file]}).json()
        publish(api, created["id"], made(MIDNIGHT_NS + 30 * DAY_S * 1_000_000_000))
        august = {"from": "2026-08-01T00:00:00Z"}
        assert len(self.states(api, model["site_id"], **august)) == 100
        assert api.http.delete(f"/v1/jobs/{created['id']}").status_code == 204
        assert self.states(api, model["site_id"], **august) == []
        killed = api.services.folder.site_tracks / ".partial-0123456789abcdef"
        killed.mkdir()
        (killed / "20000.parquet").write_bytes(b"half")
        api.services.site_tracks.tidy()
        root = api.services.folder.site_tracks / model["site_id"]
        assert list(root.glob("day=2026-08-01/*/*")) and killed.exists(), "they may be on their way"
        api.services.site_tracks.tidy(older_than_s=-1.0)
        assert not list(root.glob("day=2026-08-01/*/*")) and not killed.exists()

    def test_tracks_that_were_made_anew_leave_the_old_files(self, api: LiveApi, model: dict, run: dict) -> None:
        (path,) = (api.services.folder.site_tracks / model["site_id"]).glob(f"day=2026-07-02/*/{run['id']}-*")
        before = path.with_name(f"{run['id']}-{'0' * 16}.parquet")
        before.write_bytes(path.read_bytes())
        api.services.site_tracks.tidy(older_than_s=-1.0)
        assert path.exists() and not before.exists()

    def test_what_does_not_fit_is_sorted_on_the_data_folder_s_disk(self, api: LiveApi) -> None:
        root = api.services.folder.site_tracks
        with api.services.site_tracks._connection() as connection:
            (spilled,) = connection.execute("SELECT current_setting('temp_directory')").fetchone() or ("",)
            assert Path(spilled).parent == root and Path(spilled).name.startswith(".partial-")
            Path(spilled).mkdir(exist_ok=True)
        assert not list(root.glob(".partial-*"))
