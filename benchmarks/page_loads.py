"""How long it takes until each page can be used, and what its first view asks for, from a service with a finished job.

    python -m benchmarks.page_loads http://127.0.0.1:8000 TOKEN JOB

Each page is opened in headless Chromium with an empty cache, a few times. It can be used once what one came for is
seen: the list, the figure, the plan, the first field. Printed are the bytes of the first view with their headers, but
for camera frames; they come as they are, since the service compresses nothing. Then the clock's time from the address
to then, of the quietest time; and the CPU time in it, to which other programs of the machine add little: of the page's
main thread, and of the service's process. Where none of both waits for a core, the clock's time is about their sum.
"""

from __future__ import annotations

import argparse
import re
import shutil
import sys
from typing import TYPE_CHECKING, Any, NamedTuple

import httpx

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext

#: Page -> its address, and what one came for. {job}, {site} and {camera} are filled in.
PAGES = {
    "sign in": ("/sign-in", "#token"),
    "jobs": ("/jobs", "#jobs tbody a"),
    "job": ("/jobs/{job}", ".graph .stage"),
    "preflight": ("/jobs/{job}/preflight", "#clocks svg"),
    "results": ("/jobs/{job}/results", "#quality table"),
    "instants": ("/jobs/{job}/instants", "#numbers table"),
    "player": ("/jobs/{job}/player", "#plan"),
    "conflicts": ("/jobs/{job}/conflicts", "#conflicts tbody a, #nothing .message"),
    "labelling": ("/jobs/{job}/labelling", "#views canvas"),
    "models": ("/models", "#models tbody tr"),
    "compare": ("/compare", "#compared table, #compared .message"),
    "keys": ("/keys", "#audit tbody tr"),
    "sites": ("/sites", "#sites tbody a"),
    "site": ("/sites/{site}", "#cameras .camera"),
    "camera": ("/sites/{site}/cameras/{camera}", "#solution :is(dd, p)"),
    "API": ("/docs", "#operations details"),
}
#: ms from the address to when an element is seen.
SEEN = """(selector) => new Promise((resolve) => {
  const isSeen = () => [...document.querySelectorAll(selector)].some((one) => one.checkVisibility());
  const look = () => (isSeen() ? resolve(performance.now()) : requestAnimationFrame(look));
  look();
})"""
WANTED_MS, WANTED_BYTES = 1000.0, 300_000


class Load(NamedTuple):
    """One opening: bytes of its first view, ms by the clock, ms of CPU in the page and in the service."""

    size_bytes: int
    clock_ms: float
    page_ms: float
    service_ms: float


def service_ms(http: httpx.Client) -> float:
    """CPU time that the API's process has taken until now."""
    [seconds] = re.findall(r"^process_cpu_seconds_total (\S+)$", http.get("/metrics").text, re.MULTILINE)
    return 1000 * float(seconds)


def opened(context: BrowserContext, http: httpx.Client, address: str, selector: str) -> Load:
    """Open a page in a tab of its own."""
    page = context.new_page()
    session = context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})  # CPU time of the main thread
    session.send("Network.enable")
    session.send("Network.setCacheDisabled", {"cacheDisabled": True})
    counted: set[str] = set()
    sizes: list[float] = []

    def begin(event: Any) -> None:
        if "/frame" not in event["response"]["url"] and event["type"] != "EventSource":
            counted.add(event["requestId"])

    def end(event: Any) -> None:
        if event["requestId"] in counted:
            sizes.append(event["encodedDataLength"])

    session.on("Network.responseReceived", begin)
    session.on("Network.loadingFinished", end)
    before = service_ms(http)
    page.goto(f"{http.base_url}{address}", wait_until="commit")
    clock_ms = float(page.evaluate(SEEN, selector))
    metrics = {one["name"]: one["value"] for one in session.send("Performance.getMetrics")["metrics"]}
    took = service_ms(http) - before
    page.wait_for_timeout(1500)  # what else the first view asks for
    page.close()
    return Load(round(sum(sizes)), clock_ms, 1000 * metrics["TaskDuration"], took)


def signed_in(browser: Browser, url: str, token: str) -> BrowserContext:
    """A browser that has shown the token."""
    context = browser.new_context(viewport={"width": 1280, "height": 860})
    page = context.new_page()
    page.goto(f"{url}/sign-in#token={token}")
    page.wait_for_url("**/jobs")
    page.close()
    return context


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("url", "token", "job"):
        parser.add_argument(name)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--pages", nargs="*", choices=PAGES, default=list(PAGES))
    given = parser.parse_args()
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("there is no chromium here; install it (Debian: apt-get install chromium)")
    from playwright.sync_api import sync_playwright

    http = httpx.Client(base_url=given.url, headers={"Authorization": f"Bearer {given.token}"}, timeout=300)
    job = http.get(f"/v1/jobs/{given.job}").json()
    site = http.get(f"/v1/sites/{job['site_id']}").json()
    places = {"job": given.job, "site": job["site_id"], "camera": site["cameras"][0]}
    bad = False
    print(f"{'page':<10} {'kB':>6} {'clock, ms':>10} {'page, ms':>9} {'service, ms':>12}")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-dev-shm-usage"])
        context = signed_in(browser, given.url, given.token)
        for name in given.pages:
            address, selector = PAGES[name]
            of = browser.new_context() if name == "sign in" else context
            loads = [opened(of, http, address.format(**places), selector) for _ in range(given.times)]
            size = max(one.size_bytes for one in loads)
            clock, page, service = (min(values) for values in list(zip(*loads, strict=True))[1:])
            print(f"{name:<10} {size / 1000:>6.0f} {clock:>10.0f} {page:>9.0f} {service:>12.0f}")
            bad |= clock > WANTED_MS or size > WANTED_BYTES
        browser.close()
    return int(bad)


if __name__ == "__main__":
    sys.exit(main())
