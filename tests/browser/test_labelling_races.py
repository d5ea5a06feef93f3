"""Instants opened, left and retried at once: nothing that somebody has labelled goes, or goes elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.browser.conftest import Visit
from tests.browser.labels import put, saved
from tests.labelled_job import TIMES_NS, labelled_job
from tests.service import LiveApi, wait_until

pytestmark = pytest.mark.end_to_end
BEFORE, HERE, NEXT = TIMES_NS[1:]
#: Longer than the page waits before it tries again to save, ms.
RETRIED_MS = 4_600


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return labelled_job(api, b"opened at once")


@pytest.fixture
def name(request: pytest.FixtureRequest) -> str:
    """Of the test's own set of labels."""
    return request.node.originalname[5:45].replace("_", "-")  # type: ignore[attr-defined, no-any-return]


@pytest.fixture
def labelling(signed_in: Visit, job: str, name: str) -> Iterator[Visit]:
    signed_in.page.evaluate(
        "name => { localStorage['wibam-label-set'] = name; localStorage['wibam-author'] = 'anna'; }", name
    )
    signed_in.open(f"/jobs/{job}/labelling?time_ns={HERE}")
    signed_in.page.get_by_text("not labelled yet").wait_for()
    yield signed_in
    signed_in.page.unroute_all(behavior="ignoreErrors")


def held(tab: Visit, pattern: str) -> list[Any]:
    """Requests for an address, which wait from now on."""
    found: list[Any] = []
    tab.page.route(pattern, lambda route: found.append(route))
    return found


def wait_for(tab: Visit, requests: list[Any], count: int = 1) -> None:
    while len(requests) < count:
        tab.page.wait_for_timeout(20)


def no_saving(tab: Visit) -> None:
    tab.page.route(
        "**/labels/instants/*",
        lambda route: route.abort() if route.request.method == "PUT" else route.fallback(),
    )


def choose(tab: Visit, time_ns: int) -> None:
    tab.page.locator("#instant").select_option(str(time_ns))
    tab.page.evaluate("document.activeElement.blur()")


def choose_set(tab: Visit, name: str) -> None:
    tab.page.locator("#set").fill(name)
    tab.page.locator("#set").blur()


def vehicles(tab: Visit) -> list[str]:
    shown = tab.page.locator("#present option").all_inner_texts()
    return [] if shown == ["none"] else shown


def test_an_instant_opened_again_is_the_one_that_was_asked_for_last(
    api: LiveApi, labelling: Visit, job: str, name: str
) -> None:
    """An older answer about the same instant would put away what was changed since."""
    page = labelling.page
    waiting = held(labelling, f"**/{NEXT}/proposal")
    for key in ("PageDown", "PageUp", "PageDown"):
        page.keyboard.press(key)
    wait_for(labelling, waiting, 2)
    waiting[1].continue_()
    page.get_by_text("not labelled yet").wait_for()
    page.keyboard.press("i")
    page.get_by_text("saved as version 1").wait_for()
    waiting[0].continue_()
    page.wait_for_timeout(500)
    assert len(vehicles(labelling)) == 1
    page.keyboard.press("i")
    page.get_by_text("saved as version 2").wait_for()
    assert len(saved(api, job, name, NEXT)["labels"]["vehicles"]) == 2


def test_pressing_twice_while_an_instant_is_saved_goes_on_by_two(
    api: LiveApi, labelling: Visit, job: str, name: str
) -> None:
    page = labelling.page
    page.keyboard.press("i")
    waiting: list[Any] = []
    page.route(
        "**/labels/instants/*",
        lambda route: waiting.append(route) if route.request.method == "PUT" else route.fallback(),
    )
    for _ in range(2):
        page.keyboard.press("PageUp")
    wait_for(labelling, waiting)
    waiting[0].continue_()
    page.get_by_text("not labelled yet").wait_for()
    assert page.locator("#instant").input_value() == str(TIMES_NS[0])
    assert len(saved(api, job, name, HERE)["labels"]["vehicles"]) == 1


def test_an_instant_of_the_set_before_does_not_come_late(api: LiveApi, labelling: Visit, job: str, name: str) -> None:
    page = labelling.page
    waiting = held(labelling, f"**/{NEXT}/proposal")
    page.keyboard.press("PageDown")
    wait_for(labelling, waiting)
    choose_set(labelling, f"{name}-2")
    wait_for(labelling, waiting, 2)
    waiting[1].continue_()
    page.get_by_text("not labelled yet").wait_for()
    waiting[0].continue_()
    page.wait_for_timeout(500)
    page.keyboard.press("i")
    page.get_by_text("saved as version 1").wait_for()
    assert saved(api, job, name, NEXT)["version"] == 0
    assert saved(api, job, f"{name}-2", NEXT)["version"] == 1


def test_nothing_is_changed_in_a_set_that_is_being_left(api: LiveApi, labelling: Visit, job: str, name: str) -> None:
    """Its regions are put away by then: whatever was saved would be without them."""
    page = labelling.page
    page.locator("summary", has_text="Regions").click()
    page.get_by_role("textbox", name="Corners").fill("0,0; 5,0; 5,5")
    page.keyboard.press("Enter")
    page.get_by_text("saved as version 1").wait_for()
    waiting = held(labelling, "**/labels/suggestions*")
    choose_set(labelling, f"{name}-2")
    wait_for(labelling, waiting)
    page.keyboard.press("i")
    assert vehicles(labelling) == []
    waiting[0].continue_()
    page.get_by_text("not labelled yet").wait_for()
    found = saved(api, job, name, HERE)
    assert (found["version"], len(found["labels"]["regions"]), found["labels"]["vehicles"]) == (1, 1, [])
    assert page.locator("#regions li").count() == 0


def test_two_conflicts_at_once_are_asked_about_one_after_the_other(
    api: LiveApi, labelling: Visit, job: str, name: str
) -> None:
    """Both instants were left unsaved, and somebody else has made buses of what was moved here."""
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    choose(labelling, NEXT)
    page.get_by_text("not labelled yet").wait_for()
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    no_saving(labelling)
    for time_ns in (NEXT, HERE):
        choose(labelling, time_ns)
        page.get_by_text("version 1 by anna").wait_for()
        page.keyboard.press("ArrowUp")
        page.get_by_text("not saved").wait_for()
        first, *others = saved(api, job, name, time_ns)["labels"]["vehicles"]
        put(api, job, name, time_ns, 1, [{**first, "class": "bus"}, *others])
    choose(labelling, BEFORE)
    page.get_by_text("not labelled yet").wait_for()
    refused: list[str] = []
    page.on("response", lambda answer: refused.append(answer.url) if answer.status == 412 else None)
    page.unroute_all()
    while len(set(refused)) < 2:
        page.wait_for_timeout(20)
    page.wait_for_timeout(500)
    asked = page.locator("#merge-said").inner_text()
    page.locator("#merge-both").get_by_label("theirs").check()
    page.get_by_role("button", name="Go on with this").click()
    page.locator("#merge-said").filter(has_not_text=asked).wait_for()
    page.get_by_role("button", name="Go on with this").click()
    wait_until(lambda: [saved(api, job, name, time_ns)["version"] for time_ns in (HERE, NEXT)] == [3, 3])
    buses = [
        sum(one["class"] == "bus" for one in saved(api, job, name, time_ns)["labels"]["vehicles"])
        for time_ns in (HERE, NEXT)
    ]
    assert sorted(buses) == [0, 1], "theirs stands in the one that it was said of"
    labelling.forgive("ERR_FAILED")
    labelling.forgive("status of 412")


def test_what_is_saved_while_its_instant_is_opened_again_is_shown(
    api: LiveApi, labelling: Visit, job: str, name: str
) -> None:
    """Left unsaved, it is saved once the service answers, which was after the labels to show were read."""
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    before = np.array(saved(api, job, name, HERE)["labels"]["vehicles"][0]["box"])
    no_saving(labelling)
    page.keyboard.press("Shift+ArrowUp")
    page.get_by_text("not saved").wait_for()
    choose(labelling, NEXT)
    page.get_by_text("not labelled yet").wait_for()
    page.unroute_all()
    waiting: list[Any] = []

    def read(route: Any) -> None:
        if route.request.method == "PUT":
            route.fallback()
        else:
            waiting.append((route, route.fetch()))

    page.route(f"**/labels/instants/{HERE}?*", read)
    choose(labelling, HERE)
    wait_for(labelling, waiting)
    page.wait_for_timeout(RETRIED_MS)
    route, answer = waiting[0]
    route.fulfill(response=answer)
    page.get_by_text("version 1 by anna").or_(page.get_by_text("saved as version 2")).wait_for()
    page.keyboard.press("Shift+ArrowUp")
    far = 0.0
    for _ in range(600):
        far = float(np.hypot(*(np.array(saved(api, job, name, HERE)["labels"]["vehicles"][0]["box"]) - before)[:2]))
        if far > 0.75:
            break
        page.wait_for_timeout(100)
    assert far == pytest.approx(1), "half a metre before it was opened again, and half a metre since"
    labelling.forgive("ERR_FAILED")


def test_while_an_instant_is_loading_nothing_that_was_made_is_lost(
    api: LiveApi, labelling: Visit, job: str, name: str
) -> None:
    """Copies, corners that are drawn or typed, and the vehicle that is to be placed."""
    page = labelling.page
    page.keyboard.press("p")
    page.get_by_text("saved as version 1").wait_for()
    page.locator("summary", has_text="Regions").click()
    waiting = held(labelling, f"**/{NEXT}/proposal")
    page.keyboard.press("c")
    wait_for(labelling, waiting)
    page.keyboard.press("c")
    refused = page.get_by_text("nothing can be changed until the instant is loaded")
    refused.wait_for()
    page.locator("#saved").evaluate("said => { said.textContent = ''; }")
    plan = page.get_by_label("Labelled vehicles from above")
    page.keyboard.press("n")
    plan.click(position={"x": 130, "y": 130})
    refused.wait_for()
    page.keyboard.press("n")
    page.keyboard.press("b")
    for x, y in ((100, 100), (160, 100), (160, 160)):
        plan.click(position={"x": x, "y": y})
    page.keyboard.press("Enter")
    corners = page.get_by_role("textbox", name="Corners")
    corners.fill("0,0; 5,0; 5,5")
    page.keyboard.press("Enter")
    assert corners.input_value() == "0,0; 5,0; 5,5"
    assert len(waiting) == 1
    waiting[0].continue_()
    page.get_by_text("saved as version 1").wait_for()
    page.keyboard.press("Enter")
    page.get_by_text("saved as version 2").wait_for()
    corners.blur()
    page.keyboard.press("Enter")
    page.get_by_text("saved as version 3").wait_for()
    labels = saved(api, job, name, NEXT)["labels"]
    assert len(labels["vehicles"]) == 2
    assert [len(one["polygon"]) for one in labels["regions"]] == [3, 3]
