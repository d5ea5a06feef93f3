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
    page.evaluate("window.dispatchEvent(new Event('focus'))")
    page.get_by_text(AFTER).wait_for()


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
