"""What the pages' scripts take to draw: the player's frames and the steps of dragging a label, at the 95th percentile.

    python -m benchmarks.pages

Headless Chromium runs the pages' own modules on made-up scenes: 60 tracked vehicles, or 30 labelled ones, from above
and in four views of distorted cameras. Counted is the script's own time, which
is what keeps a page from answering; the browser rasterises what was drawn elsewhere. Of several rounds the quietest is
printed, since whatever else the machine does adds to all; beside it the CPU time of the page's main thread, to which it
adds less, for machines that are never quiet.
"""

from __future__ import annotations

import argparse
import http.server
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import api.web

if TYPE_CHECKING:
    from playwright.sync_api import CDPSession

HERE = Path(__file__).parent
#: Script -> what it draws, how often a round, and how long one may take, ms.
CASES = {
    "pages_player.js": ("player, a frame of 60 vehicles from above and in four views", 100, 25.0),
    "pages_labelling.js": ("labelling, a step of a drag among 30 vehicles from above and in four views", 200, 16.0),
}


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@contextmanager
def served() -> Iterator[str]:
    """The pages' static files, at the addresses that their modules name."""
    handler = partial(_Quiet, directory=str(Path(api.web.__file__).parent))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


class Cost(NamedTuple):
    """What a step takes, ms: the 95th percentile by the clock, and the mean of the main thread's CPU time with all that
    the browser does there meanwhile."""

    p95_ms: float
    cpu_ms: float


def cost(chromium: str, script: str, times: int, rounds: int) -> Cost:
    """Each of the quietest round, after one to warm up."""
    from playwright.sync_api import sync_playwright

    code, found = (HERE / script).read_text(), []
    with served() as url, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-dev-shm-usage"])
        page = browser.new_page()
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable", {"timeDomain": "threadTicks"})
        page.goto(f"{url}/static/")
        page.add_style_tag(url="/static/css/tokens.css")
        for _ in range(1 + rounds):
            before = _task_ms(session)
            costs = page.evaluate(code, times)["costs"]
            found.append((float(np.percentile(costs, 95)), (_task_ms(session) - before) / times))
        browser.close()
    return Cost(*np.min(found[1:], axis=0).tolist())


def _task_ms(session: CDPSession) -> float:
    """CPU time that the page's main thread has taken until now."""
    metrics = session.send("Performance.getMetrics")["metrics"]
    return 1000 * next(float(one["value"]) for one in metrics if one["name"] == "TaskDuration")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("there is no chromium here; install it (Debian: apt-get install chromium)")
    slow = False
    for script, (what, times, most_ms) in CASES.items():
        found = cost(chromium, script, times, rounds)
        slow |= found.p95_ms > most_ms
        print(f"{what}: p95 {found.p95_ms:.1f} ms, at most {most_ms:g} ms wanted; {found.cpu_ms:.1f} ms of CPU (mean)")
    return int(slow)


if __name__ == "__main__":
    sys.exit(main())
