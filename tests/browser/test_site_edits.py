"""A site's description is edited while others change it: nobody's change is lost, nor what was typed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from tests.browser.conftest import Visit
from tests.service import LiveApi

if TYPE_CHECKING:
    from playwright.sync_api import Page


@pytest.fixture
def site(api: LiveApi) -> str:
    return api.site(cameras=2)


def described(api: LiveApi, site: str) -> dict[str, Any]:
    found: dict[str, Any] = api.http.get(f"/v1/sites/{site}").json()["site"]
    return found


def renamed(api: LiveApi, site: str, name: str) -> None:
    assert api.http.put(f"/v1/sites/{site}", json={**described(api, site), "name": name}).status_code == 200


def open_dialog(tab: Visit, site: str) -> tuple[Page, dict[str, Any]]:
    page = tab.open(f"/sites/{site}")
    page.locator(".camera").nth(1).wait_for()
    page.get_by_role("button", name="Edit as JSON").click()
    page.locator("#edit-dialog[open]").wait_for()
    return page, json.loads(page.locator("#document").input_value())


def test_what_others_saved_while_the_dialog_was_open_is_not_overwritten(
    signed_in: Visit, api: LiveApi, site: str
) -> None:
    page, mine = open_dialog(signed_in, site)
    theirs = described(api, site)
    theirs["name"] = "theirs"
    theirs["cameras"][1]["signals"] = [{"id": "phase-s", "region": [5, 6, 20, 50]}]
    assert api.http.put(f"/v1/sites/{site}", json=theirs).status_code == 200
    mine["cameras"][0]["signals"] = [{"id": "phase-n", "region": [1, 2, 3, 4]}]
    typed = json.dumps(mine, indent=3)
    page.locator("#document").fill(typed)
    save = page.locator("#edit-dialog").get_by_role("button", name="Save")
    save.click()
    alert = page.locator("#edit-problem")
    alert.get_by_text("Somebody else has changed the site meanwhile; nothing was saved.").wait_for()
    alert.get_by_text("They changed: name, cameras[cam2].signals[phase-s]. Your text stands above.").wait_for()
    assert described(api, site) == theirs
    assert page.locator("#document").input_value() == typed
    assert json.loads(page.get_by_label("The site as it is now").input_value()) == theirs
    renamed(api, site, "theirs again")
    save.click()
    alert.get_by_text("They changed: name. Your text stands above.").wait_for()
    mine["name"] = "merged"
    page.locator("#document").fill(json.dumps(mine))
    save.click()
    page.get_by_role("heading", name="merged").wait_for()
    assert described(api, site) == mine
    signed_in.forgive("status of 412")


def test_what_cannot_be_saved_is_said_in_the_dialog_and_stays(signed_in: Visit, api: LiveApi, site: str) -> None:
    page, mine = open_dialog(signed_in, site)
    before = described(api, site)
    save, alert = page.locator("#edit-dialog").get_by_role("button", name="Save"), page.locator("#edit-problem")
    for typed, said in (
        (json.dumps(mine)[:-1], "This is not JSON"),
        (json.dumps({**mine, "cameras": []}), "cameras"),
    ):
        page.locator("#document").fill(typed)
        save.click()
        alert.locator(".message.bad", has_text=said).wait_for()
        assert page.locator("#document").input_value() == typed
    assert described(api, site) == before
    signed_in.forgive("status of 422")


def test_a_change_that_another_one_overtakes_is_made_again(signed_in: Visit, api: LiveApi, site: str) -> None:
    """Between the page's question and its answer the site is renamed."""
    page = signed_in.open(f"/sites/{site}")
    page.locator(".camera").nth(1).wait_for()
    sent: list[str] = []

    def overtake(route: Any, request: Any) -> None:
        if request.method == "PUT":
            sent.append(request.headers["if-match"])
            if len(sent) == 1:
                renamed(api, site, "theirs")
        route.continue_()

    page.route(f"**/v1/sites/{site}", overtake)
    page.get_by_label("New camera").fill("cam9")
    page.get_by_role("button", name="Add", exact=True).click()
    page.locator(".camera", has_text="cam9").wait_for()
    there = described(api, site)
    assert (there["name"], [one["id"] for one in there["cameras"]]) == ("theirs", ["cam1", "cam2", "cam9"])
    assert len(set(sent)) == 2
    signed_in.forgive("status of 412")
