"""The cross on a canvas, for whoever came there by keys: where it is, Enter clicks, and nowhere else."""

from __future__ import annotations

from tests.browser.conftest import Visit, drawn
from tests.browser.test_site_pages import make_site


def test_enter_does_what_a_click_does_and_the_cross_is_drawn_where_it_does_anything(signed_in: Visit) -> None:
    make_site(signed_in, "modes")
    page = signed_in.page
    page.get_by_role("link", name="Calibrate and signals").first.click()
    page.get_by_text("0 of at least 4 points").wait_for()
    frame, points = page.locator("#frame"), page.locator("#points tbody tr")
    frame.blur()
    without = drawn(page, "#frame")
    for mode, has_cross, sets in (("signal region", False, 0), ("length", True, 0), ("sets a point", True, 1)):
        page.get_by_label(mode).check()
        page.keyboard.press("Shift")  # from a key on, the browser marks what has the focus
        frame.focus()
        assert frame.evaluate("frame => frame.matches(':focus-visible')")
        assert (drawn(page, "#frame") != without) == has_cross, mode
        page.keyboard.press("Enter")
        assert points.count() == sets, mode
    page.get_by_text("lengths can be measured once the camera is solved").wait_for()
