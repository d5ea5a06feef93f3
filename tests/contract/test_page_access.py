"""How browsers are let in: sessions, links to one job, and nothing else."""

from __future__ import annotations

import re

import httpx
import pytest

from api.sessions import SESSION_COOKIE, Passes
from tests.finished import finished_job
from tests.service import TOKEN, LiveApi

OURS = {"X-Wibam-Page": "1"}


@pytest.fixture
def browser(api: LiveApi) -> httpx.Client:
    """Keeps cookies as a browser does; it has not signed in."""
    return httpx.Client(base_url=api.url, timeout=300)


@pytest.fixture
def signed_in(browser: httpx.Client) -> httpx.Client:
    assert browser.post("/session", json={"token": TOKEN}, headers=OURS).status_code == 204
    return browser


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


class TestSession:
    def test_pages_ask_for_the_token_first_and_remember_where_one_wanted_to_go(self, browser: httpx.Client) -> None:
        answer = browser.get("/jobs")
        assert (answer.status_code, answer.headers["location"]) == (303, "/sign-in?next=/jobs")

    def test_the_cookie_stands_in_for_the_token(self, signed_in: httpx.Client) -> None:
        assert signed_in.get("/jobs").status_code == 200
        assert signed_in.get("/v1/sites").status_code == 200

    def test_no_script_can_read_the_cookie_and_no_other_site_sends_it(self, browser: httpx.Client) -> None:
        set_cookie = browser.post("/session", json={"token": TOKEN}, headers=OURS).headers["set-cookie"].lower()
        assert "httponly" in set_cookie and "samesite=strict" in set_cookie
        assert TOKEN not in set_cookie

    def test_a_wrong_token_gives_none(self, browser: httpx.Client) -> None:
        answer = browser.post("/session", json={"token": "another"}, headers=OURS)
        assert (answer.status_code, answer.json()["code"]) == (401, "unauthorised")
        assert browser.get("/v1/sites").status_code == 401

    def test_a_change_from_elsewhere_is_refused_in_spite_of_the_cookie(self, signed_in: httpx.Client) -> None:
        answer = signed_in.post("/v1/sites", json={})
        assert (answer.status_code, answer.json()["code"]) == (403, "cross_site")
        assert signed_in.post("/v1/sites", json={}, headers=OURS).status_code == 422

    def test_signing_in_from_elsewhere_is_refused(self, browser: httpx.Client) -> None:
        assert browser.post("/session", json={"token": TOKEN}).status_code == 403

    def test_signing_out_ends_it(self, signed_in: httpx.Client) -> None:
        assert signed_in.delete("/session", headers=OURS).status_code == 204
        assert signed_in.get("/v1/sites").status_code == 401

    def test_a_pass_of_another_token_or_day_opens_nothing(self, api: LiveApi, browser: httpx.Client) -> None:
        digest = api.services.settings.token_sha256
        secret = f"{api.services.folder.secret()}:{digest}"
        late = Passes(secret, now=lambda: 1e9).session()
        for forged in (Passes("another").session(), Passes(digest).session(), late, "9999999999.", "x"):
            browser.cookies.set(SESSION_COOKIE, forged)
            assert browser.get("/v1/sites").status_code == 401


class TestSharedJob:
    def link(self, api: LiveApi, job: str) -> str:
        answer = api.http.post(f"/v1/jobs/{job}/share-link", json={"lifetime_h": 1})
        assert answer.status_code == 200
        return str(answer.json()["url"])

    def test_whoever_has_the_link_reads_that_job_and_nothing_else(
        self, api: LiveApi, browser: httpx.Client, job: str
    ) -> None:
        other = api.http.post(f"/v1/sites/{api.http.get('/v1/sites').json()[0]['id']}/jobs", json={}).json()["id"]
        answer = browser.get(self.link(api, job))
        assert (answer.status_code, answer.headers["location"]) == (303, f"/jobs/{job}")
        assert "data-read-only" in browser.get(f"/jobs/{job}").text
        assert browser.get(f"/v1/jobs/{job}").json()["id"] == job
        assert browser.get(f"/v1/jobs/{job}/conflicts").status_code == 200
        for path in ("/v1/jobs", "/v1/sites", f"/v1/jobs/{other}", f"/v1/jobs/{other}/conflicts"):
            assert browser.get(path).status_code == 401, path
        assert browser.get(f"/jobs/{other}").status_code == 303

    def test_and_changes_nothing(self, api: LiveApi, browser: httpx.Client, job: str) -> None:
        browser.get(self.link(api, job))
        assert browser.post(f"/v1/jobs/{job}/restart", json={}, headers=OURS).status_code == 401
        assert browser.delete(f"/v1/jobs/{job}", headers=OURS).status_code == 401
        assert browser.patch(f"/v1/jobs/{job}", json={"name": "mine"}, headers=OURS).status_code == 401

    def test_a_link_that_is_too_old_says_so(self, api: LiveApi, browser: httpx.Client, job: str) -> None:
        secret = f"{api.services.folder.secret()}:{api.services.settings.token_sha256}"
        old = Passes(secret, now=lambda: 1e9).share(job, 3600)
        answer = browser.get(f"/share/{job}?key={old}")
        assert answer.status_code == 401
        assert "no more" in answer.text

    def test_a_link_to_one_job_opens_no_other(self, api: LiveApi, browser: httpx.Client, job: str) -> None:
        key = self.link(api, job).partition("key=")[2]
        assert browser.get(f"/share/job_0000?key={key}").status_code == 401

    def test_there_is_none_to_a_job_that_is_not_there(self, api: LiveApi) -> None:
        assert api.http.post("/v1/jobs/job_0/share-link", json={}).status_code == 404


class TestPages:
    def test_nothing_from_elsewhere_and_no_script_inside(self, signed_in: httpx.Client, job: str) -> None:
        for path in ("/sign-in", "/jobs", f"/jobs/{job}"):
            answer = signed_in.get(path, follow_redirects=True)
            policy = answer.headers["content-security-policy"]
            assert "default-src 'none'" in policy and "script-src 'self'" in policy and "unsafe" not in policy
            assert "http://" not in answer.text and "https://" not in answer.text
            assert " style=" not in answer.text and "<style" not in answer.text

    def test_an_address_with_markup_in_it_shows_none(self, signed_in: httpx.Client) -> None:
        for path in ('/jobs/"><script>alert(1)<', "/jobs/<script>alert(1)</script>"):
            answer = signed_in.get(path)
            assert (answer.is_success, answer.headers["content-type"]) == (False, "application/problem+json")


class TestNames:
    def test_a_job_is_called_something_found_by_it_and_renamed(self, api: LiveApi) -> None:
        site = api.site(cameras=1)
        api.upload(site, b"x")
        made = api.http.post(f"/v1/sites/{site}/jobs", json={"name": "Monday, 100 % sure"}).json()
        assert made["name"] == "Monday, 100 % sure"
        found = api.http.get("/v1/jobs", params={"text": "100 %"}).json()
        assert [job["id"] for job in found] == [made["id"]]
        renamed = api.http.patch(f"/v1/jobs/{made['id']}", json={"name": "Tuesday"}).json()
        assert renamed["name"] == api.http.get(f"/v1/jobs/{made['id']}").json()["name"] == "Tuesday"
        assert api.http.get("/v1/jobs", params={"text": "Monday"}).json() == []
        assert api.http.patch(f"/v1/jobs/{made['id']}", json={"name": "a\nb"}).status_code == 422

    def test_pages_of_jobs_follow_each_other_and_states_filter(self, api: LiveApi) -> None:
        site = api.site(cameras=1)
        api.upload(site, b"y")
        made = [api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"] for _ in range(3)]
        first = api.http.get("/v1/jobs", params={"site": site, "limit": 2})
        rest = api.http.get(first.links["next"]["url"])
        assert [job["id"] for answer in (first, rest) for job in answer.json()] == made[::-1]
        assert "next" not in rest.links
        assert api.http.get("/v1/jobs", params={"site": site, "state": ["failed"]}).json() == []
        assert len(api.http.get("/v1/jobs", params={"site": site, "state": ["queued", "running"]}).json()) == 3


def test_no_page_has_a_script_or_a_style_of_its_own(signed_in: httpx.Client) -> None:
    for path in ("/sign-in", "/docs", "/jobs", "/sites", "/keys", "/compare"):
        answer = signed_in.get(path, follow_redirects=True)
        assert answer.status_code == 200, path
        assert "script-src 'self';" in answer.headers["content-security-policy"]
        assert not re.search(r"<script(?![^>]*\bsrc=)|<style|\son\w+=|\sstyle=", answer.text), path
