"""The results of a finished job over real HTTP."""

from __future__ import annotations

import csv
import io
from hashlib import sha256
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import httpx
import pyarrow.parquet
import pytest

from tests.finished import CONFLICT, METRICS, VIDEO, finished_job
from tests.service import TOKEN, LiveApi
from wibam_core.client import WibamClient
from wibam_core.errors import Conflict, InputError, NotFound, ServiceUnavailable, Unauthorised
from wibam_core.formats.tracks import read_tracks


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


class TestTracks:
    def states(self, api: LiveApi, job: str, **params: object) -> list[dict]:
        response = api.http.get(f"/v1/jobs/{job}/tracks", params=params)
        assert response.status_code == 200, response.text
        return list(response.json()["states"])

    def test_all_states_sorted(self, api: LiveApi, job: str) -> None:
        states = self.states(api, job)
        assert len(states) == 100
        keys = [(state["time_ns"], state["track_id"]) for state in states]
        assert keys == sorted(keys)
        assert states[0]["class"] == "car"
        assert states[0]["speed_mps"] == pytest.approx(10.0)
        assert states[0]["sd_x_m"] == pytest.approx(0.1)

    def test_by_time_the_start_counts_and_the_end_does_not(self, api: LiveApi, job: str) -> None:
        states = self.states(api, job, start_ns=1_000_000_000, end_ns=2_000_000_000)
        assert {state["time_ns"] for state in states} == {n * 100_000_000 for n in range(10, 20)}

    def test_by_bounds_class_track_and_speed(self, api: LiveApi, job: str) -> None:
        assert {s["x_m"] for s in self.states(api, job, bounds="9.5,-1,12.5,1")} == {10.0, 11.0, 12.0}
        assert {s["track_id"] for s in self.states(api, job, **{"class": "bus"})} == {2}
        assert len(self.states(api, job, **{"class": ["bus", "car"]})) == 100
        assert {s["track_id"] for s in self.states(api, job, track_id=1)} == {1}
        assert {s["track_id"] for s in self.states(api, job, min_speed_mps=1.0)} == {1}
        assert self.states(api, job, min_speed_mps=1.0, **{"class": "bus"}) == []

    def test_by_polygon(self, api: LiveApi, job: str) -> None:
        triangle = "15,-5;25,-5;25,10"
        assert {s["x_m"] for s in self.states(api, job, polygon=triangle, track_id=1)} == {
            19.0,
            20.0,
            21.0,
            22.0,
            23.0,
            24.0,
        }
        assert self.states(api, job, polygon="15,-5;25,-5;25,4", track_id=2) == []

    def test_pages_make_the_whole(self, api: LiveApi, job: str) -> None:
        whole, pages, cursor = self.states(api, job), [], None
        while True:
            params = {"limit": 7, **({"cursor": cursor} if cursor else {})}
            page = api.http.get(f"/v1/jobs/{job}/tracks", params=params).json()
            pages += page["states"]
            cursor = page["next"]
            if cursor is None:
                break
        assert pages == whole

    def test_csv_and_parquet_hold_the_same(self, api: LiveApi, job: str, tmp_path: Path) -> None:
        response = api.http.get(f"/v1/jobs/{job}/tracks", params={"format": "csv"})
        assert response.headers["content-type"].startswith("text/csv")
        assert f"{job}-tracks.csv" in response.headers["content-disposition"]
        rows = list(csv.DictReader(io.StringIO(response.text)))
        assert len(rows) == 100
        assert float(rows[-1]["x_m"]) == 20.0
        response = api.http.get(f"/v1/jobs/{job}/tracks", params={"format": "parquet"})
        table = pyarrow.parquet.read_table(io.BytesIO(response.content))
        assert table.num_rows == 100
        assert table.column_names == list(rows[0])

    def test_an_empty_answer_is_a_valid_file(self, api: LiveApi, job: str) -> None:
        for format in ("csv", "parquet"):
            response = api.http.get(f"/v1/jobs/{job}/tracks", params={"format": format, "track_id": 99})
            assert response.status_code == 200
        assert pyarrow.parquet.read_table(io.BytesIO(response.content)).num_rows == 0

    @pytest.mark.parametrize(
        "params",
        [
            {"bounds": "1,2,3"},
            {"bounds": "1,2,1,2"},
            {"bounds": "a,b,c,d"},
            {"bounds": "nan,0,1,1"},
            {"polygon": "0,0;1,1"},
            {"polygon": "0,0;1"},
            {"class": "boat"},
            {"cursor": "x"},
            {"cursor": "1' OR 1=1"},
            {"start_ns": "9" * 60},
            {"end_ns": "-" + "9" * 60},
            {"track_id": "9" * 60},
            {"limit": 0},
            {"limit": 1_000_000},
            {"min_speed_mps": "nan"},
            {"format": "xml"},
        ],
    )
    def test_questions_without_sense(self, api: LiveApi, job: str, params: dict) -> None:
        response = api.http.get(f"/v1/jobs/{job}/tracks", params=params)
        assert response.status_code == 422, response.text
        assert response.json()["code"] == "invalid_input"
        assert response.json()["hint"]

    @pytest.mark.parametrize("path", ["tracks", "conflicts"])
    def test_a_parameter_that_does_not_exist_is_named(self, api: LiveApi, job: str, path: str) -> None:
        response = api.http.get(f"/v1/jobs/{job}/{path}", params={"format": "json", "min_sped_mps": 3})
        assert response.status_code == 422, response.text
        assert response.json()["details"] == {"parameter": "min_sped_mps"}
        assert "'min_sped_mps'" in response.json()["detail"]
        assert "format" in response.json()["hint"]

    def test_of_the_list_of_jobs_too(self, api: LiveApi) -> None:
        assert api.http.get("/v1/jobs", params={"sites": "x"}).status_code == 422


def test_a_restart_with_nothing_to_redo_leaves_the_job_succeeded(api: LiveApi, job: str) -> None:
    response = api.http.post(f"/v1/jobs/{job}/restart", json={})
    assert response.status_code == 202, response.text
    assert response.json()["state"] == "succeeded"
    assert api.http.get(f"/v1/jobs/{job}/metrics").status_code == 200


class TestFiles:
    @pytest.mark.parametrize(
        ("artifact", "hint"), [("evaluate/nothing.json", "/artifacts lists"), ("cooking/x", "Its stages are preflight")]
    )
    def test_one_that_is_not_there(self, api: LiveApi, job: str, artifact: str, hint: str) -> None:
        response = api.http.get(f"/v1/jobs/{job}/artifacts/{artifact}")
        assert response.status_code == 404
        assert hint in response.json()["hint"]

    def test_the_model_says_what_it_is(self, api: LiveApi, job: str) -> None:
        response = api.http.get(f"/v1/jobs/{job}/model")
        assert response.content == bytes(range(256)) * 4
        assert response.headers["x-wibam-job"] == job
        assert f'filename="{job}.safetensors"' in response.headers["content-disposition"]
        assert response.headers["repr-digest"].startswith("sha-256=:")

    def test_the_model_comes_as_onnx_too(self, api: LiveApi, job: str) -> None:
        response = api.http.get(f"/v1/jobs/{job}/model", params={"format": "onnx"})
        assert response.content == bytes(range(255, -1, -1)) * 3
        assert response.headers["x-wibam-job"] == job
        assert f'filename="{job}.onnx"' in response.headers["content-disposition"]
        explicit = api.http.get(f"/v1/jobs/{job}/model", params={"format": "safetensors"})
        assert explicit.content == api.http.get(f"/v1/jobs/{job}/model").content

    @pytest.mark.parametrize("params", [{"format": "pickle"}, {"formats": "onnx"}])
    def test_a_model_of_another_format_is_refused(self, api: LiveApi, job: str, params: dict) -> None:
        response = api.http.get(f"/v1/jobs/{job}/model", params=params)
        assert response.status_code == 422, response.text
        assert response.json()["hint"]

    def test_a_job_from_before_onnx_says_so(self, api: LiveApi) -> None:
        old = finished_job(api, b"seen by an old job", onnx=False)
        response = api.http.get(f"/v1/jobs/{old}/model", params={"format": "onnx"})
        assert response.status_code == 404, response.text
        assert response.json()["code"] == "not_found"
        assert "'weights.onnx'" in response.json()["detail"]
        assert f"/v1/jobs/{old}/artifacts" in response.json()["hint"]
        assert api.http.get(f"/v1/jobs/{old}/model").status_code == 200

    def test_ranges_are_served(self, api: LiveApi, job: str) -> None:
        path = f"/v1/jobs/{job}/artifacts/finetune/weights.safetensors"
        response = api.http.get(path, headers={"Range": "bytes=10-19"})
        assert response.status_code == 206
        assert response.content == bytes(range(10, 20))
        assert api.http.get(path, headers={"Range": "bytes=5000-"}).status_code == 416

    def test_listed_files_can_all_be_fetched(self, api: LiveApi, job: str) -> None:
        listed = api.http.get(f"/v1/jobs/{job}/artifacts").json()
        assert "evaluate/metrics.json" in {item["id"] for item in listed}
        for item in listed:
            response = api.http.get(f"/v1/jobs/{job}/artifacts/{item['id']}")
            assert len(response.content) == item["size_bytes"]
            assert "attachment" in response.headers["content-disposition"]

    @pytest.mark.parametrize(
        "name", ["manifest.json", "%2e%2e/track/tracks.parquet", "..%2f..%2f..%2fwibam.db", "%2fetc%2fpasswd", "x"]
    )
    def test_only_what_the_stage_wrote(self, api: LiveApi, job: str, name: str) -> None:
        response = httpx.get(
            f"{api.url}/v1/jobs/{job}/artifacts/evaluate/{name}",
            headers={"Authorization": f"Bearer {TOKEN}"},
            timeout=300,
        )
        assert response.status_code == 404

    def test_metrics_and_conflicts(self, api: LiveApi, job: str) -> None:
        assert api.http.get(f"/v1/jobs/{job}/metrics").json() == METRICS.model_dump(mode="json", by_alias=True)
        assert api.http.get(f"/v1/jobs/{job}/conflicts").json()["conflicts"] == [CONFLICT.model_dump(mode="json")]
        [row] = csv.DictReader(io.StringIO(api.http.get(f"/v1/jobs/{job}/conflicts?format=csv").text))
        assert row["classes_1"] == "car"
        assert row["ttc_interval_s_low"] == "1.0"
        assert row["ttc_interval_s_high"] == ""

    def test_recordings_tell_what_preflight_found(self, api: LiveApi, job: str) -> None:
        site = api.http.get(f"/v1/jobs/{job}").json()["site_id"]
        [recording] = api.http.get(f"/v1/sites/{site}/recordings").json()
        assert recording["probe"] == VIDEO.model_dump()


class TestReport:
    def test_needs_the_token_or_a_link(self, api: LiveApi, job: str) -> None:
        assert api.http.get(f"/v1/jobs/{job}/report").text == "<h1>report</h1>"
        assert httpx.get(f"{api.url}/v1/jobs/{job}/report", timeout=300).status_code == 401
        link = api.http.get(f"/v1/jobs/{job}/report-link").json()["url"]
        response = httpx.get(api.url + link, timeout=300)
        assert response.text == "<h1>report</h1>"
        assert "sandbox" in response.headers["content-security-policy"]

    def test_links_open_one_report_alone(self, api: LiveApi, job: str) -> None:
        link = urlsplit(api.http.get(f"/v1/jobs/{job}/report-link").json()["url"])
        values = {name: value[0] for name, value in parse_qs(link.query).items()}
        later = {**values, "expires": str(int(values["expires"]) + 1)}
        for path, params in (
            ("/reports/job_0000000000000000", values),
            (link.path, later),
            (link.path, {**values, "signature": "0" * 64}),
            (link.path, {**values, "signature": "é"}),
        ):
            assert httpx.get(api.url + path, params=params, timeout=300).status_code == 401
        assert httpx.get(api.url + link.path, timeout=300).status_code == 422


class TestTracksInLittleSpace:
    """Track 1 drives along X at 10 m/s, ten times a second; track 2 stands."""

    def test_a_summary_takes_the_same_questions(self, api: LiveApi, job: str) -> None:
        def ask(**params: object) -> dict:
            return dict(api.http.get(f"/v1/jobs/{job}/tracks/summary", params=params).json())

        whole = ask()
        assert (whole["states"], whole["tracks"], whole["fastest_mps"]) == (100, 2, 10.0)
        assert (whole["first_ns"], whole["last_ns"], whole["period_ns"]) == (0, 4_900_000_000, 100_000_000)
        assert whole["bounds_m"] == [0.0, 0.0, 49.0, 5.0]
        assert whole["classes"] == [{"class": name, "tracks": 1, "states": 50} for name in ("bus", "car")]
        assert ask(bounds="9.5,-1,12.5,1")["states"] == 3
        assert ask(track_id=99) == {
            **dict.fromkeys(("first_ns", "last_ns", "period_ns", "fastest_mps", "bounds_m")),
            "states": 0,
            "tracks": 0,
            "classes": [],
        }

    def test_a_stretch_is_a_list_for_each_number(self, api: LiveApi, job: str) -> None:
        params = {"start_ns": 1_000_000_000, "end_ns": 1_300_000_000}
        found = api.http.get(f"/v1/jobs/{job}/tracks/compact", params=params).json()
        assert (found["times_ns"], found["next"]) == ([10**9, 11 * 10**8, 12 * 10**8], None)
        car, bus = found["tracks"]
        assert (car["track_id"], car["class"], car["at"], car["x_m"]) == (1, "car", [0, 1, 2], [10.0, 11.0, 12.0])
        assert (bus["class"], bus["x_m"], bus["length_m"], bus["yaw_rad"]) == ("bus", [20.0], [12.0], [0.0])
        page = api.http.get(f"/v1/jobs/{job}/tracks/compact", params={**params, "limit": 5}).json()
        rest = api.http.get(f"/v1/jobs/{job}/tracks/compact", params={**params, "cursor": page["next"]}).json()
        assert [one["track_id"] for one in rest["tracks"]] == [2]

    def test_paths_have_corners_where_somebody_turns(self, api: LiveApi, job: str) -> None:
        found = api.http.get(f"/v1/jobs/{job}/tracks/paths").json()
        assert [(one["class"], one["x_m"], one["y_m"]) for one in found["paths"]] == [
            ("car", [0.0, 49.0], [0.0, 0.0]),
            ("bus", [20.0], [5.0]),
        ]

    @pytest.mark.parametrize("view", ["summary", "compact", "paths"])
    def test_an_answer_says_of_which_tracks_it_is(self, api: LiveApi, job: str, view: str) -> None:
        file = api.http.get(f"/v1/jobs/{job}/artifacts/track/tracks.parquet").content
        answer = api.http.get(f"/v1/jobs/{job}/tracks/{view}")
        assert answer.headers["etag"] == f'"{sha256(file).hexdigest()}"'
        for kept in (answer.headers["etag"], f'"other", W/{answer.headers["etag"]}'):
            again = api.http.get(f"/v1/jobs/{job}/tracks/{view}", headers={"If-None-Match": kept})
            assert (again.status_code, again.content) == (304, b"")
            assert again.headers["etag"] == answer.headers["etag"]
        other = api.http.get(f"/v1/jobs/{job}/tracks/{view}", headers={"If-None-Match": '"other"'})
        assert (other.status_code, other.json()) == (200, answer.json())

    @pytest.mark.parametrize("view", ["summary", "compact", "paths"])
    def test_bad_questions_are_refused(self, api: LiveApi, job: str, view: str) -> None:
        for params in ({"bounds": "1,2"}, {"polygon": "0,0;1,1"}, {"class": "tank"}, {"from": 1}):
            assert api.http.get(f"/v1/jobs/{job}/tracks/{view}", params=params).status_code == 422, params
        assert api.http.get(f"/v1/jobs/job_0/tracks/{view}").status_code == 404

    def test_the_client_reads_them(self, api: LiveApi, job: str) -> None:
        client = WibamClient(api.url, TOKEN)
        assert client.tracks_summary(job, vehicle_class=["bus"]).states == 50
        assert [len(page.times_ns) for page in client.compact_tracks(job, limit=60)] == [30, 20]
        assert client.track_paths(job, track_id=[1]).paths[0].x_m == [0.0, 49.0]


class TestClient:
    @pytest.fixture
    def client(self, api: LiveApi) -> WibamClient:
        return WibamClient(api.url, TOKEN)

    def test_fetches_everything(self, client: WibamClient, job: str, tmp_path: Path) -> None:
        assert client.metrics(job) == METRICS
        assert client.conflicts(job).conflicts == [CONFLICT]
        buses = list(client.tracks(job, vehicle_class=["bus"]))
        assert len(buses) == 50 and {(state.road_user_class, state.x_m) for state in buses} == {("bus", 20.0)}
        assert client.download_model(job, tmp_path / "w").read_bytes() == bytes(range(256)) * 4
        assert client.download_model(job, tmp_path / "w.onnx", "onnx").read_bytes() == bytes(range(255, -1, -1)) * 3
        assert len(read_tracks(client.download_tracks(job, tmp_path / "t.parquet"))) == 2
        assert client.download_tracks(job, tmp_path / "t.csv", "csv").read_text().startswith('"time_ns"')
        assert "states" in client.download_tracks(job, tmp_path / "t.json", "json").read_text()
        assert client.download_report(job, tmp_path / "r.html").read_text() == "<h1>report</h1>"
        assert httpx.get(client.report_url(job), timeout=300).text == "<h1>report</h1>"
        for item in client.artifacts(job):
            assert client.download_artifact(job, item.id, tmp_path / "a").stat().st_size == item.size_bytes
        view = client.wait(job)
        assert view.state.value == "succeeded"
        assert [p.name for p in tmp_path.iterdir() if p.suffix == ".part"] == []

    def test_errors_come_back_as_what_they_were(
        self, client: WibamClient, api: LiveApi, job: str, tmp_path: Path
    ) -> None:
        with pytest.raises(NotFound):
            client.job("job_0000000000000000")
        with pytest.raises(InputError, match="bounds"):
            client.download_tracks(job, tmp_path / "t", "csv", bounds="1")
        with pytest.raises(Unauthorised):
            WibamClient(api.url, "wrong").sites()
        with pytest.raises(ServiceUnavailable) as caught:
            WibamClient("http://127.0.0.1:9", "x").sites()
        assert "wibam serve" in caught.value.hint
        assert list(tmp_path.iterdir()) == []

    def test_sends_files_in_pieces(
        self, client: WibamClient, api: LiveApi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("wibam_core.client.uploading._PIECE_BYTES", 1000)
        path = tmp_path / "x.mp4"
        path.write_bytes(bytes(3500))
        reported: list[tuple[int, int]] = []
        site = api.site(cameras=1)
        client.upload_recording(site, "cam1", path, lambda sent, size: reported.append((sent, size)))
        assert reported == [(1000, 3500), (2000, 3500), (3000, 3500), (3500, 3500)]
        [file] = client.files(site)
        assert file.size_bytes == 3500
        with pytest.raises(Conflict):
            client.restart(client.create_job(site).id)


def test_outputs_go_with_the_last_job_that_uses_them(api: LiveApi) -> None:
    recording = b"seen in this test alone"
    first, second = finished_job(api, recording), finished_job(api, recording)
    stages = api.services.jobs.job(first).stages
    assert [stage.hash for stage in api.services.jobs.job(second).stages] == [stage.hash for stage in stages]

    def there() -> set[bool]:
        of_recordings = [stage for stage in stages if stage.name != "calibrate"]  # which other jobs' sites share
        return {api.services.stages.find(stage.name, stage.hash) is not None for stage in of_recordings}

    site = api.http.get(f"/v1/jobs/{first}").json()["site_id"]
    plan = api.http.post(f"/v1/sites/{site}/plan", json={}).json()
    assert {stage["would"] for stage in plan} == {"reuse"}
    assert api.http.delete(f"/v1/jobs/{first}").status_code == 204
    assert api.http.get(f"/v1/jobs/{first}").status_code == 404
    assert there() == {True}
    assert api.http.get(f"/v1/jobs/{second}/metrics").status_code == 200
    assert api.http.delete(f"/v1/jobs/{second}").status_code == 204
    assert there() == {False}
