"""Association, fits and networks' boxes, instant by instant, by mouse and keys."""

from __future__ import annotations

import re

import numpy as np
import pytest
from PIL import Image

from tests.browser.conftest import Visit
from tests.labelled_job import TIMES_NS, labelled_job
from tests.service import LiveApi
from tests.site_dataset import tiny_rig


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return labelled_job(api)


def test_instants_and_vehicles_are_stepped_through(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/instants")
    page.get_by_text(re.compile(r"\d 2D boxes, 2 vehicles, 2 fits")).wait_for()
    assert page.locator("#views canvas").count() == len(tiny_rig())
    assert page.get_by_label("Vehicle").locator("option").count() == 3
    page.keyboard.press("]")
    page.locator("#said", has_text="Vehicle 0.").wait_for(state="attached")
    first = page.locator("#clock").inner_text()
    page.keyboard.press(".")
    page.wait_for_function("before => document.getElementById('clock').textContent !== before", arg=first)
    assert page.get_by_label("Instant", exact=True).input_value() == "1"
    for _ in range(len(TIMES_NS)):
        page.get_by_role("button", name="One instant forward").click()
    page.wait_for_function("last => document.getElementById('time').value === last", arg=str(len(TIMES_NS) - 1))


def test_what_is_shown_is_drawn_and_stands_in_the_table(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/instants")
    page.get_by_text(re.compile("2 vehicles, 2 fits")).wait_for()
    page.wait_for_load_state("networkidle")
    pictures = {}
    for what in ("association", "fits", "networks"):
        page.get_by_label("Show").select_option(what)
        page.wait_for_timeout(150)
        pictures[what] = page.evaluate(
            "[...document.querySelectorAll('#plan, #views canvas')].map((one) => one.toDataURL())"
        )
        if what == "fits":
            assert page.get_by_role("region", name="Numbers of this instant").locator("tbody tr").count() == 2
    for one, other in (("association", "fits"), ("fits", "networks")):
        assert all(a != b for a, b in zip(pictures[one], pictures[other], strict=True)), "in the plan and every view"
    assert page.get_by_label("Seen by").locator("option").all_inner_texts() == list(tiny_rig())
    page.get_by_label("Show").select_option("association")
    signed_in.picture("instants")
    with page.expect_download() as download:
        page.get_by_role("button", name="Save the plan and all views as PNG").click()
    assert download.value.suggested_filename == "instant-0-00.0-association.png"
    saved = Image.open(download.value.path())
    assert saved.size == (2000, 760), "the plan of 1000 px, and as much again for the views"
    beside = np.asarray(saved.convert("RGB"))[:, 1000:]
    assert beside[60, 250].tolist() != beside[700, 250].tolist(), "views above, nothing beneath them"
