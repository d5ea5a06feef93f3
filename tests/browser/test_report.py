"""The report in a real browser: it opens from a file, complains about nothing and asks the network for nothing."""

from __future__ import annotations

import json
import re

import cv2
import pytest

from tests.unit.report.scenes import report_data
from wibam_core.report.render import render

#: Runs in the page, in the test alone: the report itself has no script.
PROBE = """<script>
addEventListener("load", () => {
  const images = [...document.images];
  document.title = JSON.stringify({
    broken: images.filter((image) => !image.naturalWidth).map((image) => image.alt),
    images: images.length,
    overflow: document.documentElement.scrollWidth - document.documentElement.clientWidth,
    requests: performance.getEntriesByType("resource").map((entry) => entry.name.slice(0, 60))
      .filter((name) => !name.startsWith("data:")),
  });
});
</script></body>"""


@pytest.fixture(scope="module")
def page() -> str:
    return render(report_data())


def complaints(log: str) -> list[str]:
    """What the page wrote to the browser's console."""
    return [line for line in log.splitlines() if "CONSOLE" in line]


def test_report_opens_without_complaints(browse, page, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(page, encoding="utf-8")
    shot = tmp_path / "report.png"
    result = browse(path.as_uri(), "--window-size=1180,9000", f"--screenshot={shot}")
    assert complaints(result.stderr) == []
    image = cv2.imread(str(shot))
    assert image is not None and image.shape == (9000, 1180, 3) and image.std() > 10


def test_a_picture_from_elsewhere_would_be_refused_and_noticed(browse, page, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(page.replace("<main>", '<main><img src="http://127.0.0.1:9/x.png" alt="">'), encoding="utf-8")
    result = browse(path.as_uri(), f"--screenshot={tmp_path / 'shot.png'}")
    assert any("Content Security Policy" in line for line in complaints(result.stderr)), result.stderr


@pytest.mark.parametrize("width_px", [500, 1180])
def test_pictures_load_and_nothing_runs_out_of_the_page(browse, page, tmp_path, width_px):
    path = tmp_path / "probed.html"
    probed = page.replace("default-src 'none';", "default-src 'none'; script-src 'unsafe-inline';")
    path.write_text(probed.replace("</body>", PROBE), encoding="utf-8")
    result = browse(path.as_uri(), f"--window-size={width_px},2000", "--dump-dom")
    title = re.search(r"<title>(.*?)</title>", result.stdout, re.DOTALL)
    found = json.loads(title.group(1))
    assert found["broken"] == [] and found["images"] >= 17
    assert found["requests"] == []
    assert found["overflow"] <= 0


def test_report_prints(browse, page, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(page, encoding="utf-8")
    pdf = tmp_path / "report.pdf"
    browse(path.as_uri(), f"--print-to-pdf={pdf}", "--no-pdf-header-footer")
    assert pdf.read_bytes().startswith(b"%PDF") and pdf.stat().st_size > 100_000
