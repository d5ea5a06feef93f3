"""Labels while an instant is loading or was left unsaved, the tools for one vehicle, and two people compared."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.browser.conftest import Visit
from tests.browser.labels import put, saved
from tests.labelled_job import FIT_ERROR, TIMES_NS, labelled_job
from tests.service import LiveApi, wait_until
from tests.site_dataset import boxes_at

pytestmark = pytest.mark.end_to_end
HERE, NEXT = TIMES_NS[2], TIMES_NS[3]


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return labelled_job(api, b"to be saved")


@pytest.fixture
def name(request: pytest.FixtureRequest) -> str:
    """Of the test's own set of labels."""
    return request.node.originalname[5:45].replace("_", "-")  # type: ignore[attr-defined, no-any-return]


@pytest.fixture
def labelling(signed_in: Visit, job: str, name: str) -> Visit:
    signed_in.page.evaluate(
        "name => { localStorage['wibam-label-set'] = name; localStorage['wibam-author'] = 'anna'; }", name
    )
    signed_in.open(f"/jobs/{job}/labelling?time_ns={HERE}")
    signed_in.page.get_by_text("not labelled yet").wait_for()
    return signed_in


def test_nothing_can_be_changed_while_an_instant_is_loading(
    api: LiveApi, labelling: Visit, job: str, name: str
) -> None:
    """It would be shown, saved by nobody, and gone once the instant is there."""
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    held: list[Any] = []
    page.route("**/proposal", lambda route: held.append(route))
    page.locator("#instant").select_option(str(NEXT))
    page.evaluate("document.activeElement.blur()")
    while not held:
        page.wait_for_timeout(20)
    for key in ("i", "ArrowUp", "Delete", "Enter"):
        page.keyboard.press(key)
    assert page.locator("#present option").all_inner_texts() == ["none"]
    held[0].continue_()
    page.get_by_text("not labelled yet").wait_for()
    assert page.locator("#present option").all_inner_texts() == ["none"]
    page.keyboard.press("i")
    page.get_by_text("saved as version 1").wait_for()
    assert len(saved(api, job, name, NEXT)["labels"]["vehicles"]) == 1
    assert saved(api, job, name, HERE)["version"] == 1


def test_an_instant_that_was_left_unsaved_is_saved_and_merged_without_the_one_that_is_shown(
    api: LiveApi, labelling: Visit, job: str, name: str
) -> None:
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    page.route(
        f"**/labels/instants/{HERE}*",
        lambda route: route.abort() if route.request.method == "PUT" else route.continue_(),
    )
    page.keyboard.press("ArrowUp")
    page.get_by_text("not saved").wait_for()
    first, second = saved(api, job, name, HERE)["labels"]["vehicles"]
    put(api, job, name, HERE, 1, [first, {**second, "class": "bus"}])
    page.locator("#instant").select_option(str(NEXT))
    page.evaluate("document.activeElement.blur()")
    page.get_by_text("not labelled yet").wait_for()
    page.unroute_all()
    page.get_by_text("ben saved this instant meanwhile").wait_for()
    page.get_by_role("button", name="Go on with this").click()
    wait_until(lambda: saved(api, job, name, HERE)["version"] == 3)
    mine, theirs = saved(api, job, name, HERE)["labels"]["vehicles"]
    assert mine["box"][:2] != first["box"][:2]
    assert theirs["class"] == "bus"
    assert page.locator("#present option").all_inner_texts() == ["none"]
    page.keyboard.press("i")
    page.get_by_text("saved as version 1").wait_for()
    [alone] = saved(api, job, name, NEXT)["labels"]["vehicles"]
    assert alone["box"][:2] != mine["box"][:2]
    labelling.forgive("ERR_FAILED")
    labelling.forgive("status of 412")


def test_a_vehicle_is_snapped_put_on_the_ground_named_and_seen(
    api: LiveApi, labelling: Visit, job: str, name: str
) -> None:
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()

    def vehicle(version: int) -> Any:
        page.get_by_text(f"saved as version {version}").wait_for()
        return saved(api, job, name, HERE)["labels"]["vehicles"][0]

    fit = boxes_at(HERE)[0] + FIT_ERROR
    page.keyboard.press("Shift+ArrowUp")
    assert np.hypot(*(np.array(vehicle(2)["box"]) - fit)[:2]) == pytest.approx(0.5)
    page.keyboard.press("f")
    np.testing.assert_allclose(vehicle(3)["box"], fit, atol=1e-6)
    page.get_by_label("z, m").fill("3")
    page.keyboard.press("Tab")
    assert vehicle(4)["box"][2] == 3
    page.get_by_role("button", name="Put on the ground").click()
    assert vehicle(5)["box"][2] == pytest.approx(fit[5] / 2)
    page.get_by_label("Class").select_option("truck")
    assert vehicle(6)["class"] == "truck"
    page.get_by_label("Share that north sees, corrected").fill("40")
    page.keyboard.press("Tab")
    assert vehicle(7)["visibility"] == {"north": 0.4}
    page.get_by_role("checkbox", name="do not care").check()
    assert vehicle(8)["ignored"]
    for _ in range(2):
        page.get_by_role("button", name="Undo").click()
    wait_until(lambda: saved(api, job, name, HERE)["labels"]["vehicles"][0]["visibility"] == {})
    undone = saved(api, job, name, HERE)["labels"]["vehicles"][0]
    assert (undone["ignored"], undone["class"]) == (False, "truck")
    page.get_by_role("button", name="Redo").click()
    wait_until(lambda: saved(api, job, name, HERE)["labels"]["vehicles"][0]["visibility"] == {"north": 0.4})


def test_two_people_are_compared(api: LiveApi, labelling: Visit, job: str, name: str) -> None:
    """The second one has put the first vehicle half a metre and 6 degrees aside, and has not seen the other."""
    page, (first, second) = labelling.page, boxes_at(HERE)
    both = [
        {"id": id_, "class": "car", "box": box.tolist(), "velocity_mps": [0, 0], "visibility": {}, "ignored": False}
        for id_, box in ((7, first), (8, second))
    ]
    aside = first + [0.3, 0.4, 0, 0, 0, 0, np.radians(6)]
    put(api, job, name, HERE, 0, both, "anna")
    put(api, job, f"{name}-2", HERE, 0, [{**both[0], "box": aside.tolist()}])
    page.get_by_label("Compare with the set").fill(f"{name}-2")
    page.get_by_role("button", name="Compare", exact=True).click()
    rows = page.locator("#agreement tr")
    rows.first.wait_for()
    found = dict(tuple(row.split("\t")) for row in rows.all_inner_texts())
    assert found["Instants that both finished"] == "1"
    assert found["Vehicles of both"] == "1"
    assert found["Only in the first, only in the second"] == "1, 0"
    assert found["Distance of centres, m"].startswith("0.50")
    assert found["Difference of headings, °"].startswith("6.0")
    assert found["Same class"] == "100 %"
