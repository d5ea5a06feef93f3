"""A headless browser that reaches nothing but this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.service import TOKEN, LiveApi, live_api, settings_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

#: What Chromium and those made of it are called where they are installed.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
#: How long a browser or a page may take on a busy machine, ms.
PATIENCE_MS = 300_000
#: Where pictures of pages go, for a person to look at.
SCREENSHOTS = Path(__file__).resolve().parents[2] / "build" / "screenshots"


@pytest.fixture(scope="session")
def chromium() -> str:
    """The path of the browser. Where there must be one, since `WIBAM_NEEDS_BROWSER` says so, nothing is skipped."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        missing = "there is no chromium here; install it to look at pages (Debian: apt-get install chromium)"
        if os.environ.get("WIBAM_NEEDS_BROWSER"):
            pytest.fail(missing)
        pytest.skip(missing)
    return found


@pytest.fixture
def browse(chromium: str, tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run the browser once on an address with more options; its log is on standard error."""

    def run(address: str, *options: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [
                chromium,
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--disable-component-extensions-with-background-pages",
                "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
                "--no-first-run",
                "--hide-scrollbars",
                "--enable-logging=stderr",
                f"--user-data-dir={tmp_path / 'profile'}",
                *options,
                address,
            ],
            capture_output=True,
            text=True,
            timeout=600,
            check=True,
        )

    return run


@pytest.fixture(scope="module")
def playwright_browser(chromium: str) -> Iterator[Browser]:
    """One browser for the tests of a module: while it is open, its event loop is the thread's."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make setup")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-dev-shm-usage"], timeout=PATIENCE_MS
        )
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApi]:
    """A real API, without workers."""
    with live_api(settings_for(tmp_path_factory.mktemp("service"))) as running:
        yield running


@dataclass
class Visit:
    """A browser tab, and what it complained of.

    Attributes:
        page: the tab. url: of the service.
        complaints: errors in the console, of scripts, and requests to other hosts.
    """

    page: Page
    url: str
    complaints: list[str] = field(default_factory=list)

    def open(self, path: str) -> Page:
        """Go to a page of ours."""
        self.page.goto(self.url + path)
        return self.page

    def sign_in(self, token: str = TOKEN) -> None:
        """By the link that `wibam serve` prints."""
        self.page.goto(f"{self.url}/sign-in#token={token}")
        self.page.wait_for_url("**/jobs")

    def forgive(self, what: str) -> None:
        """Take back what the browser said of something that the test itself has brought about: at least once."""
        left = [one for one in self.complaints if what not in one]
        assert len(left) < len(self.complaints), f"nothing was said of {what!r}"
        self.complaints[:] = left

    def picture(self, name: str) -> None:
        """Keep a picture of the page."""
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)


@contextmanager
def visit(browser: Browser, url: str, **options: Any) -> Iterator[Visit]:
    """A tab of its own, with its own cookies."""
    with browser.new_context(viewport={"width": 1280, "height": 860}, **options) as context:
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        found = Visit(page, url)
        page.on("console", lambda m: found.complaints.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: found.complaints.append(str(error)))
        page.on(
            "request",
            lambda request: (
                None
                if request.url.startswith((url, "blob:", "data:"))
                else found.complaints.append(f"asked for {request.url}")
            ),
        )
        yield found


@pytest.fixture
def tab(playwright_browser: Browser, api: LiveApi) -> Iterator[Visit]:
    """A tab that has not signed in; it must not have complained at the end."""
    with visit(playwright_browser, api.url) as found:
        yield found
        assert found.complaints == []


@pytest.fixture
def signed_in(tab: Visit) -> Visit:
    """The same, signed in."""
    tab.sign_in()
    return tab


def drawn(page: Page, canvas: str) -> str:
    """What a canvas shows, as the address of a picture, once all that was to be drawn is drawn."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    shown: str = page.locator(canvas).evaluate("canvas => canvas.toDataURL()")
    return shown


def serious_findings(page: Page) -> list[str]:
    """What axe-core says of a page that is in the way of somebody who hears it, or uses keys alone."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed: make setup").Axe()
    return [
        f"{one['id']}: {node['target']} {node['html'][:120]} {node['failureSummary'][:200]}"
        for one in axe.run(page).response["violations"]
        if one["impact"] in ("serious", "critical")
        for node in one["nodes"]
    ]
