"""The player while its job is restarted, and makes other tracks: nothing is mixed with those before."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from tests.browser.conftest import Visit
from tests.finished import finished_job, track_anew, tracks
from tests.service import LiveApi
from wibam_core.scene import Track

#: The summary beneath the filter, of the tracks before and after: 2 of 50 states, and the first 30 of the second alone.
BEFORE, AFTER = "2 of 2 road users, 100 of 100 states", "1 of 1 road users, 30 of 30 states"
RATES = itertools.count(3)
COMES_BACK = "window.dispatchEvent(new Event('focus'))"
#: Keeps the timers of a page that wait for five seconds.
TIMERS = """
  const [begin, end] = [window.setTimeout, window.clearTimeout];
  window.timers = new Set();
  window.setTimeout = (work, wait) => {
    const id = begin(() => { timers.delete(id); work(); }, wait);
    if (wait === 5000) timers.add(id);
    return id;
  };
  window.clearTimeout = (id) => { timers.delete(id); end(id); };
"""


@pytest.fixture
def job(api: LiveApi, request: pytest.FixtureRequest) -> str:
    return finished_job(api, request.node.name.encode())


def other_tracks() -> list[Track]:
    [_, bus] = tracks()
    fields = {name: getattr(bus, name)[20:] for name in ("times_ns", "boxes", "sd", "velocities_mps")}
    return [replace(bus, track_id=9, yaw_rates_radps=bus.yaw_rates_radps[20:], **fields)]


def restart(api: LiveApi, job: str) -> None:
    body = {"options": {"track": {"rate_hz": float(next(RATES))}}}
    assert api.http.post(f"/v1/jobs/{job}/restart", json=body).status_code == 202


def test_tracks_that_were_made_anew_take_the_place_of_all_that_is_here(
    signed_in: Visit, api: LiveApi, job: str
) -> None:
    """Of the stretch from 4 s on nothing was asked before; the filter and the time stay."""
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_text(BEFORE).wait_for()
    page.get_by_role("checkbox", name="car").uncheck()
    page.get_by_text("1 of 2 road users").wait_for()
    restart(api, job)
    track_anew(api, job, other_tracks())
    page.get_by_role("slider", name="Instant").fill("45")
    page.get_by_text("The job has made other tracks since").wait_for()
    page.get_by_text("1 of 1 road users, 30 of 30 states").wait_for()
    page.locator("#present option", has_text="9: bus").wait_for(state="attached")
    assert page.locator("#present option").count() == 2
    assert page.locator("#clock").inner_text() == "0:04.5"
    assert page.get_by_role("checkbox", name="bus").is_checked()
    page.keyboard.press(",")
    page.wait_for_function("() => document.getElementById('clock').textContent === '0:04.4'")


def test_whoever_comes_back_to_the_page_sees_the_tracks_of_now(signed_in: Visit, api: LiveApi, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_text(BEFORE).wait_for()
    restart(api, job)
    track_anew(api, job, other_tracks())
    page.evaluate(COMES_BACK)
    page.get_by_text(AFTER).wait_for()


def test_a_restart_is_noticed_within_a_minute_and_clip_times_follow(signed_in: Visit, api: LiveApi, job: str) -> None:
    signed_in.page.clock.install()
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_text(BEFORE).wait_for()
    assert page.locator("#clip-from").input_value() == "0.0"
    restart(api, job)
    track_anew(api, job, other_tracks())
    page.clock.fast_forward(60_000)
    page.get_by_text(AFTER).wait_for()
    page.get_by_text("The job has made other tracks since").wait_for()
    assert page.locator("#clip-from").input_value() == "2.0"


def test_after_a_request_that_failed_the_player_asks_again(signed_in: Visit, api: LiveApi, job: str) -> None:
    summary = "**/tracks/summary"
    page = signed_in.page
    page.route(summary, lambda route: route.abort())
    signed_in.open(f"/jobs/{job}/player")
    page.get_by_text("The service does not answer").wait_for()
    page.unroute(summary)
    page.get_by_text(BEFORE).wait_for()  # by itself
    restart(api, job)
    track_anew(api, job, other_tracks())
    page.route(summary, lambda route: route.abort())
    with page.expect_event("requestfailed"):
        page.evaluate(COMES_BACK)
    page.unroute(summary)
    page.get_by_text(AFTER).wait_for()  # by itself
    page.get_by_text("The job has made other tracks since").wait_for()
    signed_in.forgive("ERR_FAILED")


def test_a_refusal_while_the_tracks_are_the_same_ends_nothing(signed_in: Visit, job: str) -> None:
    page = signed_in.page
    refusal = {"status": 409, "json": {"code": "not_ready", "detail": "the stage runs"}}
    page.route("**/tracks/compact*", lambda route: route.fulfill(**refusal), times=1)
    signed_in.open(f"/jobs/{job}/player")
    page.locator("#present option", has_text="2: bus").wait_for(state="attached")
    signed_in.forgive("status of 409")


def test_a_restart_that_tracks_nothing_says_so_alone(signed_in: Visit, api: LiveApi, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_text(BEFORE).wait_for()
    restart(api, job)
    track_anew(api, job, [])
    with page.expect_response("**/tracks/summary"):
        page.evaluate(COMES_BACK)
    page.wait_for_function("() => document.getElementById('nothing').textContent")
    page.evaluate("() => new Promise((done) => setTimeout(done))")
    assert page.locator("#nothing strong").inner_text() == "Nothing was tracked."
    assert page.locator("#player").is_hidden()


def test_a_job_without_tracks_is_looked_at_by_one_timer(signed_in: Visit, api: LiveApi) -> None:
    """However often somebody comes back, and after an answer that failed, too."""
    site = api.site(cameras=1)
    api.upload(site, b"looked at often")
    job = api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"]
    page, look = signed_in.page, "**/artifacts?artifact=tracks"
    page.add_init_script(TIMERS)
    signed_in.open(f"/jobs/{job}/player")
    page.get_by_text("There are no tracks yet").wait_for()
    for _ in range(3):
        with page.expect_response(look):
            page.evaluate(COMES_BACK)
        page.wait_for_function("() => timers.size === 1")
    page.route(look, lambda route: route.abort())
    page.evaluate(COMES_BACK)
    page.get_by_text("The service does not answer").wait_for()
    page.unroute(look)
    with page.expect_response(look):
        pass  # by itself
    signed_in.forgive("ERR_FAILED")


def test_while_a_job_tracks_again_that_is_said_and_then_shown(signed_in: Visit, api: LiveApi, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_text(BEFORE).wait_for()
    restart(api, job)
    page.get_by_role("slider", name="Instant").fill("45")
    page.get_by_text("There are no tracks yet").wait_for()
    assert page.locator("#player").is_hidden()
    track_anew(api, job, other_tracks())
    page.get_by_text(AFTER).wait_for()  # by itself
    signed_in.forgive("status of 409")
