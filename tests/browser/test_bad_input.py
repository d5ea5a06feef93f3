"""What goes wrong in front of the pages: a sentence and what to do, and nothing is lost."""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path
from typing import Any

import pytest

from api.sessions import Passes
from tests.browser.conftest import Visit, visit
from tests.finished import finished_job
from tests.foreign_recordings import write
from tests.labelled_job import TIMES_NS, labelled_job
from tests.service import LiveApi

#: Whether the browser plays a video, given as base64.
PLAYS = """(data) => new Promise((resolve) => {
  const video = document.createElement("video");
  video.addEventListener("loadeddata", () => resolve(true));
  video.addEventListener("error", () => resolve(false));
  video.src = URL.createObjectURL(new Blob([Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0))]));
})"""
#: Whether the left border of the frame on the page of a camera is as bright as recorded pictures are there.
LEFT_IS_BRIGHT = """() => {
  const canvas = document.getElementById("frame"), copy = document.createElement("canvas").getContext("2d", {
    willReadFrequently: true,  // or else the browser complains
  });
  copy.drawImage(canvas, 4, canvas.height / 2, 1, 1, 0, 0, 1, 1);
  return copy.getImageData(0, 0, 1, 1).data[1] > 150;
}"""
#: What a page is told that asks for its job again.
LOOKS_AGAIN = """async (job) => {
  const { get } = await import("/static/js/api.js");
  try { return await get(`/v1/jobs/${job}`); } catch (error) { return [error.message, error.hint]; }
}"""


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


def test_a_video_that_no_browser_plays_is_looked_at_all_the_same(
    signed_in: Visit, api: LiveApi, tmp_path: Path
) -> None:
    """Frames come from the service as JPEG."""
    site = api.site(cameras=1)
    recording = write(tmp_path / "x.avi", codec="mpeg4")
    page = signed_in.open(f"/sites/{site}")
    page.get_by_text("no recording yet").wait_for()
    assert page.evaluate(PLAYS, b64encode(recording.read_bytes()).decode()) is False
    page.locator("input#files").set_input_files(recording)
    page.locator("#queue li", has_text="done").wait_for()
    page.wait_for_function("() => document.querySelector('.camera img')?.naturalWidth > 0")
    page.get_by_role("link", name="Calibrate and signals").click()
    page.wait_for_function("() => { const end = document.getElementById('time')?.max; return 1.5 < end && end < 3; }")
    page.locator("#time").fill("1")
    page.wait_for_function(LEFT_IS_BRIGHT)


def test_a_link_that_ends_while_one_looks_says_whom_to_ask(playwright_browser: Any, api: LiveApi) -> None:
    job = finished_job(api)
    secret = f"{api.services.folder.secret()}:{api.services.settings.token_sha256}"
    with visit(playwright_browser, api.url) as guest:
        guest.open(f"/share/{job}?key={Passes(secret).share(job, 3600)}")
        guest.page.wait_for_url(f"**/jobs/{job}")
        guest.page.locator(".graph .stage").first.wait_for()
        guest.open(f"/jobs/{job}/conflicts").get_by_text("1 of 1 conflicts").wait_for()
        [cookie] = guest.page.context.cookies()
        guest.page.context.add_cookies([{**cookie, "value": Passes(secret).share(job, -1)}])  # type: ignore[list-item, typeddict-item]
        answer = guest.page.evaluate(LOOKS_AGAIN, job)
        assert answer == [
            "the link to this job works no more",
            "Links end after some time: ask whoever sent it for a new one. What stands here stays.",
        ]
        guest.page.reload()
        guest.page.get_by_label("API token").wait_for()
        guest.open(f"/share/{job}?key={Passes(secret).share(job, -1)}")
        guest.page.get_by_role("heading", name="This link works no more").wait_for()
        guest.page.get_by_text("Ask whoever sent it for a new one").wait_for()
        guest.forgive("status of 401")
        assert guest.complaints == []


def test_a_link_to_one_job_shows_no_other(playwright_browser: Any, api: LiveApi) -> None:
    job, other = finished_job(api), finished_job(api, b"of somebody else")
    link = api.http.post(f"/v1/jobs/{job}/share-link", json={}).json()["url"]
    with visit(playwright_browser, api.url) as guest:
        guest.open(link).wait_for_url(f"**/jobs/{job}")
        guest.page.locator(".graph .stage").first.wait_for()
        for page_name in ("", "/results", "/player", "/labelling"):
            guest.open(f"/jobs/{other}{page_name}")
            guest.page.wait_for_url(f"**/sign-in?next=/jobs/{other}{page_name}")
            guest.page.get_by_label("API token").wait_for()
        assert guest.complaints == []


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
