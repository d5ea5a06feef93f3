"""Ten minutes of dense traffic: no page asks for all of it, and any time of it is a step away."""

from __future__ import annotations

from typing import Any

import pytest

from tests.browser.conftest import Visit, visit
from tests.long_job import AT_ONCE, TRACKED_NS, long_job
from tests.service import LiveApi

LARGEST_BYTES = 300_000
#: Page of a job -> what one came for.
PAGES = {
    "": ".graph .stage",
    "/preflight": "#tabs a",
    "/results": "#tracks path.line",
    "/instants": "#numbers table",
    "/player": "#present option:nth-child(2)",
    "/conflicts": "#conflicts tbody a",
    "/labelling": "#instant option",
}
#: Who is shown, and how far the plan's trails go back, once the tracks of that time are there.
SHOWN = "document.querySelectorAll('#present option').length - 1"


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return long_job(api)


@pytest.fixture
def asked(signed_in: Visit) -> list[tuple[str, int]]:
    """What the tab asks for from now on, but for frames: address and bytes."""
    found: list[tuple[str, int]] = []

    def count(response: Any) -> None:
        if "/frame" not in response.url and response.request.resource_type != "eventsource":
            found.append((response.url, int(response.headers["content-length"])))

    signed_in.page.on("response", count)
    return found


@pytest.mark.parametrize("page_name", PAGES)
def test_the_first_view_is_as_small_as_of_a_short_job(
    signed_in: Visit, asked: list[tuple[str, int]], job: str, page_name: str
) -> None:
    page = signed_in.open(f"/jobs/{job}{page_name}")
    page.locator(PAGES[page_name]).first.wait_for(state="attached")
    page.wait_for_load_state("networkidle" if page_name else "load")
    size = sum(one for _, one in asked)
    largest = sorted(asked, key=lambda one: -one[1])[:4]
    assert 50_000 < size < LARGEST_BYTES, largest


def test_any_time_is_a_step_away(signed_in: Visit, asked: list[tuple[str, int]], job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player?time_ns={300 * 10**9}")
    page.wait_for_function(f"() => {SHOWN} === {AT_ONCE}")
    assert page.locator("#clock").inner_text() == "5:00.0"
    page.keyboard.press(".")
    page.wait_for_function("() => document.getElementById('clock').textContent === '5:00.2'")
    asked.clear()
    page.locator("#time").fill(str(100 * 10**9 // TRACKED_NS))
    page.wait_for_function(f"() => {SHOWN} === {AT_ONCE} && document.getElementById('waiting').textContent === ''")
    assert page.locator("#clock").inner_text() == "1:40.0"
    page.keyboard.press("]")  # of the conflicts every 4.8 s from 1.92 s on
    page.get_by_text("Conflict 21: crossing").wait_for()
    page.wait_for_load_state("networkidle")
    windows = [size for url, size in asked if "/tracks/compact" in url]
    assert 0 < len(windows) <= 6
    assert max(windows) < 60_000


def test_playing_goes_on_through_windows(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player?time_ns={60 * 10**9}")
    page.wait_for_function(f"() => {SHOWN} === {AT_ONCE}")
    page.locator("#speed").select_option("4")
    page.locator("body").press("Space")
    page.wait_for_function("() => document.getElementById('clock').textContent > '1:25'")
    page.keyboard.press("Space")
    page.wait_for_function(f"() => {SHOWN} === {AT_ONCE}")


def test_the_whole_job_is_counted_for_a_filter(signed_in: Visit, api: LiveApi, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player")
    page.locator("#from").fill("100")
    whole = api.http.get(f"/v1/jobs/{job}/tracks/summary").json()
    late = api.http.get(f"/v1/jobs/{job}/tracks/summary?start_ns={100 * 10**9}").json()
    page.get_by_text(f"{late['tracks']} of {whole['tracks']} road users, {late['states']} of").wait_for()


def test_a_service_that_is_away_for_a_while_is_waited_for(playwright_browser: Any, api: LiveApi, job: str) -> None:
    with visit(playwright_browser, api.url) as tab:
        tab.sign_in()
        page = tab.open(f"/jobs/{job}/player")
        page.wait_for_function(f"() => {SHOWN} > 0")
        page.route("**/tracks/compact*", lambda route: route.abort())
        page.locator("#time").fill("2000")
        page.get_by_role("alert").get_by_text("The service does not answer.").wait_for()
        page.get_by_text("Loading tracks …").wait_for()
        page.unroute("**/tracks/compact*")
        page.wait_for_function(f"() => {SHOWN} === {AT_ONCE}")
        assert page.get_by_role("alert").get_by_text("The service does not answer.").count() == 1, "said once"
