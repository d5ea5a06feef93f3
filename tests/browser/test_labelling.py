"""An instant labelled by mouse and keyboard, against where the vehicles of the pictures really are."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.browser.conftest import Visit, drawn, serious_findings, visit
from tests.labelled_job import FIT_ERROR, TIMES_NS, labelled_job, later_job
from tests.service import LiveApi, wait_until
from tests.site_dataset import boxes_at, tiny_rig
from wibam_core.geometry.iou import bev_iou_paired

pytestmark = pytest.mark.end_to_end
HUMAN_MS = 150


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return labelled_job(api)


@pytest.fixture
def labelling(signed_in: Visit, job: str, request: pytest.FixtureRequest) -> Visit:
    """The page at an instant, in a set of labels of the test's own."""
    page = signed_in.page
    name = re.sub(r"\W", "-", request.node.name)[:40]
    page.evaluate("name => { localStorage['wibam-label-set'] = name; localStorage['wibam-author'] = 'anna'; }", name)
    signed_in.open(f"/jobs/{job}/labelling?time_ns={TIMES_NS[2]}")
    page.get_by_text("not labelled yet").wait_for()
    return signed_in


def saved(api: LiveApi, job: str, tab: Visit, time_ns: int = TIMES_NS[2]) -> dict[str, object]:
    name = tab.page.evaluate("localStorage['wibam-label-set']")
    found: dict[str, object] = api.http.get(f"/v1/jobs/{job}/labels/instants/{time_ns}", params={"set": name}).json()
    return found


def drag(tab: Visit, camera_id: str, start_m: np.ndarray, end_m: np.ndarray) -> None:
    """Pull what is at a point of the world to another, in a camera's view."""
    camera = tiny_rig()[camera_id]
    canvas = tab.page.get_by_label(f"Frame of camera {camera_id}")
    canvas.scroll_into_view_if_needed()
    place = canvas.bounding_box()
    assert place is not None
    scale = place["width"] / camera.width_px
    ends = [(camera.project(point)[0] + 0.5) * scale + [place["x"], place["y"]] for point in (start_m, end_m)]
    mouse = tab.page.mouse
    mouse.move(*ends[0])
    mouse.down()
    tab.page.wait_for_timeout(HUMAN_MS)
    mouse.move(*(ends[0] + ends[1]) / 2)
    mouse.move(*ends[1])
    mouse.up()
    tab.page.wait_for_timeout(HUMAN_MS)


def front(box: np.ndarray) -> np.ndarray:
    return box[:3] + box[3] / 2 * np.array([np.cos(box[6]), np.sin(box[6]), 0.0])


def test_proposals_are_put_right_by_mouse_and_keys(api: LiveApi, labelling: Visit, job: str) -> None:
    page, truth = labelling.page, boxes_at(TIMES_NS[2])
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    before = np.array([one["box"] for one in saved(api, job, labelling)["labels"]["vehicles"]])  # type: ignore[index]
    np.testing.assert_allclose(before, truth + FIT_ERROR, atol=1e-6)
    for row, camera_id in enumerate(("north", "south")):
        drag(labelling, camera_id, before[row, :3], truth[row, :3])
        for _ in range(9):  # degrees, of the 8.6 that the fit is off
            page.keyboard.press("e")
        for _ in range(8):
            page.keyboard.press("Alt+l")
        page.keyboard.press(".")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Finished").wait_for()
    page.get_by_text("saved as version").wait_for()
    labelling.picture("labelling")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        assert serious_findings(page) == [], scheme
    wait_until(lambda: not page.evaluate("Object.keys(localStorage).some((key) => key.startsWith('wibam-labels '))"))
    found = saved(api, job, labelling)["labels"]
    boxes = np.array([one["box"] for one in found["vehicles"]])  # type: ignore[index]
    assert bev_iou_paired(before, truth).mean() < 0.7
    assert bev_iou_paired(boxes, truth).mean() > 0.9
    assert found["finished"] and found["seconds"] > 1  # type: ignore[index]
    assert page.evaluate("performance.getEntriesByName('drag').length") >= 4


def test_a_face_is_pulled_in_a_view(api: LiveApi, labelling: Visit, job: str) -> None:
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    box = boxes_at(TIMES_NS[2])[0] + FIT_ERROR[:7]
    longer = box.copy()
    longer[3] += 1.0
    longer[:2] += 0.5 * np.array([np.cos(box[6]), np.sin(box[6])])
    drag(labelling, "north", front(box), front(longer))
    page.get_by_text("saved as version 2").wait_for()
    found = np.array(saved(api, job, labelling)["labels"]["vehicles"][0]["box"])  # type: ignore[index]
    np.testing.assert_allclose(found, longer, atol=0.15)
    page.keyboard.press("Control+z")
    page.get_by_text("saved as version 3").wait_for()
    np.testing.assert_allclose(saved(api, job, labelling)["labels"]["vehicles"][0]["box"], box, atol=1e-9)  # type: ignore[index]


def test_a_new_vehicle_is_placed_in_the_plan_and_copied_on_with_its_motion(
    api: LiveApi, labelling: Visit, job: str
) -> None:
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    plan = page.get_by_label("Labelled vehicles from above")
    place = plan.bounding_box()
    assert place is not None
    page.keyboard.press("n")
    page.mouse.move(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
    page.mouse.down()
    page.mouse.move(place["x"] + place["width"] * 0.6, place["y"] + place["height"] / 2)
    page.mouse.move(place["x"] + place["width"] * 0.7, place["y"] + place["height"] / 2)
    page.mouse.up()
    page.keyboard.press("i")
    page.get_by_text("saved as version 2").wait_for()
    [_, _, pulled, put] = (one["box"] for one in saved(api, job, labelling)["labels"]["vehicles"])  # type: ignore[index]
    np.testing.assert_allclose(pulled, put, atol=0.1)
    assert pulled[6] == pytest.approx(0.0, abs=0.02), "X is to the right"
    page.keyboard.press("Delete")
    page.keyboard.press("Delete")
    page.keyboard.press("c")
    page.get_by_text("saved as version 1", exact=True).wait_for()
    copied = saved(api, job, labelling, TIMES_NS[3])["labels"]["vehicles"]  # type: ignore[index]
    np.testing.assert_allclose([one["box"] for one in copied], boxes_at(TIMES_NS[3]) + FIT_ERROR, atol=1e-6)
    np.testing.assert_allclose(copied[0]["velocity_mps"], [5, 0], atol=1e-6)


def test_in_the_plan_a_vehicle_is_dragged_turned_and_stretched(api: LiveApi, labelling: Visit, job: str) -> None:
    page = labelling.page
    place = page.get_by_label("Labelled vehicles from above").bounding_box()
    assert place is not None
    middle = np.array([place["x"] + place["width"] / 2, place["y"] + place["height"] / 2])

    def pull(start: np.ndarray, end: np.ndarray, version: int) -> np.ndarray:
        page.mouse.move(*start)
        page.mouse.down()
        page.mouse.move(*(start + end) / 2)
        page.mouse.move(*end)
        page.mouse.up()
        page.get_by_text(f"saved as version {version}").wait_for()
        return np.array(saved(api, job, labelling)["labels"]["vehicles"][0]["box"])  # type: ignore[index]

    page.keyboard.press("i")
    page.get_by_text("saved as version 1").wait_for()
    put = np.array(saved(api, job, labelling)["labels"]["vehicles"][0]["box"])  # type: ignore[index]
    right, up = np.array([60.0, 0.0]), np.array([0.0, -60.0])
    moved = pull(middle, middle + right, 2)
    metres = moved[0] - put[0]
    assert metres > 1.0
    np.testing.assert_allclose(moved, put + [metres, 0, 0, 0, 0, 0, 0], atol=1e-6)
    front_at = middle + right + [60.0 * moved[3] / 2 / metres, 0.0]
    longer = pull(front_at, front_at + right / 3, 3)
    np.testing.assert_allclose(longer, moved + [metres / 6, 0, 0, metres / 3, 0, 0, 0], atol=0.02)
    knob = front_at + right / 3 + [26.0, 0.0]
    centre = middle + right + right / 6  # the middle moved by half of what the front did
    turned = pull(knob, centre + 2 * up, 4)
    assert turned[6] == pytest.approx(np.pi / 2, abs=0.02)


def test_regions_are_drawn_in_the_plan_and_in_a_view(api: LiveApi, labelling: Visit, job: str) -> None:
    """A hidden region over the whole picture of one camera leaves the others alone."""
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    view = page.get_by_label("Frame of camera north")
    view.scroll_into_view_if_needed()
    size = view.bounding_box()
    assert size is not None
    page.keyboard.press("o")
    for u, v in ((2, 2), (size["width"] - 3, 2), (size["width"] - 3, size["height"] - 3), (2, size["height"] - 3)):
        view.click(position={"x": u, "y": v})
    page.keyboard.press("Enter")
    page.get_by_text("saved as version 2").wait_for()
    found = saved(api, job, labelling)
    assert found["labels"]["regions"][0]["camera"] == "north"  # type: ignore[index]
    assert max(found["visibility"]["north"]) < 0.02 and min(found["visibility"]["south"]) > 0.5  # type: ignore[index]
    page.keyboard.press("b")
    plan = page.get_by_label("Labelled vehicles from above")
    for x, y in ((100, 100), (160, 100), (160, 160)):
        plan.click(position={"x": x, "y": y})
    page.keyboard.press("Enter")
    page.get_by_text("saved as version 3").wait_for()
    page.locator("summary", has_text="Regions").click()
    assert page.locator("#regions li").count() == 2
    drawn = np.array(saved(api, job, labelling)["labels"]["regions"][1]["polygon"])  # type: ignore[index]
    np.testing.assert_allclose(drawn[1] - drawn[0], [drawn[1, 0] - drawn[0, 0], 0], atol=1e-9)
    np.testing.assert_allclose(drawn[2] - drawn[1], [0, drawn[0, 0] - drawn[1, 0]], atol=0.01)
    page.keyboard.press("Control+z")
    page.get_by_text("saved as version 4").wait_for()
    page.get_by_role("textbox", name="Corners").fill("0,0; 5,0; 5,5")
    page.keyboard.press("Enter")
    page.get_by_text("saved as version 5").wait_for()
    kept = saved(api, job, labelling)["labels"]["regions"]  # type: ignore[index]
    assert [one["kind"] for one in kept] == ["hidden", "do_not_care"]
    assert kept[1]["polygon"] == [[0, 0], [5, 0], [5, 5]]
    page.get_by_role("button", name="The instant before").click()
    page.get_by_text("not labelled yet").wait_for()
    assert page.locator("#regions li").count() == 2, "what stands before a camera stands there at all instants"


def test_no_cross_says_that_enter_clicks_where_it_finishes_the_instant(labelling: Visit) -> None:
    """In frames that no key moves otherwise, arrow keys move what is enlarged."""
    page = labelling.page
    frame = page.get_by_label("Frame of camera north")
    selector = "canvas[aria-label^='Frame of camera north']"
    page.wait_for_load_state("networkidle")
    before = drawn(page, selector)
    page.keyboard.press("Shift")  # from a key on, the browser marks what has the focus
    frame.focus()
    assert frame.evaluate("frame => frame.matches(':focus-visible')")
    assert drawn(page, selector) == before
    page.keyboard.press("+")
    enlarged = drawn(page, selector)
    page.keyboard.press("ArrowRight")
    assert drawn(page, selector) != enlarged
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Finished").wait_for()


def test_what_is_not_saved_is_there_again_and_two_people_see_each_other(
    api: LiveApi, labelling: Visit, playwright_browser: object, job: str
) -> None:
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    name = page.evaluate("localStorage['wibam-label-set']")
    address = f"/jobs/{job}/labelling?time_ns={TIMES_NS[2]}"
    page.route(
        "**/labels/instants/*", lambda route: route.abort() if route.request.method == "PUT" else route.continue_()
    )
    page.keyboard.press("ArrowUp")
    page.get_by_text("not saved").wait_for()
    with visit(playwright_browser, labelling.url) as other:  # type: ignore[arg-type]
        other.sign_in()
        other.page.evaluate(
            "name => { localStorage['wibam-label-set'] = name; localStorage['wibam-author'] = 'ben'; }", name
        )
        other.open(address)
        other.page.get_by_text("version 1 by anna").wait_for()
        other.page.keyboard.press("ArrowDown")
        other.page.get_by_text("saved as version 2").wait_for()
    page.unroute_all()  # not before: the page tries again and again
    labelling.open(address)
    page.get_by_text("ben saved this instant meanwhile").wait_for()
    page.get_by_role("button", name="Go on with this").click()
    page.get_by_text("saved as version 3").wait_for()
    start = (boxes_at(TIMES_NS[2]) + FIT_ERROR)[0]
    forward = 0.05 * np.array([np.cos(start[6]), np.sin(start[6])])
    box = saved(api, job, labelling)["labels"]["vehicles"][0]["box"]  # type: ignore[index]
    np.testing.assert_allclose(box[:2], start[:2] + forward, atol=1e-9)
    labelling.forgive("ERR_FAILED")
    labelling.forgive("status of 412")


def test_labels_of_instants_that_a_later_job_lacks_are_counted_and_not_asked_for(
    api: LiveApi, signed_in: Visit
) -> None:
    """An address with such an instant leads to the nearest one. (`signed_in` looks at the console.)"""
    earlier = labelled_job(api, b"more instants")
    for time_ns in (TIMES_NS[1], TIMES_NS[3]):
        address = f"/v1/jobs/{earlier}/labels/instants/{time_ns}"
        body = {"author": "anna", "vehicles": [], "finished": True}
        assert api.http.put(address, headers={"If-Match": '"0"'}, json=body).status_code == 200
    job = later_job(api, earlier, 2)
    signed_in.page.evaluate("localStorage['wibam-author'] = 'ben'")
    page = signed_in.open(f"/jobs/{job}/labelling?time_ns={TIMES_NS[3]}")
    page.get_by_text("version 1 by anna").wait_for()
    page.get_by_text("1 more labelled instant is of another job of this footage").wait_for()
    page.get_by_text("1 instant finished").wait_for()
    assert page.locator("#instant").input_value() == str(TIMES_NS[1])
    assert str(TIMES_NS[3]) not in page.locator("#instant option").evaluate_all("all => all.map((one) => one.value)")


def test_a_job_that_has_fitted_nothing_says_when_it_can_be_labelled(signed_in: Visit, api: LiveApi) -> None:
    site = api.site(cameras=1)
    api.upload(site, b"to be labelled later")
    later = api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"]
    page = signed_in.open(f"/jobs/{later}/labelling")
    page.get_by_text("There is nothing to label yet.").wait_for()


@pytest.mark.parametrize("asked", ["abc", "1e99", "", "-5", "1.5e99"])
def test_an_address_without_a_time_opens_an_instant(signed_in: Visit, job: str, asked: str) -> None:
    page = signed_in.open(f"/jobs/{job}/labelling?time_ns={asked}")
    page.get_by_text("not labelled yet").wait_for()
    assert int(page.locator("#instant").input_value()) in TIMES_NS


def test_an_address_with_a_time_between_opens_the_nearest_instant(signed_in: Visit, job: str) -> None:
    page = signed_in.open(f"/jobs/{job}/labelling?time_ns={TIMES_NS[1] + 7_000_000}")
    page.get_by_text("not labelled yet").wait_for()
    assert page.locator("#instant").input_value() == str(TIMES_NS[1])


def test_an_instant_that_cannot_be_loaded_is_named_and_opened_again(labelling: Visit) -> None:
    page = labelling.page
    page.route("**/proposal", lambda route: route.abort())
    page.locator("#instant").select_option(str(TIMES_NS[3]))
    page.get_by_text("could not be loaded; open it again").wait_for()
    page.unroute_all()
    page.locator("#instant").select_option(str(TIMES_NS[3]))
    page.get_by_text("not labelled yet").wait_for()
    assert page.locator("#instant").input_value() == str(TIMES_NS[3])
    labelling.forgive("ERR_FAILED")
