"""A site by mouse and keyboard: cameras, recordings, points clicked into a frame, a signal region, a job."""

from __future__ import annotations

import re
import struct
from base64 import b64encode
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.browser.conftest import Visit, visit
from tests.builders import look_at
from tests.recordings import write_recording
from tests.service import LiveApi, live_api, settings_for
from tests.unit.formats.test_map_pictures import KEYS, SCALE, TIEPOINT, keys, write_tiff
from wibam_core.geometry.camera import Camera
from wibam_core.stages.graph import STAGES

#: Files as a browser gives them where they are dropped, of names and contents.
DROPPED = """(files) => {
  const all = new DataTransfer();
  for (const [name, data] of files) {
    const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
    all.items.add(new File([bytes], name, { type: "video/mp4" }));
  }
  return all;
}"""
WORLD = [(-8, -6, 0), (9, -5, 0), (7, 8, 0), (-6, 9, 0), (0, 1, 0), (3, -2, 0), (-4, 2, 0)]


@pytest.fixture(scope="module")
def camera() -> Camera:
    """What the clicks are computed from: 7 m above the road, principal point in the middle, no distortion."""
    return look_at((14.0, -18.0, 7.0), focal_px=500.0, width_px=640, height_px=360)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recordings")
    return [
        write_recording(folder / f"GOPRO_{name}_1.mp4", width_px=640, height_px=360, seconds=2.0)
        for name in ("south", "north")
    ]


def make_site(tab: Visit, name: str) -> str:
    page = tab.open("/sites")
    page.get_by_label("Name of the intersection").fill(name)
    page.get_by_label("Cameras, the reference first").fill("north, south")
    page.get_by_role("button", name="Create", exact=True).click()
    page.wait_for_url(re.compile("/sites/site_"))
    return page.url.rpartition("/")[2]


def test_recordings_go_to_the_cameras_that_their_names_say(
    signed_in: Visit, api: LiveApi, recordings: list[Path]
) -> None:
    site = make_site(signed_in, "two cameras")
    page = signed_in.page
    dropped = page.evaluate_handle(DROPPED, [[one.name, b64encode(one.read_bytes()).decode()] for one in recordings])
    page.dispatch_event("#drop", "dragover", {"dataTransfer": dropped})
    page.dispatch_event("#drop", "drop", {"dataTransfer": dropped})
    page.locator("#queue li", has_text="done").nth(1).wait_for()
    found = {item["camera"]: item["filename"] for item in api.http.get(f"/v1/sites/{site}/recordings").json()}
    assert found == {"north": "GOPRO_north_1.mp4", "south": "GOPRO_south_1.mp4"}
    page.get_by_text("640 × 360 px").nth(1).wait_for()  # the description follows the recordings
    page.wait_for_load_state("networkidle")
    signed_in.picture("site")


def test_chapters_are_one_recording(signed_in: Visit, api: LiveApi, tmp_path: Path) -> None:
    chapters = [write_recording(tmp_path / name, seconds=1.0) for name in ("GH010042.MP4", "GH020042.MP4", "other.MP4")]
    site = make_site(signed_in, "chapters")
    page = signed_in.page
    page.locator("input#files").set_input_files(chapters)
    page.locator("#queue li", has_text="done").nth(2).wait_for()
    page.locator(".camera", has_text="one recording of 2 chapters: GH010042.MP4, GH020042.MP4").wait_for()
    found = sorted((item["camera"], item["filename"]) for item in api.http.get(f"/v1/sites/{site}/recordings").json())
    assert found == [("north", "GH010042.MP4"), ("north", "GH020042.MP4"), ("south", "other.MP4")]
    page.get_by_role("link", name="Calibrate and signals").first.click()
    page.wait_for_function("() => { const end = document.getElementById('time')?.max; return 1.8 < end && end < 3; }")
    files = {item["filename"]: item["id"] for item in api.http.get(f"/v1/sites/{site}/recordings").json()}
    with page.expect_request(re.compile(files["GH020042.MP4"] + r"/frame\?time_s=0\.5")):
        page.locator("#time").fill("1.5")


def test_an_upload_goes_on_after_a_reload_and_a_restarted_service(
    playwright_browser: Any, recordings: list[Path], tmp_path: Path
) -> None:
    """Of a file of two pieces the first arrives. The page is loaded anew, then the service is started anew."""
    sent = tmp_path / "north.mp4"
    padding = 9_000_000  # of a box that players pass over
    sent.write_bytes(recordings[1].read_bytes() + struct.pack(">I4s", padding, b"free") + bytes(padding - 8))
    settings = settings_for(tmp_path / "service")
    pieces: list[str] = []

    def lose_all_but_the_first(route: Any, request: Any) -> None:
        if request.method == "PATCH":
            pieces.append(request.headers["upload-offset"])
        if request.method == "PATCH" and len(pieces) > 1:
            route.abort()
        else:
            route.continue_()

    with ExitStack() as service:
        api = service.enter_context(live_api(settings))
        port = int(api.url.rpartition(":")[2])
        with visit(playwright_browser, api.url) as tab:
            tab.sign_in()
            site = make_site(tab, "interrupted")
            page = tab.page
            page.route("**/v1/uploads/**", lose_all_but_the_first)
            page.locator("input#files").set_input_files(sent)
            page.locator("#queue li", has_text=re.compile(r"[1-9]\d? %")).wait_for()
            page.get_by_role("button", name="Pause").click()
            page.get_by_text("paused").wait_for()
            page.reload()
            page.locator("input#files").set_input_files(sent)
            page.locator("#queue li", has_text=re.compile(r"[1-9]\d? %")).wait_for()  # where the upload stood
            service.close()
            page.unroute_all()
            api = service.enter_context(live_api(settings, port=port))
            page.locator("#queue li", has_text="done").wait_for()  # the page tries again by itself
            [file] = api.http.get(f"/v1/sites/{site}/recordings").json()
            assert file["sha256"] == sha256(sent.read_bytes()).hexdigest()
            assert set(pieces) == {"0", "8000000"}, "nothing was sent twice"
            tab.forgive("ERR_")


def test_a_camera_is_calibrated_by_clicks_and_a_job_is_started(
    signed_in: Visit, api: LiveApi, recordings: list[Path], camera: Camera
) -> None:
    site = make_site(signed_in, "clicked")
    page = signed_in.page
    page.locator("input#files").set_input_files(recordings)
    page.get_by_text("640 × 360 px").nth(1).wait_for()
    page.get_by_role("link", name="Calibrate and signals").first.click()
    page.get_by_role("heading", name="Camera north").wait_for()
    page.get_by_text("0 of at least 4 points").wait_for()
    canvas = page.locator("#frame")
    box = canvas.bounding_box()
    assert box is not None
    pixels, _ = camera.project(np.array(WORLD, dtype=float))
    for (x, y, _), (u, v) in zip(WORLD, pixels, strict=True):
        scale = box["width"] / camera.width_px
        canvas.click(position={"x": (u + 0.5) * scale, "y": (v + 0.5) * scale})
        page.keyboard.type(str(x))
        page.keyboard.press("Tab")
        page.keyboard.type(str(y))
        page.keyboard.press("Tab")
    solution = page.locator("#solution")
    solution.get_by_text(re.compile(r"^[67]\.\d\d m$")).wait_for()
    height_m = float(solution.locator("dd").first.inner_text().removesuffix(" m"))
    assert height_m == pytest.approx(7.0, abs=0.15), "clicks are whole pixels of the screen"
    page.get_by_label("measures a length on the road").check()
    ends, _ = camera.project(np.array([[-5.0, 0.0, 0.0], [5.0, 0.0, 0.0]]))
    for u, v in ends:
        canvas.click(position={"x": (u + 0.5) * scale, "y": (v + 0.5) * scale})
    measured = page.locator("#frame-note").inner_text()
    assert float(re.findall(r"[\d.]+(?= m)", measured)[0]) == pytest.approx(10.0, abs=0.3)
    page.get_by_label("draws a signal region").check()
    page.mouse.move(box["x"] + 100, box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 130, box["y"] + 110, steps=4)
    page.mouse.up()
    page.get_by_text("No change was seen").wait_for()  # the recording is noise
    signed_in.picture("camera")
    page.get_by_role("button", name="Save").click()
    page.get_by_text("saved", exact=True).wait_for()
    kept = api.http.get(f"/v1/sites/{site}").json()["site"]["cameras"][0]
    assert len(kept["calibration"]["correspondences"]) == len(WORLD)
    assert len(kept["signals"]) == 1
    page.get_by_role("link", name="clicked").click()
    page.get_by_label("Training steps").fill("40")
    page.get_by_role("button", name="What would it do?").click()
    page.locator("#planned li").nth(len(STAGES) - 1).wait_for()
    page.get_by_role("button", name="Start").click()
    page.wait_for_url(re.compile("/jobs/job_"))
    job = api.http.get(f"/v1/jobs/{page.url.rpartition('/')[2]}").json()
    assert job["options"] == {"finetune": {"steps": 40}}


def test_points_are_set_by_keys_alone(signed_in: Visit, recordings: list[Path]) -> None:
    """In the frame a cross is moved, in the plan the plan beneath it; Enter clicks. The first press comes before any
    point is chosen, later arrow keys move the point."""
    make_site(signed_in, "keys")
    page = signed_in.page
    page.locator("input#files").set_input_files(recordings)
    page.get_by_text("640 × 360 px").nth(1).wait_for()
    page.get_by_role("link", name="Calibrate and signals").first.click()
    page.get_by_text("0 of at least 4 points").wait_for()

    def value(name: str) -> float:
        return float(page.get_by_label(f"{name} of point 1", exact=True).input_value())

    page.locator("#frame").focus()
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    assert (value("u"), value("v")) == pytest.approx((0.55 * 640 - 0.5, 0.505 * 360 - 0.5), abs=0.01)
    assert page.evaluate("document.activeElement.dataset.field") == "x", "whoever has clicked goes on typing"
    page.locator("#frame").focus()
    page.keyboard.press("ArrowLeft")
    assert value("u") == pytest.approx(0.55 * 640 - 1.0, abs=0.01), "the chosen point is moved"
    page.locator("#plan").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    x = value("x")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    assert value("x") > x > 0
    page.locator("#frame").focus()
    page.keyboard.press("Escape")
    page.keyboard.press("Enter")
    page.locator("#points tbody tr").nth(1).wait_for()


def test_points_that_give_no_camera_are_said_and_the_console_stays_silent(signed_in: Visit, camera: Camera) -> None:
    """Four on a line, as one meets them on the way; a fifth beside it helps. (`signed_in` looks at the console.)"""
    site = make_site(signed_in, "on a line")
    page = signed_in.page
    page.get_by_role("link", name="Calibrate and signals").first.click()
    page.get_by_text("0 of at least 4 points").wait_for()
    page.locator("summary", has_text="Paste points").click()
    world = np.array([[x, x, 0.0] for x in (-6, -2, 3, 8)])
    pixels = camera.project(world)[0] * 3 + 1  # the size that a camera without a recording has
    page.get_by_label(re.compile("^Lines of u, v")).fill(
        "\n".join(f"{u:.2f}, {v:.2f}, {x}, {y}, {z}" for (u, v), (x, y, z) in zip(pixels, world, strict=True))
    )
    page.get_by_role("button", name="Take these").click()
    page.locator("#solution .message.bad").wait_for()
    page.get_by_role("button", name="Save").click()
    page.get_by_text("saved", exact=True).wait_for()
    signed_in.open(f"/sites/{site}").get_by_text("cannot be solved").wait_for()


def test_a_lens_that_no_camera_has_is_refused_and_the_console_stays_silent(
    signed_in: Visit, api: LiveApi, camera: Camera
) -> None:
    """Numbers that no site can have are told of while they are typed, and are not saved; good ones go on."""
    site = make_site(signed_in, "impossible lens")
    page = signed_in.page
    page.get_by_role("link", name="Calibrate and signals").first.click()
    page.get_by_text("0 of at least 4 points").wait_for()
    (kind := page.get_by_label("What is known")).select_option("pnp")
    K = camera.K * 3
    for name, value in (("fx", K[0, 0]), ("fy", K[1, 1]), ("cx", K[0, 2] + 1), ("cy", K[1, 2] + 1)):
        page.get_by_label(name).fill(f"{value:.2f}")
    page.locator("summary", has_text="Paste points").click()
    pixels = camera.project(np.array(WORLD, dtype=float))[0] * 3 + 1  # the size that a camera without a recording has
    lines = [f"{u:.2f}, {v:.2f}, {x}, {y}, {z}" for (u, v), (x, y, z) in zip(pixels, WORLD, strict=True)]
    page.get_by_label(re.compile("^Lines of u, v")).fill("\n".join(lines))
    page.get_by_role("button", name="Take these").click()
    page.locator("#solution dl").wait_for()
    focal, distortion = page.get_by_label("fx"), page.get_by_label("Distortion, in OpenCV's order")
    good = focal.input_value()
    for field, typed, said, right in (
        (distortion, "0.1, bent", "The distortion has something that is no number", ""),
        (distortion, "0 " * 15, "The distortion has 15 numbers", ""),
        (distortion, "0.1 0.1 0.1", "finite coefficients, got 3", ""),
        (focal, "2e11", "200000000000 is too large for a calibration", good),
        (focal, "0", "focal", good),
    ):
        field.fill(typed)
        field.press("Tab")
        page.locator("#solution .message.bad", has_text=said).wait_for()
        if said.startswith("The distortion has 15"):
            page.get_by_role("button", name="Save").click()
            page.locator("#problems", has_text=said).wait_for()
        field.fill(right)
        field.press("Tab")
        page.locator("#solution dl").wait_for()
    kind.select_option("matrices")
    page.locator("#solution .message.bad", has_text="Ready matrices are given in the site's JSON").wait_for()
    kind.select_option("pnp")
    page.locator("#solution dl").wait_for()
    page.get_by_role("button", name="Save").click()
    page.get_by_text("saved", exact=True).wait_for()
    kept = api.http.get(f"/v1/sites/{site}").json()["site"]["cameras"][0]["calibration"]
    assert (kept["K"][0][0], kept["dist"]) == (float(good), [])


def test_what_a_region_shows_stays_when_another_is_drawn(signed_in: Visit, recordings: list[Path]) -> None:
    make_site(signed_in, "two heads")
    page = signed_in.page
    page.locator("input#files").set_input_files(recordings)
    page.get_by_text("640 × 360 px").nth(1).wait_for()
    page.get_by_role("link", name="Calibrate and signals").first.click()
    page.get_by_text("0 of at least 4 points").wait_for()
    page.get_by_label("draws a signal region").check()
    box = page.locator("#frame").bounding_box()
    assert box is not None
    shown = page.locator("#signals").get_by_text("No change was seen")  # the recording is noise
    for number, left in enumerate((100, 220)):
        page.mouse.move(box["x"] + left, box["y"] + 40)
        page.mouse.down()
        page.mouse.move(box["x"] + left + 30, box["y"] + 110, steps=4)
        page.mouse.up()
        shown.nth(number).wait_for()
    colours = "[...document.querySelectorAll('#signals .swatch')].map((one) => one.style.background)"
    one, other = page.evaluate(colours)
    assert one != other, "two phases"
    page.get_by_label("Id of region 2").fill("phase-a")
    page.keyboard.press("Tab")
    assert page.evaluate(colours) == [one, one], "the same phase"
    page.get_by_role("button", name="Add a region").click()
    assert shown.count() == 2
    page.get_by_role("button", name="Remove region 1").click()
    assert shown.count() == 1


def test_files_of_other_programs_are_read_into_the_page(signed_in: Visit, camera: Camera, tmp_path: Path) -> None:
    make_site(signed_in, "files")
    page = signed_in.page
    page.get_by_role("link", name="Calibrate and signals").first.click()
    page.get_by_role("heading", name="Camera north").wait_for()
    page.get_by_text("Files of other programs").click()
    chain = "cam0:\n  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [-0.1, 0.01, 0, 0]\n"
    chain += "  intrinsics: [700, 700, 959.5, 539.5]\n  resolution: [1920, 1080]\n"
    pixels, _ = camera.project(np.array(WORLD, dtype=float))
    rows = [f"{x},{y},{3 * u + 1},{-(3 * v + 1)},1" for (x, y, _), (u, v) in zip(WORLD, pixels, strict=True)]
    (tmp_path / "chain.yaml").write_text(chain)
    (tmp_path / "north.points").write_text("\n".join(["mapX,mapY,pixelX,pixelY,enable", *rows]) + "\n")
    page.locator("#calibration-files").set_input_files([tmp_path / "chain.yaml", tmp_path / "north.points"])
    page.locator("#read-notes").get_by_text("chain.yaml: Kalibr camchain; north.points: QGIS").wait_for()
    assert page.locator("#kind").input_value() == "pnp"
    assert page.locator("#points tbody tr").count() == len(WORLD)
    page.get_by_role("button", name="Save").click()
    page.get_by_text("saved", exact=True).wait_for()
    (tmp_path / "notes.txt").write_text("6 m high")
    page.locator("#calibration-files").set_input_files(tmp_path / "notes.txt")
    page.get_by_text("notes.txt is of no known calibration format").wait_for()
    signed_in.forgive("status of 422")


def test_a_wrong_point_is_marked_and_bad_numbers_are_named(signed_in: Visit, camera: Camera) -> None:
    make_site(signed_in, "pasted")
    page = signed_in.page
    page.get_by_role("link", name="Calibrate and signals").first.click()
    page.get_by_text("0 of at least 4 points").wait_for()
    page.locator("summary", has_text="Paste points").click()
    pixels, _ = camera.project(np.array(WORLD, dtype=float))
    pixels = pixels * 3 + 1  # the size that a camera without a recording has
    pixels[4] += (90, -60)
    lines = [f"{u:.2f}, {v:.2f}, {x}, {y}, {z}" for (u, v), (x, y, z) in zip(pixels, WORLD, strict=True)]
    page.get_by_label(re.compile("^Lines of u, v")).fill("\n".join(["u,v,x,y,z", *lines]))
    page.get_by_role("button", name="Take these").click()
    page.locator("#points tr.outlier").wait_for()
    assert page.locator("#points tr.outlier th").inner_text() == "5"
    page.get_by_label(re.compile("^Lines of u, v")).fill("1, 2, 3, 4, 5\n1, 2, east")
    page.get_by_role("button", name="Take these").click()
    page.get_by_text("Line 2 has something that is no number").wait_for()


def test_a_map_is_placed_by_two_points_and_stays_beneath_the_plan(
    signed_in: Visit, api: LiveApi, tmp_path: Path
) -> None:
    site = api.site()
    Image.new("RGB", (300, 200), (200, 30, 30)).save(tmp_path / "from above.png")
    page = signed_in.open(f"/sites/{site}/cameras/cam1")
    page.locator("#map-file").set_input_files(tmp_path / "from above.png")
    page.get_by_text("from above.png has no place yet").wait_for()
    page.get_by_role("button", name="Place it by two points").click()
    plan = page.locator("#plan")
    for x in (300, 500):
        plan.click(position={"x": x, "y": 200})
    page.get_by_label("Distance in m").fill("20")
    page.keyboard.press("Enter")
    page.get_by_text("from above.png is placed by two points").wait_for()
    placing = np.array(api.http.get(f"/v1/sites/{site}").json()["map"]["map"]["placing"])
    assert placing[0, 1] == pytest.approx(0, abs=1e-9) and placing[1, 1] == pytest.approx(-placing[0, 0])
    page.reload()
    page.get_by_text("from above.png is placed by two points").wait_for()
    middle = "at => [...document.getElementById('plan').getContext('2d').getImageData(...at, 1, 1).data]"
    page.wait_for_function(f"at => ({middle})(at)[0] > 150", arg=[450, 260])
    page.get_by_role("button", name="Take the map away").click()
    page.get_by_text("The map is gone").wait_for()


def test_a_map_that_another_origin_laid_on_earth_is_said_to_have_no_place(
    signed_in: Visit, api: LiveApi, tmp_path: Path
) -> None:
    site = api.site()
    described = api.http.get(f"/v1/sites/{site}").json()["site"]
    origin = {"latitude_deg": 48.753, "longitude_deg": 9.0}
    api.http.put(f"/v1/sites/{site}", json={**described, "origin": origin})
    tags = {SCALE: (0.5, 0.5, 0.0), TIEPOINT: (0.0, 0.0, 0.0, 5e5, 5.4e6, 0.0), KEYS: keys((3072, 32632))}
    data = write_tiff(tmp_path / "o.tif", tags).read_bytes()
    begun = api.begin(site, len(data), "", purpose="map", filename="o.tif").headers["Location"]
    api.send(begun, 0, data)
    assert api.http.put(f"/v1/sites/{site}/map", json={"file": begun.rpartition("/")[2]}).status_code == 200
    api.http.put(f"/v1/sites/{site}", json={**described, "origin": {**origin, "x_axis_bearing_deg": 0.0}})
    for path in (f"/sites/{site}", f"/sites/{site}/cameras/cam1"):
        signed_in.open(path).get_by_text("o.tif has no place here").wait_for()
