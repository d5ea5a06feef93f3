"""Signing in, all jobs, and one job, by mouse and keyboard."""

from __future__ import annotations

import re
from typing import Any

import pytest

from tests.browser.conftest import Visit, visit
from tests.finished import finished_job
from tests.service import TOKEN, LiveApi
from wibam_core.stages.graph import STAGES, downstream


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    job_id = finished_job(api)
    api.services.jobs.change(job_id, name="first try")
    return job_id


def test_signing_in_leads_where_one_wanted_to_go(tab: Visit, job: str) -> None:
    page = tab.open(f"/jobs/{job}")
    page.get_by_label("API token").fill(f" {TOKEN} ")
    page.keyboard.press("Enter")
    page.wait_for_url(f"**/jobs/{job}")
    page.wait_for_load_state("networkidle")
    page.get_by_role("button", name="Sign out").click()
    page.wait_for_url("**/sign-in")


def test_a_wrong_token_is_said(tab: Visit) -> None:
    page = tab.open("/sign-in")
    page.get_by_label("API token").fill("wrong")
    page.get_by_role("button", name="Sign in").click()
    page.get_by_role("alert").get_by_text("This is not the token.").wait_for()
    tab.forgive("status of 401")


def test_an_address_of_another_site_is_not_gone_to(tab: Visit) -> None:
    page = tab.open(f"/sign-in?next=//example.org/sites#token={TOKEN}")
    page.wait_for_url(re.compile("jobs$"))
    assert page.url == f"{tab.url}/jobs"


def test_jobs_are_listed_and_filtered(signed_in: Visit, job: str) -> None:
    page = signed_in.page
    page.get_by_role("link", name="first try").wait_for()
    signed_in.picture("jobs")
    page.get_by_label("Name or id").fill("no such job")
    page.get_by_text("No job is like that").wait_for()
    page.get_by_label("Name or id").fill("FIRST")
    page.get_by_role("link", name="first try").click()
    page.wait_for_url(f"**/jobs/{job}")


def test_older_jobs_are_a_click_away(signed_in: Visit, api: LiveApi) -> None:
    """Three jobs, by pages of two in place of fifty."""
    site = api.site(cameras=1)
    api.upload(site, b"of several jobs")
    made = [api.http.post(f"/v1/sites/{site}/jobs", json={"name": name}).json() for name in ("one", "two", "three")]
    page = signed_in.page
    page.route("**/v1/jobs?*limit=50*", lambda route: route.continue_(url=route.request.url.replace("=50", "=2")))
    signed_in.open(f"/jobs?site={site}")
    names = page.locator("#jobs tbody th a")
    names.nth(1).wait_for()
    assert names.all_inner_texts() == ["three", "two"]
    more = page.get_by_role("button", name="Older jobs")
    more.click()
    names.nth(2).wait_for()
    assert names.all_inner_texts() == ["three", "two", "one"]
    assert not more.is_visible(), "there are no older ones"
    for job in made:
        api.http.post(f"/v1/jobs/{job['id']}/cancel")


def test_an_answer_that_comes_late_does_not_undo_a_later_filter(signed_in: Visit, job: str) -> None:
    page = signed_in.page
    page.get_by_role("link", name="first try").wait_for()
    held: list[Any] = []
    page.route(re.compile(r"text=FIRST"), lambda route: held.append(route))
    page.get_by_label("Name or id").fill("FIRST")
    while not held:
        page.wait_for_timeout(20)
    page.get_by_label("Name or id").fill("no such job")
    page.get_by_text("No job is like that").wait_for()
    with page.expect_response(re.compile(r"text=FIRST")):
        held[0].continue_()
    page.wait_for_timeout(200)
    assert page.get_by_text("No job is like that").is_visible()


def test_a_job_is_cancelled(signed_in: Visit, api: LiveApi) -> None:
    site = api.site(cameras=1)
    api.upload(site, b"to be cancelled")
    waiting = api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"]
    page = signed_in.open(f"/jobs/{waiting}")
    page.get_by_role("button", name="Cancel the job").click()
    page.locator("#facts .state.cancelled").wait_for()
    page.get_by_role("button", name="Restart").wait_for()
    assert api.http.get(f"/v1/jobs/{waiting}").json()["state"] == "cancelled"


def test_a_job_shows_stages_warnings_and_files(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}")
    page.locator(".graph .stage").first.wait_for()
    assert page.locator(".graph .stage").count() == len(STAGES)
    done = page.locator(".graph .stage .state.succeeded, .graph .stage .state.reused")  # another job shares its outputs
    assert done.count() == len(STAGES)
    page.locator("#warnings").get_by_text("The clock of cam3 is ambiguous").wait_for()
    page.locator("summary", has_text="Files").click()
    page.get_by_role("link", name="report.html").wait_for()
    signed_in.picture("job")


def test_a_restart_says_what_it_would_do_and_the_job_is_renamed(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}")
    page.get_by_role("button", name="Restart").click()
    page.get_by_text("Everything is there already").wait_for()
    page.get_by_label("From").select_option("track")
    page.get_by_text(f"{len(downstream('track'))} of {len(STAGES)} stages would run").wait_for()
    page.get_by_role("button", name="Leave it").click()
    page.get_by_role("button", name="Rename").click()
    page.get_by_label("Name of the job").fill("second name")
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="second name").wait_for()
    page.get_by_role("button", name="Rename").click()
    page.get_by_label("Name of the job").fill("first try")
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="first try").wait_for()


def test_whoever_gets_the_link_sees_the_job_and_no_button_that_changes_it(
    signed_in: Visit, playwright_browser: object, job: str
) -> None:
    page = signed_in.open(f"/jobs/{job}")
    page.get_by_role("button", name="Share").click()
    page.locator("#share-dialog[open]").wait_for()  # it opens once the link is made
    link = page.get_by_label("Link", exact=True).input_value()
    with visit(playwright_browser, signed_in.url) as guest:  # type: ignore[arg-type]
        guest.page.goto(link)
        guest.page.wait_for_url(re.compile(f"/jobs/{job}$"))
        guest.page.locator(".graph .stage").first.wait_for()
        assert guest.page.get_by_text("read only").is_visible()
        assert guest.page.get_by_role("button", name="Restart").count() == 0
        assert guest.page.get_by_role("link", name="Sites").count() == 0
        assert guest.complaints == []
