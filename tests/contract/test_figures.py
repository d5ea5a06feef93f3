"""What Prometheus is told, as its own parser reads it."""

from __future__ import annotations

import httpx
import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families as parse_text

from tests.finished import finished_job
from tests.service import LiveApi


def figures(api: LiveApi) -> dict[tuple[str, ...], float]:
    """Values by name and the labels' values in the order of the labels' names."""
    answer = api.http.get("/metrics")
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith("text/plain; version=")
    samples = [sample for family in parse_text(answer.text) for sample in family.samples]
    return {(sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value for sample in samples}


class TestFigures:
    def test_they_need_the_token_or_a_key_that_may_read(self, api: LiveApi) -> None:
        assert httpx.get(f"{api.url}/metrics", timeout=300).status_code == 401
        for scope, status in (("read", 200), ("upload", 403)):
            secret = api.http.post("/v1/keys", json={"name": "prometheus", "scopes": [scope]}).json()["secret"]
            headers = {"Authorization": f"Bearer {secret}"}
            assert httpx.get(f"{api.url}/metrics", headers=headers, timeout=300).status_code == status

    def test_openmetrics_is_spoken_where_it_is_asked_for(self, api: LiveApi) -> None:
        answer = api.http.get("/metrics", headers={"Accept": "application/openmetrics-text; version=1.0.0"})
        assert answer.headers["content-type"].startswith("application/openmetrics-text")
        names = {family.name for family in parse_openmetrics(answer.text)}
        assert {"wibam_stages_waiting", "wibam_lease_losses", "wibam_http_requests"} <= names

    def test_bytes_are_counted_once_however_they_come(self, api: LiveApi) -> None:
        before = figures(api)["wibam_uploaded_bytes_total",]
        site = api.site()
        begun = api.begin(site, 100, body=b"x" * 30)
        path = begun.headers["Location"]
        assert api.send(path, 30, b"y" * 50).status_code == 204
        assert api.send(path, 30, b"y" * 50).status_code == 409
        assert api.send(path, 80, b"z" * 20).status_code == 204
        assert figures(api)["wibam_uploaded_bytes_total",] - before == 100

    def test_problems_are_counted_by_their_codes(self, api: LiveApi) -> None:
        problem, request = ("wibam_http_problems_total", "not_found"), ("wibam_http_requests_total", "GET", "404")
        before = figures(api)
        assert api.http.get("/v1/sites/site_0").status_code == 404
        after = figures(api)
        assert after[problem] - before.get(problem, 0) == 1
        assert after[request] - before.get(request, 0) == 1

    def test_a_job_leaves_its_counts_when_it_is_deleted(self, api: LiveApi) -> None:
        key = ("wibam_stage_seconds_count", "succeeded", "lift")
        before = figures(api)
        job = finished_job(api)
        after = figures(api)
        assert after[key] - before.get(key, 0) == 1
        assert after["wibam_jobs", "succeeded"] - before["wibam_jobs", "succeeded"] == 1
        assert api.http.delete(f"/v1/jobs/{job}").status_code in (200, 202, 204)
        assert figures(api)[key] == after[key]

    @pytest.mark.parametrize("method", ["BREW", "GET"])
    def test_methods_that_nobody_knows_make_no_new_figure(self, api: LiveApi, method: str) -> None:
        httpx.request(method, f"{api.url}/healthz", timeout=300)
        methods = {key[1] for key in figures(api) if key[0] == "wibam_http_requests_total"}
        assert methods <= {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "other"}
