"""Conflicts are filtered by what they are, and opened from the heat map."""

from __future__ import annotations

import re

import pytest

from tests.browser.conftest import Visit
from tests.finished import CONFLICT, finished_job
from tests.service import LiveApi


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


@pytest.mark.parametrize(
    ("label", "fits", "does_not"),
    [("TTC at most", "1.25", "1.2"), ("Probability at least", "0.9", "0.95"), ("PET at most", None, "9")],
)
def test_a_limit_counts_in_itself(signed_in: Visit, job: str, label: str, fits: str | None, does_not: str) -> None:
    """The conflict has a time to collision of 1.25 s, a probability of 0.9 and no post-encroachment time."""
    page = signed_in.open(f"/jobs/{job}/conflicts")
    page.get_by_text("1 of 1 conflicts").wait_for()
    page.get_by_label(label).fill(does_not)
    page.get_by_text("0 of 1 conflicts").wait_for()
    page.get_by_text("No conflict is like that").wait_for()
    if fits:
        page.get_by_label(label).fill(fits)
        page.get_by_text("1 of 1 conflicts").wait_for()


def test_conflicts_are_filtered_by_type_and_by_class(signed_in: Visit, api: LiveApi) -> None:
    kinds = (("crossing", ("car", "bus")), ("rear_end", ("car", "car")), ("rear_end", ("truck", "bus")))
    conflicts = [
        CONFLICT.model_copy(update={"conflict_id": number, "type": kind, "classes": classes})
        for number, (kind, classes) in enumerate(kinds)
    ]
    page = signed_in.open(f"/jobs/{finished_job(api, b'of several kinds', conflicts=conflicts)}/conflicts")
    page.get_by_text("3 of 3 conflicts").wait_for()
    numbers = page.locator("#conflicts tbody th small")
    for kind, of_class, found in (
        ("rear_end", "", "12"),
        ("rear_end", "bus", "2"),
        ("", "bus", "02"),
        ("", "car", "01"),
    ):
        page.locator("#type").select_option(kind)
        page.locator("#class").select_option(of_class)
        assert numbers.all_inner_texts() == [f"no. {number}" for number in found]
    page.locator("#type").select_option("crossing")
    page.locator("#class").select_option("truck")
    page.get_by_text("No conflict is like that").wait_for()


def test_a_mark_on_the_heat_map_opens_the_player_at_its_moment(signed_in: Visit, job: str) -> None:
    """The conflict lies alone with one camera, so that the plan is fitted to the two."""
    page = signed_in.open(f"/jobs/{job}/conflicts")
    page.get_by_text("1 of 1 conflicts").wait_for()
    canvas = page.locator("#heat")
    place = canvas.bounding_box()
    assert place is not None
    x, y = page.evaluate(
        """async ([job]) => {
          const { Plan } = await import("/static/js/plan.js");
          const { Camera } = await import("/static/js/projection.js");
          const scene = await (await fetch(`/v1/jobs/${job}/scene`)).json(), shown = document.getElementById("heat");
          const canvas = document.createElement("canvas");
          [canvas.width, canvas.height] = [shown.width, shown.height];
          const plan = new Plan(canvas, () => {});
          plan.fit([[20, 2.5], ...scene.cameras.map((one) => new Camera(one).centre)], 0.12);
          const [u, v] = plan.toCanvas([20, 2.5]);
          return [u / canvas.width, v / canvas.height];
        }""",
        [job],
    )
    canvas.click(position={"x": x * place["width"], "y": y * place["height"]})
    page.wait_for_url(re.compile("/player\\?conflict=0$"))
    page.get_by_text("Conflict 0: crossing").wait_for()
    assert page.locator("#clock").inner_text() == "0:02.0"
