"""What holds for every page: nothing serious for axe-core in light and dark, not large, usable by keys."""

from __future__ import annotations

from typing import Any

import pytest

from tests.browser.conftest import Visit, serious_findings, visit
from tests.compared_jobs import made_job, tiny_site_with_recordings
from tests.finished import finished_job
from tests.labelled_job import TIMES_NS, labelled_job
from tests.service import LiveApi

PAGES = {
    "sign-in": lambda site, job: "/sign-in",
    "docs": lambda site, job: "/docs",
    "jobs": lambda site, job: "/jobs",
    "job": lambda site, job: f"/jobs/{job}",
    "preflight": lambda site, job: f"/jobs/{job}/preflight",
    "instants": lambda site, job: f"/jobs/{job}/instants",
    "results": lambda site, job: f"/jobs/{job}/results",
    "player": lambda site, job: f"/jobs/{job}/player",
    "conflicts": lambda site, job: f"/jobs/{job}/conflicts",
    "labelling": lambda site, job: f"/jobs/{job}/labelling",
    "expired": lambda site, job: f"/share/{job}?key=1.old",
    "models": lambda site, job: "/models",
    "compare": lambda site, job: "/compare",
    "keys": lambda site, job: "/keys",
    "sites": lambda site, job: "/sites",
    "site": lambda site, job: f"/sites/{site}",
    "camera": lambda site, job: f"/sites/{site}/cameras/cam1",
}
#: Of those that show nothing of what is stored, nobody need sign in.
OPEN = ("sign-in", "expired")
LARGEST_BYTES = 300_000
#: What pages that are looked at on a phone show once they have loaded what they are about.
ON_A_PHONE = {
    "results": "#downloads a",
    "conflicts": "[aria-label^='Conflict 0']",
    "jobs": "#jobs a",
    "job": ".graph .stage",
    "preflight": "#recordings *",
    "instants": "#views canvas",
    "player": "#views canvas",
    "compare": "#a option",
}
#: By how many px a page is wider than what is seen of it.
BEYOND = "document.documentElement.scrollWidth - document.documentElement.clientWidth"

#: Scripts that a page has asked for, and those that its head names.
RUN = "performance.getEntriesByType('resource').map((one) => one.name).filter((name) => name.endsWith('.js'))"
NAMED = "[...document.querySelectorAll('script[src], link[rel=modulepreload]')].map((one) => one.src ?? one.href)"


@pytest.fixture(scope="module")
def ids(api: LiveApi) -> tuple[str, str]:
    """A site, and a finished job of another; there are two such jobs."""
    finished_job(api, b"another recording")
    return api.site(), finished_job(api)


@pytest.fixture(scope="module")
def frames_job(api: LiveApi) -> str:
    """A finished job with frames, and with what is labelled from."""
    return labelled_job(api, b"of every page")


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_small_silent_and_without_barriers(
    playwright_browser: Any, api: LiveApi, ids: tuple[str, str], frames_job: str, name: str
) -> None:
    """Its first view, by the bytes of all that it asks for but camera frames, as they are, since nothing is sent
    compressed; then what axe-core finds in light and in dark, and whether it fits on the smallest screen."""
    with visit(playwright_browser, api.url) as tab:
        sizes: list[int] = []

        def count(response: Any) -> None:
            if "/frame" not in response.url and response.request.resource_type != "eventsource":
                assert response.header_value("content-encoding") is None
                sizes.append(len(response.body()))

        if name not in OPEN:
            tab.sign_in()
        tab.page.on("requestfinished", lambda request: count(request.response()))
        site, job = ids
        tab.open(PAGES[name](site, frames_job if name in ("labelling", "instants") else job))
        tab.page.wait_for_load_state("networkidle" if name != "job" else "load")
        if name == "job":
            tab.page.locator(".graph .stage").first.wait_for()
        assert 1000 < sum(sizes) < LARGEST_BYTES
        assert set(tab.page.evaluate(RUN)) == set(tab.page.evaluate(NAMED)), "scripts are asked for at once"
        if name == "expired":
            tab.forgive("status of 401")  # which is what the address answers
        for scheme in ("light", "dark"):
            tab.page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
            assert serious_findings(tab.page) == [], scheme
            tab.picture(f"page-{name}-{scheme}")
        assert tab.page.evaluate(BEYOND) <= 0, "1280 px are wide enough"
        assert tab.complaints == []


def test_a_phone_shows_results_without_scrolling_sideways(
    playwright_browser: Any, api: LiveApi, ids: tuple[str, str], frames_job: str
) -> None:
    with visit(playwright_browser, api.url) as tab:
        tab.page.set_viewport_size({"width": 390, "height": 800})
        tab.sign_in()
        for name, content in ON_A_PHONE.items():
            tab.open(PAGES[name](ids[0], frames_job if name == "instants" else ids[1]))
            tab.page.locator(content).first.wait_for(state="attached")
            tab.page.wait_for_load_state("networkidle" if name != "job" else "load")
            assert tab.page.evaluate(BEYOND) <= 0, name


def test_keys_alone_lead_to_the_content_and_into_a_job(signed_in: Visit, ids: tuple[str, str]) -> None:
    page = signed_in.page
    page.locator("#jobs a").first.wait_for()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    page.keyboard.press("Enter")
    for _ in range(12):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.closest('#jobs') !== null && document.activeElement.tagName === 'A'"):
            break
    page.keyboard.press("Enter")
    page.wait_for_url("**/jobs/job_*")


def test_conflicts_are_reviewed_and_open_the_player(signed_in: Visit, api: LiveApi, ids: tuple[str, str]) -> None:
    job = ids[1]
    page = signed_in.open(f"/jobs/{job}/conflicts")
    page.get_by_role("button", name="Conflict 0: confirmed").click()
    page.get_by_text("1 of 1 conflicts; 1 reviewed.").wait_for()
    page.get_by_label("Note on conflict 0").fill("seen twice")
    with page.expect_response(lambda response: response.request.method == "PUT"):
        page.keyboard.press("Enter")
    page.locator("#verdict").select_option("rejected")
    page.get_by_text("No conflict is like that").wait_for()
    page.locator("#verdict").select_option("confirmed")
    [review] = api.http.get(f"/v1/jobs/{job}/conflicts/reviews").json()
    assert (review["verdict"], review["note"]) == ("confirmed", "seen twice")


def test_conflicts_are_taken_as_csv_pdf_and_png(signed_in: Visit, ids: tuple[str, str]) -> None:
    page = signed_in.open(f"/jobs/{ids[1]}/conflicts")
    for role, name, begins in (
        ("link", "Reviewed table (CSV)", b"conflict_id,"),
        ("link", "Reviewed table (PDF)", b"%PDF-"),
        ("button", "Where they are: save the numbers as CSV", b"conflict_id,type,x_m,y_m\r\n0,crossing,20"),
        ("button", "Where they are: save as PNG", b"\x89PNG"),
    ):
        with page.expect_download() as download:
            page.get_by_role(role, name=name).click()  # type: ignore[arg-type]
        assert download.value.path().read_bytes().startswith(begins), name


def test_two_jobs_stand_side_by_side(signed_in: Visit, api: LiveApi, ids: tuple[str, str]) -> None:
    one = ids[1]
    site = api.http.get(f"/v1/jobs/{one}").json()["site_id"]
    other = api.http.post(f"/v1/sites/{site}/jobs", json={"name": "longer", "options": {"finetune": {"steps": 77}}})
    page = signed_in.open(f"/compare?a={one}&b={other.json()['id']}")
    row = page.locator("tr", has=page.get_by_role("rowheader", name="finetune.steps"))
    default = api.http.get("/v1/options").json()["defaults"]["finetune"]["steps"]
    row.wait_for()
    assert row.locator("td").all_inner_texts() == [str(default), "77"]
    page.get_by_role("heading", name="B: longer").wait_for()
    signed_in.picture("compare")


def test_two_networks_are_judged_on_the_same_instants(signed_in: Visit, api: LiveApi) -> None:
    site = tiny_site_with_recordings(api)
    rough, fine = (made_job(api, site, error_m, TIMES_NS[1:], steps) for error_m, steps in ((0.8, 21), (0.1, 22)))
    page = signed_in.open(f"/compare?a={rough['job_id']}&b={fine['job_id']}")
    page.get_by_text("3 instants from 0.4 to 1.2 s, of which neither network learned").wait_for()
    row = page.locator("#same tr", has=page.get_by_role("rowheader", name="IoU in other views"))
    difference = row.locator("td").last.inner_text()
    assert difference.startswith("+0.") and difference.endswith("(2 vehicles: too few)")


def test_the_api_is_documented_for_whoever_has_no_token(tab: Visit, api: LiveApi) -> None:
    page = tab.open("/docs")
    page.get_by_role("heading", name="schemas").wait_for()
    shown = page.locator("summary").all_inner_texts()
    for path, operations in api.http.get("/openapi.json").json()["paths"].items():
        for method, operation in operations.items():
            assert f"{method.upper()} {path} {operation['summary']}" in shown
    page.locator("summary", has_text="GET /healthz").click()
