"""The whole story by mouse and keyboard, on the real service: from two recordings to a reviewed table and a video.

What is clicked and typed is what a person would: the API is only asked what became of it.
"""

from __future__ import annotations

import csv
import io
import json
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image, ImageDraw

from tests.browser.conftest import Visit, serious_findings, visit
from wibam_core.calibration.rig import solve_camera
from wibam_core.cli.embedded import EmbeddedService
from wibam_core.client import WibamClient
from wibam_core.config import CalibrateConfig
from wibam_core.formats.labels import read_labels
from wibam_core.geometry.camera import Camera
from wibam_core.site import Site
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import record_site

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = [pytest.mark.end_to_end, pytest.mark.slow]

SIMULATION = SimulationOptions(
    cameras=2, seconds=20, fps=6, width_px=448, height_px=252, traffic_density=2, cycle_s=14, max_offset_s=0.5
)
#: Few images and few steps: what comes out is no good network, but all that a job makes.
OPTIONS = {
    "preflight": {"min_overlap_s": 10},
    "frames": {"rate_hz": 3},
    "detect": {"rate_hz": 3},
    "dataset": {"train_share": 0.5, "val_share": 0.2, "gap_s": 0.5},
    "finetune": {"input_width_px": 320},
    "safety": {
        "ttc_s": 30,
        "pet_s": 30,
        "min_probability": 0,
        "min_track_s": 0.5,
        "max_place_sd_m": 3,
        "max_overlap_iou": 0.5,
    },
    "report": {"examples": 1},
}
#: How long a job may take on a busy machine, ms.
PATIENCE_MS = 900_000


@pytest.fixture(scope="module")
def site_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "crossing"
    record_site(folder, SIMULATION)
    return folder


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmbeddedService]:
    with EmbeddedService(tmp_path_factory.mktemp("service") / "data") as running:
        yield running


def draw_map(folder: Path) -> tuple[Path, Path]:
    """Two roads that cross, 80 m wide at 10 cm a pixel, and its world file: the world's origin is in the middle."""
    picture = Image.new("RGB", (800, 800), (196, 207, 186))
    draw = ImageDraw.Draw(picture)
    for across in ((0, 310, 800, 490), (310, 0, 490, 800)):
        draw.rectangle(across, (150, 152, 156))
    picture.save(folder / "crossing.png")
    (folder / "crossing.pgw").write_text("0.1\n0\n0\n-0.1\n-39.95\n39.95\n")
    return folder / "crossing.png", folder / "crossing.pgw"


def look(tab: Visit, name: str, *, phone: bool = False) -> None:
    """Nothing serious for axe-core on a page with what a real job made, and pictures of it for a person to look at."""
    page = tab.page
    assert serious_findings(page) == []
    tab.picture(f"story-{name}")
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(200)  # canvases are drawn anew
    tab.picture(f"story-{name}-dark")
    page.emulate_media(color_scheme="light")
    if phone:
        page.set_viewport_size({"width": 390, "height": 800})
        page.wait_for_timeout(200)
        tab.picture(f"story-{name}-phone")
        page.set_viewport_size({"width": 1280, "height": 860})


def taken(page: Page, role: str, name: str | re.Pattern[str]) -> bytes:
    """What a click downloads."""
    with page.expect_download() as download:
        page.get_by_role(role, name=name).click()  # type: ignore[arg-type]
    return download.value.path().read_bytes()


def surveyed(camera: Camera) -> list[tuple[np.ndarray, np.ndarray]]:
    """Nine places on the road that a camera sees, with their pixels: whole metres, spread over the picture."""
    found = []
    for v in np.linspace(0.45, 0.95, 3) * camera.height_px:
        for u in np.linspace(0.1, 0.9, 3) * camera.width_px:
            ray = camera.rays(np.array([u, v]))
            ground = np.round(camera.centre_m - ray * camera.centre_m[2] / ray[2])
            pixel, depth = camera.project(np.array([ground[0], ground[1], 0.0]))
            if depth > 0 and depth < 80 and camera.contains(pixel):
                found.append((ground[:2], pixel))
    return found


def calibrate(page: Any, camera: Camera, signals: list[Any]) -> None:
    """Click points into the frame and type where they are; draw a region around each head."""
    page.get_by_text("0 of at least 4 points").wait_for()
    canvas = page.locator("#frame")
    scale = canvas.bounding_box()["width"] / camera.width_px
    for world, pixel in surveyed(camera):
        canvas.click(position={"x": (pixel[0] + 0.5) * scale, "y": (pixel[1] + 0.5) * scale})
        for value in world:
            page.keyboard.type(f"{value:g}")
            page.keyboard.press("Tab")
    page.locator("#solution dd").first.wait_for()
    page.get_by_label("draws a signal region").check()
    for number, signal in enumerate(signals):
        canvas.scroll_into_view_if_needed()  # the fields that were typed into may have moved the page
        place = canvas.bounding_box()
        x, y, width, height = signal.region
        page.mouse.move(place["x"] + x * scale, place["y"] + y * scale)
        page.mouse.down()
        page.mouse.move(place["x"] + (x + width) * scale, place["y"] + (y + height) * scale, steps=3)
        page.mouse.up()
        page.get_by_label(f"Id of region {number + 1}").fill(signal.id)
        page.keyboard.press("Tab")
    page.locator("#signals canvas.strip").nth(len(signals) - 1).wait_for()  # the states are seen at once
    page.get_by_role("button", name="Save").click()
    page.get_by_text("saved", exact=True).wait_for()


def test_from_recordings_to_a_reviewed_table_and_a_video(
    playwright_browser: Any, service: EmbeddedService, site_folder: Path, tmp_path: Path
) -> None:
    described = Site.load(site_folder / "site.json")
    rig = {one.id: solve_camera(one, CalibrateConfig()).camera for one in described.cameras}
    recordings = sorted((site_folder / "recordings").iterdir())
    with visit(playwright_browser, service.url, accept_downloads=True) as tab:
        page = tab.page
        page.goto(service.pages_url)
        page.wait_for_url(re.compile("/jobs$"))
        # a site, its recordings, its calibration and its signals
        page.get_by_role("link", name="Sites", exact=True).click()
        page.get_by_label("Name of the intersection").fill("Story")
        page.get_by_label("Cameras, the reference first").fill(", ".join(rig))
        page.keyboard.press("Enter")
        page.wait_for_url(re.compile("/sites/site_"))
        page.locator("input#files").set_input_files(recordings)
        page.locator("#queue li", has_text="done").nth(len(recordings) - 1).wait_for()
        page.get_by_text("448 × 252 px").nth(len(recordings) - 1).wait_for()
        for number, (camera, one) in enumerate(zip(described.cameras, rig.values(), strict=True)):
            page.get_by_role("link", name="Calibrate and signals").nth(number).click()
            page.get_by_role("heading", name=f"Camera {camera.id}").wait_for()
            calibrate(page, one, list(camera.signals))
            if number == 0:
                picture, world_file = draw_map(tmp_path)
                page.locator("#map-file").set_input_files(picture)
                page.get_by_text("crossing.png has no place yet").wait_for()
                page.locator("#world-file").set_input_files(world_file)
                page.get_by_text("crossing.png is placed by its world file").wait_for()
                look(tab, "camera")
            page.get_by_role("link", name="Story").click()
            page.get_by_role("heading", name="Story").wait_for()
        page.wait_for_load_state("networkidle")
        look(tab, "site")
        # a job
        page.get_by_label("Name", exact=True).fill("first")
        page.get_by_label("Training steps").fill("4")
        page.get_by_label("Tracks, per second").fill("3")
        page.locator("summary", has_text="Other options").click()
        page.locator("#options").fill(json.dumps(OPTIONS))
        page.get_by_role("button", name="Start").click()
        page.get_by_role("heading", name="first").wait_for()
        succeed(page)
        look(tab, "job", phone=True)
        # look at it
        tabs = page.get_by_role("navigation", name="This job")
        tabs.get_by_role("link", name="Preflight").click()
        page.get_by_text(re.compile("^All cameras record from")).wait_for()
        look(tab, "preflight", phone=True)
        tabs.get_by_role("link", name="Instants").click()
        page.get_by_text(re.compile(r"\d+ 2D boxes, \d+ vehicles")).wait_for()
        look(tab, "instants")
        # label an instant of the test part from the proposals, and evaluate with it
        tabs.get_by_role("link", name="Labelling").click()
        page.get_by_label("Your name").fill("anna")
        page.keyboard.press("Tab")
        page.get_by_text("not labelled yet").wait_for()
        page.get_by_role("button", name="Take the proposals").click()
        page.get_by_text("saved as version 1").wait_for()
        look(tab, "labelling")
        page.get_by_role("button", name="Finish").click()
        page.get_by_role("button", name="Finished").wait_for()
        page.get_by_text(re.compile("saved as version [23]")).wait_for()
        labels = {name: taken(page, "link", name) for name in ("labels.parquet", "COCO", "WIBAM layout")}
        (tmp_path / "labels.parquet").write_bytes(labels["labels.parquet"])
        [instant] = read_labels(tmp_path / "labels.parquet")
        shown = instant.visibility.values()
        coco = json.loads(labels["COCO"])
        assert len(coco["annotations"]) == sum(int((shares > 0).sum()) for shares in shown) > 0
        with zipfile.ZipFile(io.BytesIO(labels["WIBAM layout"])) as layout:
            assert any(json.loads(layout.read(name)) for name in layout.namelist() if "hand_labels/" in name)
        page.get_by_role("button", name="Evaluate with these labels").click()
        page.wait_for_url(re.compile("/jobs/job_[0-9a-f]+$"))
        succeed(page)
        tabs.get_by_role("link", name="Results").click()
        page.get_by_role("row", name=re.compile("^Recall")).wait_for()
        page.wait_for_load_state("networkidle")
        look(tab, "results", phone=True)
        # review a conflict, in the player and in the table, and export
        tabs.get_by_role("link", name="Conflicts").click()
        page.get_by_role("link", name=re.compile("open in the player")).first.click()
        page.get_by_role("heading", name="Chosen").wait_for()
        page.get_by_text(re.compile("^Conflict [0-9]+: ")).wait_for()
        page.wait_for_load_state("networkidle")
        look(tab, "player", phone=True)
        page.get_by_label("Clip from, s").fill("2")
        page.get_by_label("Clip to, s").fill("4")
        page.get_by_label("Width").select_option("960")
        page.get_by_role("button", name="Render").click()
        page.get_by_role("link", name=re.compile("^Download the clip")).wait_for()
        assert taken(page, "link", re.compile("^Download the clip"))[4:8] == b"ftyp"
        tabs.get_by_role("link", name="Conflicts").click()
        page.get_by_role("button", name=re.compile(r"^Conflict \d+: confirmed")).first.click()
        page.get_by_text(re.compile("1 reviewed")).wait_for()
        look(tab, "conflicts", phone=True)
        table = list(csv.DictReader(io.StringIO(taken(page, "link", "Reviewed table (CSV)").decode())))
        assert [row["verdict"] for row in table].count("confirmed") == 1
        assert taken(page, "link", "Reviewed table (PDF)").startswith(b"%PDF-")
        job_id = re.findall("job_[0-9a-f]+", page.url)[0]
        assert tab.complaints == []
    with WibamClient(service.url, service.token) as client:
        metrics = client.metrics(job_id)
        assert metrics.labelled_instants.given == 1
        assert client.files(client.job(job_id).site_id)


def succeed(page: Any) -> None:
    """Wait until the page says, without a reload, that the job has succeeded; say why where it has not."""
    ended = page.locator("#facts").locator(".state.succeeded, .state.failed, .state.cancelled")
    ended.wait_for(timeout=PATIENCE_MS)
    assert ended.inner_text() == "succeeded", page.locator("#failure").inner_text()
