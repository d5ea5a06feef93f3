"""A real service, started as `wibam serve` starts it, and a real job that is watched in the browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import visit
from tests.builders import corner_rig, site_of
from tests.recordings import write_recording
from wibam_core.cli.embedded import EmbeddedService
from wibam_core.client import WibamClient


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmbeddedService]:
    with EmbeddedService(tmp_path_factory.mktemp("service") / "data") as running:
        yield running


def test_a_job_is_watched_until_it_ends_and_its_failure_says_what_to_do(
    playwright_browser: Any, service: EmbeddedService, tmp_path: Path
) -> None:
    recording = write_recording(tmp_path / "noise.mp4", width_px=640, height_px=360, seconds=3.0)
    with WibamClient(service.url, service.token) as client:
        site = client.create_site(site_of(corner_rig(2)))
        for camera in ("cam1", "cam2"):
            client.upload_recording(site.id, camera, recording)
    with visit(playwright_browser, service.url) as tab:
        page = tab.page
        page.goto(service.pages_url)
        page.wait_for_url(re.compile("/jobs$"))
        page.goto(f"{service.url}/sites/{site.id}")
        page.get_by_label("Name", exact=True).fill("no lights")
        page.locator("summary", has_text="Other options").click()
        page.locator("#options").fill('{"preflight": {"min_overlap_s": 1}}')
        page.get_by_role("button", name="Start").click()
        page.get_by_role("heading", name="no lights").wait_for()
        # without a reload: the recordings are checked, and no light changes in noise
        page.locator("[data-stage=preflight] .state.succeeded").wait_for()
        page.locator("[data-stage=sync] .state.failed").wait_for()
        failure = page.locator("#failure .message")
        failure.wait_for()
        assert "sync · " in failure.inner_text() and "overlap" in failure.inner_text()
        page.get_by_text("[preflight] done").wait_for()
        page.get_by_role("button", name="Restart").click()
        page.get_by_text(re.compile(r"1\d of 1\d stages would run")).wait_for()
        assert tab.complaints == []
