"""The player on a finished job: it plays, steps, filters, and says the same question to the API."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.browser.conftest import Visit, visit
from tests.browser.test_every_page import BEYOND
from tests.builders import corner_rig
from tests.clips import clip_job
from tests.finished import finished_job, tracks
from tests.service import LiveApi
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track
from worker.clips import ClipRunner
from worker.workplace import Workplace

#: Draws instants of 60 vehicles in four views, as the benchmark does.
DRAWING = (Path(__file__).parents[2] / "benchmarks" / "pages_player.js").read_text()


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


@pytest.fixture(scope="module")
def job_with_a_gap(api: LiveApi) -> str:
    """Cars at 0 to 1.9 s and at 6 to 8 s, ten times a second but for two instants; speeds lie close to round ones."""
    late = np.concatenate([[6_000, 6_100, 6_240, 6_410], np.arange(6_500, 8_100, 100)])
    speeds = np.resize([4.994, 4.996, 5.0, 5.004, 0.29], 20)
    found = [
        Track(
            number,
            RoadUserClass.CAR,
            times_ms * 1_000_000,
            np.column_stack([np.arange(20.0), np.tile([0.0, 0.75, 4.5, 1.8, 1.5, 0.0], (20, 1))]),
            np.full((20, 7), 0.1),
            np.column_stack([speeds, np.zeros(20)]),
            np.zeros(20),
        )
        for number, times_ms in enumerate((np.arange(0, 2_000, 100), late), 1)
    ]
    return finished_job(api, b"with a gap", tracked=found)


def test_a_job_without_tracks_says_when_there_will_be_some(signed_in: Visit, api: LiveApi) -> None:
    site = api.site(cameras=1)
    api.upload(site, b"still to come")
    job = api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"]
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_text("There are no tracks yet.").wait_for()


def test_it_draws_sixty_vehicles_in_four_views(signed_in: Visit) -> None:
    signed_in.page.get_by_role("heading", name="Jobs").wait_for()
    drawn = signed_in.page.evaluate(DRAWING, 5)
    assert drawn["seen"] > 100
    assert drawn["coloured"] > 1000, "footprints are filled with their colour"


class TestFilterIsTheApis:
    SCRIPT = """async ([job, filter]) => {
      const { parameters, passes, statesOf } = await import("/static/js/trackdata.js");
      const { get, query } = await import("/static/js/api.js");
      const states = statesOf(await get(`/v1/jobs/${job}/tracks/compact`));
      const kept = states.filter((state) => passes(state, filter)).map((s) => [s.time_ns, s.track_id]);
      return { query: query(parameters(filter)), kept };
    }"""

    @pytest.mark.parametrize(
        "change",
        [
            {},
            {"classes": ["bus"]},
            {"minSpeed": 5},
            {"startNs": 1_000_000_000, "endNs": 2_000_000_000},
            {"polygon": [[5.5, -2], [30, -2], [30, 8], [12.25, 8]]},
        ],
    )
    def test_what_is_shown_is_what_the_address_answers(
        self, signed_in: Visit, api: LiveApi, job: str, change: dict[str, object]
    ) -> None:
        base = {"classes": [], "minSpeed": None, "startNs": None, "endNs": None, "polygon": []}
        found = signed_in.page.evaluate(self.SCRIPT, [job, {**base, **change}])
        answered = api.http.get(
            f"/v1/jobs/{job}/tracks{found['query']}{'&' if found['query'] else '?'}limit=1000"
        ).json()
        assert found["kept"] == [[state["time_ns"], state["track_id"]] for state in answered["states"]]
        assert 0 < len(found["kept"]) <= 100

    @pytest.mark.parametrize(("least_mps", "states"), [(5, 16), (4.99, 32), (0.29, 40)])
    def test_speeds_close_to_the_limit_too(
        self, signed_in: Visit, api: LiveApi, job_with_a_gap: str, least_mps: float, states: int
    ) -> None:
        change = {"minSpeed": least_mps}
        self.test_what_is_shown_is_what_the_address_answers(signed_in, api, job_with_a_gap, change)
        address = f"/v1/jobs/{job_with_a_gap}/tracks/summary?min_speed_mps={least_mps}"
        assert api.http.get(address).json()["states"] == states


def test_who_is_in_an_area_is_what_the_service_counts(signed_in: Visit, api: LiveApi) -> None:
    """States a few mm on both sides of an edge, which the places that are drawn, in whole cm, do not tell apart."""
    [car, _] = tracks()
    boxes = car.boxes.copy()
    boxes[:, 0] = 10.0 + np.resize([-0.004, -0.001, 0.001, 0.004], 50)
    job = finished_job(api, b"at an edge", tracked=[replace(car, boxes=boxes)])
    polygon = [[5, -2], [10, -2], [10, 2], [5, 2]]
    script = """async ([job, version, lastNs, polygon]) => {
      const { TrackWindows } = await import("/static/js/trackwindows.js");
      const { parameters, passes } = await import("/static/js/trackdata.js");
      const filter = { classes: [], minSpeed: null, startNs: null, endNs: null, polygon };
      const known = await new Promise((done, failed) => {
        const arrived = () => { if (known.has(0) && known.has(lastNs)) done(known); };
        const page = { version, frames: false, failed, changed: failed, arrived };
        const known = new TrackWindows(job, 0, lastNs, page);
        known.want(0, 0, lastNs);
        known.within(parameters(filter).polygon); // while the states are on their way
        known.want(0, 0, lastNs);
      });
      known.want(0, 0, lastNs);
      const states = known.tracks.at.flat(), times = (found) => found.map((one) => one.time_ns);
      const exact = states.filter((one) => passes(one, filter, known.inside(one)));
      return [times(states.filter((one) => passes(one, filter))), times(exact)];
    }"""
    [file] = api.http.get(f"/v1/jobs/{job}/artifacts?artifact=tracks").json()
    arguments = [job, file["sha256"], int(car.times_ns[-1]), polygon]
    by_rounded_places, found = signed_in.page.evaluate(script, arguments)
    assert found == car.times_ns[boxes[:, 0] < 10].tolist()
    assert by_rounded_places != found


def test_an_area_is_drawn_corner_by_corner(signed_in: Visit, api: LiveApi, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player?time_ns=1000000000")
    page.get_by_text("100 of 100 states").wait_for()
    assert page.locator("#present option").count() == 3
    page.get_by_role("button", name="Draw an area").click()
    place = page.locator("#plan").bounding_box()
    assert place is not None
    for x, y in ((0.02, 0.02), (0.98, 0.02), (0.98, 0.98)):  # the standing bus, or the car, or both
        page.locator("#plan").click(position={"x": x * place["width"], "y": y * place["height"]})
    page.get_by_role("button", name="Done").click()
    address = page.locator("#query-url").inner_text()
    assert address.count("%3B") == 2
    answered = api.http.get(f"{address}&limit=1000").json()["states"]
    page.get_by_text(f"{len(answered)} of 100 states").wait_for()
    there = sum(state["time_ns"] == 1_000_000_000 for state in answered)
    page.wait_for_function("count => document.querySelectorAll('#present option').length === count + 1", arg=there)
    page.wait_for_function("() => document.getElementById('waiting').textContent === ''")
    assert there < 2


def test_an_area_waits_for_a_field_that_is_not_valid(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player?time_ns=1000000000")
    page.get_by_text("100 of 100 states").wait_for()
    page.get_by_role("button", name="Draw an area").click()
    page.locator("#min-speed").fill("-1")
    page.locator("#plan").focus()
    for key in ("ArrowRight", "ArrowDown", "ArrowLeft"):
        page.keyboard.press(key)
        page.keyboard.press("Enter")
        page.locator("#plan").focus()
    page.get_by_role("button", name="One step forward").click()
    assert page.locator("#clock").inner_text() == "0:01.1"
    assert page.locator("#present option").count() == 3, "nobody is hidden by an area that was not asked for"
    assert "polygon" not in page.locator("#query-url").inner_text()


def test_frames_that_are_given_back_are_closed_and_none_is_asked_for(signed_in: Visit) -> None:
    """Of 20 that are wanted six are asked for at a time: they arrive, or do not, and the others never begin."""
    jpeg = cv2.imencode(".jpg", np.zeros((36, 64, 3), np.uint8))[1].tobytes()
    signed_in.page.route("**/frames/**", lambda route: route.fulfill(body=jpeg, content_type="image/jpeg"))
    asked: list[str] = []
    signed_in.page.on("request", lambda request: asked.append(request.url) if "/frames/" in request.url else None)
    width = signed_in.page.evaluate("""async () => {
      const { FrameCache } = await import("/static/js/frames.js");
      const wanted = Array.from({ length: 20 }, (_, index) => ["north", index]);
      const image = await new Promise((done) => {
        const cache = new FrameCache("job", 480, () => {
          const found = cache.get("north", 0);
          if (found) { cache.close(); done(found); }
        });
        cache.want(wanted);
      });
      await new Promise((done) => setTimeout(done, 300));
      return image.width;
    }""")
    assert width == 0, "closed"
    assert 6 <= len(asked) < 20


def test_an_area_has_no_more_corners_than_the_service_takes(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_text("100 of 100 states").wait_for()
    page.get_by_role("button", name="Draw an area").click()
    page.locator("#plan").focus()
    for _ in range(101):
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Enter")
    page.get_by_text("An area has at most 100 corners").wait_for()
    assert page.locator("#query-url").inner_text().count("%3B") == 99


def test_a_history_that_cannot_be_loaded_says_what_to_do(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player")
    page.route("**/tracks/summary?track_id=1", lambda route: route.abort())
    page.get_by_label("Visible now").select_option("1")
    page.get_by_text("The history of track 1 could not be loaded; choose it again.").wait_for()
    page.unroute_all()
    page.get_by_label("Visible now").select_option("2")
    page.get_by_label("Visible now").select_option("1")
    page.get_by_role("region", name="History of track 1").wait_for()
    signed_in.forgive("ERR_FAILED")


def test_the_history_of_a_road_user_has_seven_degrees_of_freedom_with_their_intervals(
    signed_in: Visit, job: str
) -> None:
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_label("Visible now").select_option("1")
    history = page.get_by_role("region", name="History of track 1")
    titles = ["time", "x, m", "y, m", "z, m", "length, m", "width, m", "height, m", "yaw, °", "speed, m/s"]
    history.wait_for()
    assert history.locator("th").all_inner_texts() == titles
    row = history.locator("tbody tr").nth(10).locator("td").all_inner_texts()
    sizes = ["4.50 ± 0.20", "1.80 ± 0.20", "1.50 ± 0.20"]  # 1.96 standard deviations of 0.1
    assert row == ["0:01.0", "10.00 ± 0.20", "0.00 ± 0.20", "0.75 ± 0.20", *sizes, "0.0 ± 11.2", "10.0"]
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate(BEYOND) <= 0, "on a phone the table scrolls, and not the page"


def test_a_click_on_a_vehicle_in_the_plan_or_in_a_view_chooses_it(signed_in: Visit, job: str) -> None:
    """At 0.5 s the car is at (5, 0), the bus at (20, 5), which the camera does not see."""
    page = signed_in.open(f"/jobs/{job}/player?time_ns=500000000")
    page.locator("#present option:nth-child(3)").wait_for(state="attached")
    camera = corner_rig(1)["cam1"]
    plan, view = page.locator("#plan").bounding_box(), page.locator("#views canvas").bounding_box()
    assert plan is not None and view is not None
    corners = np.array([[0.0, 0.0], [49.0, 5.0], camera.centre_m[:2]])  # what the plan is fitted to
    middle, size = (corners.min(axis=0) + corners.max(axis=0)) / 2, np.ptp(corners, axis=0)
    px_per_m = 0.94 * min(1000 / size[0], 760 / size[1])
    x, y = (np.array([20.0, 5.0]) - middle) * px_per_m * [1, -1] + [500, 380]
    page.locator("#plan").click(position={"x": x * plan["width"] / 1000, "y": y * plan["height"] / 760})
    page.locator("#chosen").get_by_text("Track 2, bus").wait_for()
    pixel, _ = camera.project(np.array([5.0, 0.0, 0.75]))
    u, v = (pixel + 0.5) * view["width"] / camera.width_px
    page.locator("#views canvas").click(position={"x": float(u), "y": float(v)})
    page.locator("#chosen").get_by_text("Track 1, car").wait_for()


def test_keys_work_wherever_a_click_has_left_the_focus(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_role("slider", name="Instant").fill("20")
    page.keyboard.press(".")
    page.wait_for_function("() => document.getElementById('clock').textContent === '0:02.1'")
    page.get_by_role("button", name="One step back").click()
    page.keyboard.press(",")
    page.wait_for_function("() => document.getElementById('clock').textContent === '0:01.9'")
    page.keyboard.press("]")
    page.get_by_text("Conflict 0: crossing").wait_for()


def press(page: Any, key: str, clock: str) -> None:
    """Press a key, after which the clock shows something."""
    page.keyboard.press(key)
    page.wait_for_function("clock => document.getElementById('clock').textContent === clock", arg=clock)


def test_steps_cross_a_time_in_which_nobody_is_tracked(signed_in: Visit, job_with_a_gap: str) -> None:
    page = signed_in.open(f"/jobs/{job_with_a_gap}/player?time_ns=1800000000")
    slider = page.get_by_role("slider", name="Instant")
    slider.wait_for()
    for forward, back in ((".", ","), ("ArrowRight", "ArrowLeft")):
        slider.focus()
        press(page, forward, "0:01.9")
        for tenths in range(20, 62):
            press(page, forward, f"0:0{tenths // 10}.{tenths % 10}")
        for clock in ("0:06.2", "0:06.4", "0:06.5"):  # at 6.24 and 6.41 s: the slider's steps are even
            press(page, forward, clock)
        slider.fill("62")
        for tenths in range(61, 17, -1):
            press(page, back, f"0:0{tenths // 10}.{tenths % 10}")


@pytest.mark.parametrize(("asked", "clock"), [("abc", "0:00.0"), ("1e99", "0:00.0"), ("", "0:00.0"), ("-5", "0:00.0")])
def test_an_address_without_a_time_shows_the_first(signed_in: Visit, job: str, asked: str, clock: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player?time_ns={asked}")
    page.locator("#present option:nth-child(3)").wait_for(state="attached")
    assert page.locator("#clock").inner_text() == clock


def test_a_time_that_no_clock_shows_is_refused_in_the_page(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_text("100 of 100 states").wait_for()
    page.locator("#from").fill("1e12")
    page.locator("#from:invalid").wait_for()
    page.locator("#from").fill("4")
    page.get_by_text("20 of 100 states").wait_for()


def test_what_the_service_refuses_is_asked_for_once(playwright_browser: Any, api: LiveApi, job: str) -> None:
    with visit(playwright_browser, api.url) as tab:
        tab.sign_in()
        asked: list[str] = []
        tab.page.on("request", lambda request: asked.append(request.url) if "/compact" in request.url else None)
        tab.page.route("**/tracks/compact*", lambda route: route.fulfill(status=404, json={"detail": "no tracks"}))
        page = tab.open(f"/jobs/{job}/player")
        page.get_by_text("The service refuses the tracks of this time").wait_for()
        once = len(asked)
        page.keyboard.press(".")
        page.wait_for_timeout(4_000)  # longer than what fails for the moment waits
        assert len(asked) == once
        assert page.get_by_role("alert").get_by_text("No tracks.").count() == 1


def test_boxes_move_along_their_tracks_to_when_a_frame_was_exposed(signed_in: Visit) -> None:
    moved = """async ([states, times]) => {
      const { Tracks } = await import("/static/js/trackdata.js");
      const tracks = new Tracks(states);
      return times.map((time) => tracks.moved(states[1], time));
    }"""
    rows = [(0, 0.0, 0.0, 3.1), (200_000_000, 2.0, 1.0, -3.1), (300_000_000, 3.0, 3.0, -3.0)]
    states = [{"time_ns": t, "track_id": 7, "x_m": x, "y_m": y, "z_m": 0.8, "yaw_rad": yaw} for t, x, y, yaw in rows]
    times = [200_000_000, 100_000_000, 250_000_000, 350_000_000]
    same, before, after, beyond = signed_in.page.evaluate(moved, [states, times])
    assert same == states[1]
    assert (before["x_m"], before["y_m"]) == pytest.approx((1.0, 0.5))
    assert abs(before["yaw_rad"]) == pytest.approx(3.14159, abs=1e-4), "it turns the shorter way"
    assert (after["x_m"], after["y_m"], after["yaw_rad"]) == pytest.approx((2.5, 2.0, -3.05))
    assert (beyond["x_m"], beyond["y_m"], beyond["time_ns"]) == pytest.approx((3.5, 4.0, 350_000_000))


def test_a_clip_of_what_is_shown_is_asked_for_and_taken(signed_in: Visit, api: LiveApi) -> None:
    job = clip_job(api)
    page = signed_in.open(f"/jobs/{job}/player")
    page.get_by_label("Clip from, s").fill("1")
    page.get_by_label("Clip to, s").fill("2.5")
    page.get_by_label("Colour by").select_option("speed")
    page.get_by_role("checkbox", name="bus").uncheck()
    page.get_by_role("button", name="Render").click()
    page.get_by_text("waits for a worker").wait_for()
    [clip] = api.services.clips.clips(job)
    assert (clip.spec.start_ns, clip.spec.end_ns, clip.spec.colour) == (10**9, 25 * 10**8, "speed")
    assert [item.value for item in clip.spec.classes] == ["car"]
    services, settings = api.services, api.services.settings
    ClipRunner(
        Workplace(services.jobs, services.folder, settings.limits, settings.leases, "tests"), services.clips
    ).run(clip.id)
    with page.expect_download() as download:
        page.get_by_role("link", name="Download the clip 0:01.0 to 0:02.5").click()
    assert download.value.path().read_bytes()[4:8] == b"ftyp"
    assert download.value.suggested_filename == f"{job}-{clip.id}.mp4"
    page.get_by_role("button", name="Delete the clip 0:01.0 to 0:02.5").click()
    page.get_by_text("None yet.").wait_for()
    assert services.clips.clips(job) == []
