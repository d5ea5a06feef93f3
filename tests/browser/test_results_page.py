"""Results of a job as they are printed, and where a part of them cannot be loaded."""

from __future__ import annotations

import re

import pytest

from tests.browser.conftest import Visit
from tests.finished import finished_job
from tests.service import LiveApi

#: How far the trajectories lie beneath what is seen, px.
BENEATH = "document.getElementById('tracks').getBoundingClientRect().top - window.innerHeight"


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


def test_figures_that_nobody_has_scrolled_to_are_there_to_be_printed(signed_in: Visit, job: str) -> None:
    signed_in.page.set_viewport_size({"width": 1280, "height": 120})
    page = signed_in.open(f"/jobs/{job}/results")
    page.locator("#tracks path.line").wait_for(state="attached")
    assert page.evaluate(BENEATH) > 400
    assert page.evaluate("window.scrollY") == 0
    page.emulate_media(media="print")
    assert page.locator("#tracks svg.chart").is_visible()
    assert page.get_by_text("Loading …").count() == 0


def test_what_is_dark_on_the_screen_is_printed_dark_on_white(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/results")
    page.locator("#quality table").first.wait_for()
    ink = "getComputedStyle(document.querySelector('#quality td')).color"
    light = page.evaluate(ink)
    for _ in ("light", "dark"):
        page.get_by_role("button", name=re.compile("^Colours")).click()
    assert page.evaluate(ink) != light
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate(ink) == light
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


def test_a_figure_is_saved_as_numbers_as_drawing_and_as_picture(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/results")
    for name, begins in (
        ("save the numbers as CSV", b"track_id,"),
        ("save as SVG", b"<svg"),
        ("save as PNG", b"\x89PNG"),
    ):
        with page.expect_download() as download:
            page.get_by_role("button", name=f"Trajectories: {name}").click()
        assert download.value.path().read_bytes().startswith(begins), name


def test_a_figure_that_cannot_be_loaded_says_what_to_do(signed_in: Visit, job: str) -> None:
    signed_in.page.route("**/tracks/paths", lambda route: route.abort())
    page = signed_in.open(f"/jobs/{job}/results")
    page.locator("#tracks").get_by_text("This could not be loaded; reload the page to ask again.").wait_for()
    page.get_by_role("alert").get_by_text("The service does not answer.").wait_for()
    page.locator("#quality table").first.wait_for()  # all else is there
    page.unroute_all()
    page.reload()
    page.locator("#tracks path.line").wait_for(state="attached")
    signed_in.forgive("ERR_FAILED")
