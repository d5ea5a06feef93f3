"""What goes wrong in front of the pages: a sentence and what to do, and nothing is lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.browser.conftest import Visit
from tests.labelled_job import TIMES_NS, labelled_job
from tests.service import LiveApi


def test_a_map_of_200_mb_is_refused_with_a_sentence(signed_in: Visit, api: LiveApi, tmp_path: Path) -> None:
    site = api.site()
    picture = tmp_path / "orthophoto.png"
    with picture.open("wb") as file:
        file.truncate(200_000_000)  # it takes no disk
    page = signed_in.open(f"/sites/{site}/cameras/cam1")
    page.get_by_role("heading", name="Camera cam1").wait_for()
    page.locator("#map-file").set_input_files(picture)
    page.get_by_role("alert").get_by_text("The picture has 200 MB; a map may have 100 MB").wait_for()
    page.get_by_role("alert").get_by_text("Cut out the intersection").wait_for()
    signed_in.forgive("status of 413")


@pytest.mark.parametrize(
    "page_name", ["", "/preflight", "/results", "/instants", "/player", "/conflicts", "/labelling"]
)
def test_a_job_that_is_not_there_is_said(signed_in: Visit, page_name: str) -> None:
    page = signed_in.open(f"/jobs/job_0123456789abcdef{page_name}")
    page.get_by_text("There is no job job_0123456789abcdef").first.wait_for()
    signed_in.forgive("status of 404")


def test_labelling_goes_on_when_the_recording_was_deleted(signed_in: Visit, api: LiveApi) -> None:
    job = labelled_job(api, b"soon to be deleted")
    page = signed_in.page
    page.evaluate("localStorage['wibam-author'] = 'anna'")
    signed_in.open(f"/jobs/{job}/labelling?time_ns={TIMES_NS[1]}")
    page.get_by_text("not labelled yet").wait_for()
    site = api.http.get(f"/v1/jobs/{job}").json()["site_id"]
    for file in api.http.get(f"/v1/sites/{site}/recordings").json():
        assert api.http.delete(f"/v1/sites/{site}/recordings/{file['id']}").status_code == 204
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    page.reload()
    page.locator("#present option").nth(1).wait_for(state="attached")  # the two that were kept
    [kept] = api.http.get(f"/v1/jobs/{job}/labels").json()["instants"]
    assert (kept["time_ns"], kept["vehicles"], kept["author"]) == (TIMES_NS[1], 2, "anna")
