"""What the page of a camera waits for, and what others change while it is open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import Visit
from tests.recordings import write_recording
from tests.service import LiveApi
from tests.unit.formats.test_map_pictures import KEYS, SCALE, TIEPOINT, keys, write_tiff

HEADERS = "**/recordings/*/header"
#: The slider ends with the recording, and no longer at a minute.
LENGTH_IS_KNOWN = "() => Number(document.getElementById('time')?.max ?? 60) < 3"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("recording") / "north.mp4"
    return write_recording(path, width_px=640, height_px=360, seconds=2.0).read_bytes()


@pytest.fixture
def new_site(api: LiveApi, recording: bytes) -> str:
    """Two cameras without points, whose sizes follow their recordings; the first has one."""
    points = {"kind": "homography", "correspondences": []}
    cameras = [{"id": one, "width_px": 1920, "height_px": 1080, "calibration": points} for one in ("north", "south")]
    site = str(api.http.post("/v1/sites", json={"name": "new", "cameras": cameras}).json()["id"])
    api.upload(site, recording, "north")
    return site


def change(api: LiveApi, site: str, **of_south: Any) -> None:
    """What somebody else does meanwhile: rename the site, and change its second camera."""
    document = api.http.get(f"/v1/sites/{site}").json()["site"]
    document["name"] = "renamed"
    document["cameras"][1] |= of_south
    assert api.http.put(f"/v1/sites/{site}", json=document).status_code == 200


def first(held: list[Any], page: Any) -> Any:
    """The first of the requests that are held, once there is one."""
    while not held:
        page.wait_for_timeout(20)
    return held[0]


def test_a_calibrated_camera_can_be_used_before_its_recording_is_read(
    signed_in: Visit, api: LiveApi, recording: bytes
) -> None:
    site = api.site(cameras=1)
    api.upload(site, recording)
    held: list[Any] = []
    signed_in.page.route(HEADERS, lambda route: held.append(route))
    page = signed_in.open(f"/sites/{site}/cameras/cam1")
    page.locator("#solution dd").first.wait_for()
    page.get_by_role("button", name="Add a region").click()
    page.get_by_role("button", name="Save").click()
    page.get_by_text("saved", exact=True).wait_for()
    assert page.locator("#frame-note").inner_text() == "Reading the recording …"
    first(held, page).continue_()
    page.wait_for_function(LENGTH_IS_KNOWN)
    page.locator("#frame-note", has_text="Wheel or").wait_for()
    with page.expect_request(lambda request: "/frame?time_s=1.5" in request.url):
        page.locator("#time").fill("1.5")


def test_a_recording_that_could_not_be_read_is_read_again(signed_in: Visit, api: LiveApi, recording: bytes) -> None:
    """Whatever was set meanwhile stays, and nothing is asked of chapters whose lengths are not known."""
    site = api.site(cameras=1)
    api.upload(site, recording)
    page = signed_in.page
    strips: list[str] = []
    page.on("request", lambda request: strips.append(request.url) if "/signal?" in request.url else None)
    page.route(HEADERS, lambda route: route.abort())
    signed_in.open(f"/sites/{site}/cameras/cam1")
    page.get_by_text("The recording could not be read").wait_for()
    page.get_by_role("button", name="Add a region").click()
    page.get_by_role("button", name="What does it show?").click()
    page.get_by_text("The recording is not read yet").wait_for()
    assert strips == []
    page.unroute(HEADERS)
    page.get_by_role("button", name="Read it again").click()
    page.locator("#frame-note", has_text="Wheel or").wait_for()
    assert page.locator("#signals .region").count() == 1
    with page.expect_request(lambda request: "/frame?time_s=1.5" in request.url):
        page.locator("#time").fill("1.5")
    signed_in.forgive("ERR_FAILED")


def test_how_long_a_recording_is_is_read_once(signed_in: Visit, api: LiveApi, new_site: str) -> None:
    page, entry = signed_in.page, "performance.getEntriesByType('resource').find((one) => one.name.endsWith('/header'))"
    sent = []
    for _ in range(2):
        signed_in.open(f"/sites/{new_site}/cameras/north")
        page.wait_for_function(LENGTH_IS_KNOWN)
        sent.append(page.evaluate(f"{entry}.transferSize"))
        signed_in.open(f"/sites/{new_site}").get_by_role("heading", name="new").wait_for()
    assert sent[0] > 0, "bytes from the service"
    assert sent[1] == 0, "the browser has kept it"


def test_saving_keeps_what_others_have_changed_meanwhile(signed_in: Visit, api: LiveApi, new_site: str) -> None:
    page = signed_in.open(f"/sites/{new_site}/cameras/north")
    page.get_by_text("0 of at least 4 points").wait_for()
    page.get_by_role("button", name="Add a region").click()
    signals = [{"id": "phase-s", "region": [5, 6, 20, 50]}]
    change(api, new_site, signals=signals)
    page.get_by_role("button", name="Save").click()
    page.get_by_text("saved", exact=True).wait_for()
    kept = api.http.get(f"/v1/sites/{new_site}").json()["site"]
    assert (kept["name"], kept["cameras"][1]["signals"]) == ("renamed", signals)
    assert [one["id"] for one in kept["cameras"][0]["signals"]] == ["phase-1"]


def test_taking_the_size_of_a_recording_keeps_what_others_have_changed_meanwhile(
    signed_in: Visit, api: LiveApi, new_site: str
) -> None:
    held: list[Any] = []
    signed_in.page.route(HEADERS, lambda route: held.append(route))
    page = signed_in.open(f"/sites/{new_site}/cameras/north")
    route = first(held, page)
    change(api, new_site, width_px=800, height_px=600)
    route.continue_()
    page.get_by_text("0 of at least 4 points").wait_for()
    kept = api.http.get(f"/v1/sites/{new_site}").json()["site"]
    assert (kept["name"], kept["cameras"][1]["width_px"]) == ("renamed", 800)
    assert (kept["cameras"][0]["width_px"], kept["cameras"][0]["height_px"]) == (640, 360)


def test_a_geotiff_says_by_itself_where_it_lies(signed_in: Visit, api: LiveApi, tmp_path: Path) -> None:
    """Of a site on Earth, at the origin of whose plane the picture has its top left corner."""
    site = api.site(cameras=1)
    described = api.http.get(f"/v1/sites/{site}").json()["site"]
    origin = {"latitude_deg": 48.753, "longitude_deg": 9.0}
    assert api.http.put(f"/v1/sites/{site}", json={**described, "origin": origin}).status_code == 200
    tags = {SCALE: (0.5, 0.5, 0.0), TIEPOINT: (0.0, 0.0, 0.0, 5e5, 5.4e6, 0.0), KEYS: keys((3072, 32632))}
    page = signed_in.open(f"/sites/{site}/cameras/cam1")
    page.locator("#map-file").set_input_files(write_tiff(tmp_path / "above.tif", tags))
    page.get_by_text("above.tif is placed by what the file itself says").wait_for()
    placing = api.http.get(f"/v1/sites/{site}").json()["map"]["map"]["placing"]
    assert placing[0][0] == pytest.approx(0.5, rel=2e-3) and placing[1][1] == pytest.approx(-0.5, rel=2e-3)
