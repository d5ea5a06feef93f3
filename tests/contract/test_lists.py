"""Lists over real HTTP: every one comes in pages that follow each other, and is filtered."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import httpx
import pytest

from tests.service import TOKEN, LiveApi
from wibam_core.client import WibamClient


@pytest.fixture(scope="module")
def site(api: LiveApi) -> str:
    site = api.site(cameras=1)
    api.upload(site, b"a recording")
    return site


@pytest.fixture(scope="module")
def jobs(api: LiveApi, site: str) -> list[str]:
    """Five jobs, the newest first: "job 4" to "job 0", tagged "even" or "odd", the last two "wet", too."""
    made = []
    for number in range(5):
        tags = ["odd" if number % 2 else "even", *(["wet"] if number > 2 else [])]
        answer = api.http.post(f"/v1/sites/{site}/jobs", json={"name": f"job {number}", "tags": tags})
        assert answer.status_code == 201, answer.text
        made.append(str(answer.json()["id"]))
    return made[::-1]


def pages(api: LiveApi, path: str, **params: Any) -> Iterator[list[Any]]:
    answer = api.http.get(path, params=params)
    while True:
        assert answer.status_code == 200, answer.text
        yield answer.json()
        if "next" not in answer.links:
            return
        answer = api.http.get(answer.links["next"]["url"])


def names(found: httpx.Response) -> list[str]:
    assert found.status_code == 200, found.text
    return [job["name"] for job in found.json()]


class TestTags:
    def test_filter_and_are_replaced(self, api: LiveApi, site: str, jobs: list[str]) -> None:
        assert names(api.http.get("/v1/jobs", params={"tag": "odd", "site": site})) == ["job 3", "job 1"]
        assert names(api.http.get("/v1/jobs", params={"tag": ["odd", "wet"], "site": site})) == ["job 3"]
        assert names(api.http.get("/v1/jobs", params={"tag": "wat"})) == []
        before = api.http.get(f"/v1/jobs/{jobs[0]}").json()
        assert before["tags"] == ["even", "wet"]
        marked = api.http.patch(f"/v1/jobs/{jobs[0]}", json={"tags": ["Süd", "Süd", "a, b"]}).json()
        assert (marked["tags"], marked["name"]) == (["Süd", "a, b"], before["name"])
        assert names(api.http.get("/v1/jobs", params={"tag": "a, b"})) == [before["name"]]
        assert api.http.patch(f"/v1/jobs/{jobs[0]}", json={"tags": before["tags"]}).json() == before

    @pytest.mark.parametrize("tags", [[""], [" "], ["a\nb"], ["x" * 65], ["x"] * 21, "x"])
    def test_that_are_none_are_refused(self, api: LiveApi, jobs: list[str], tags: Any) -> None:
        assert api.http.patch(f"/v1/jobs/{jobs[0]}", json={"tags": tags}).status_code == 422


class TestPages:
    def test_show_every_job_once_whatever_comes_or_goes_meanwhile(
        self, api: LiveApi, site: str, jobs: list[str]
    ) -> None:
        followed = pages(api, "/v1/jobs", site=site, limit=2)
        first = next(followed)
        between = api.http.post(f"/v1/sites/{site}/jobs", json={"name": "between"}).json()["id"]
        api.services.jobs.cancel(first[-1]["id"])
        api.services.jobs.delete(first[-1]["id"], lambda stage, hash: None)
        rest = [job["id"] for page in followed for job in page]
        assert [*(job["id"] for job in first), *rest] == jobs
        assert next(pages(api, "/v1/jobs", site=site, limit=1))[0]["id"] == between

    def test_keep_the_filters(self, api: LiveApi, site: str, jobs: list[str]) -> None:
        found = [job["name"] for page in pages(api, "/v1/jobs", site=site, tag="even", limit=1) for job in page]
        assert found == [name for name in ("job 4", "job 2", "job 0") if name in found]
        assert len(found) >= 2

    @pytest.mark.parametrize(
        "path", ["/v1/sites", "/v1/jobs", "/v1/models", "/v1/keys", "/v1/audit", "/v1/sites/{site}/recordings"]
    )
    def test_every_list_refuses_what_is_no_cursor(self, api: LiveApi, site: str, path: str) -> None:
        forged = (
            ["x"], [1.5], [1, 2, 3, 4, 5], {"a": 1}, "x", None, [True, "x"], [1.0, 2.0], [float("inf"), "x"],
            [float("nan"), "x"], [10**400, "x"], [-(10**400), "x"], [10**400], [1.0, "\ud800"], ["\ud800"] * 4,
            [1.0, "\0"],
        )  # fmt: skip
        cursors = [base64.urlsafe_b64encode(json.dumps(key).encode()).decode() for key in forged]
        for cursor in ("%%%", "é", "x" * 601, "W" * 600, *cursors):
            refused = api.http.get(path.format(site=site), params={"cursor": cursor})
            assert refused.status_code == 422, (cursor, refused.text)

    def test_of_sites_are_walked_by_the_client(self, api: LiveApi) -> None:
        made = {api.site(cameras=1) for _ in range(4)}
        walked = [site["id"] for page in pages(api, "/v1/sites", limit=3) for site in page]
        assert made <= set(walked)
        assert len(walked) == len(set(walked))
        with WibamClient(api.url, TOKEN) as client:
            assert [site.id for site in client.sites()] == walked

    def test_of_files_at_hand_go_by_their_keys(self, api: LiveApi) -> None:
        site = api.site(cameras=2)
        for camera, name in (("cam2", "a.mp4"), ("cam1", "b.mp4"), ("cam1", "a.mp4")):
            api.upload(site, name.encode(), camera, filename=name, purpose="footage")
        path = f"/v1/sites/{site}/footage"
        found = [(file["camera"], file["filename"]) for page in pages(api, path, limit=1) for file in page]
        assert found == [("cam1", "a.mp4"), ("cam1", "b.mp4"), ("cam2", "a.mp4")]

    def test_a_page_behind_a_proxy_leads_on_through_it(self, api: LiveApi, jobs: list[str]) -> None:
        answer = api.http.get("/v1/jobs", params={"limit": 1}, headers={"X-Forwarded-Prefix": "/wibam"})
        assert answer.links["next"]["url"].startswith("/wibam/v1/jobs?limit=1&cursor=")


class TestDates:
    def test_from_counts_in_and_to_does_not(self, api: LiveApi, site: str, jobs: list[str]) -> None:
        created_at = api.services.jobs.job(jobs[2]).created_at
        # a moment before, which the others are not: times of jobs are finer than a microsecond
        just_before = datetime.fromtimestamp(created_at - 2e-6, UTC).isoformat(timespec="microseconds")
        later = names(api.http.get("/v1/jobs", params={"site": site, "from": just_before, "text": "job"}))
        earlier = names(api.http.get("/v1/jobs", params={"site": site, "to": just_before, "text": "job"}))
        assert set(later).isdisjoint(earlier)
        assert "job 2" in later
        assert earlier == ["job 1", "job 0"]

    @pytest.mark.parametrize("path", ["/v1/sites", "/v1/jobs", "/v1/models", "/v1/keys", "/v1/audit"])
    def test_every_list_knows_them(self, api: LiveApi, jobs: list[str], path: str) -> None:
        assert api.http.get(path, params={"from": "2100-01-01T00:00:00Z"}).json() == []
        assert api.http.get(path, params={"to": "1999-01-01T00:00:00Z"}).json() == []
        assert api.http.get(path, params={"from": "yesterday"}).status_code == 422
        assert api.http.get(path, params={"form": "2100-01-01T00:00:00Z"}).status_code == 422
