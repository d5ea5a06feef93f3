"""Signal regions as people draw and name them."""

import pytest

from wibam_core.clocks import SignalChange
from wibam_core.errors import SiteFileError
from wibam_core.site import Site
from wibam_core.sync.regions import region_cautions, unseen_cautions

HEAD = (600, 100, 18, 50)


def site(*cameras: list[tuple[str, tuple[float, ...]]]) -> Site:
    matrices = {
        "kind": "matrices",
        "K": [[1100, 0, 639.5], [0, 1100, 359.5], [0, 0, 1]],
        "rvec": [1.9, 0, 0],
        "tvec": [0, 2, 15],
    }
    listed = [
        {
            "id": f"cam{number + 1}",
            "width_px": 1280,
            "height_px": 720,
            "calibration": matrices,
            "signals": [{"id": signal_id, "region": list(region)} for signal_id, region in signals],
        }
        for number, signals in enumerate(cameras)
    ]
    made = Site.model_validate({"name": "t", "cameras": listed})
    made.check()
    return made


def codes(made: Site) -> list[str]:
    return [caution.code for caution in region_cautions(made)]


def test_heads_that_several_cameras_share_are_fine():
    assert codes(site([("a", HEAD), ("b", (700, 100, 18, 50))], [("a", HEAD), ("b", (30, 90, 20, 50))])) == []


@pytest.mark.parametrize(
    ("region", "code", "words"),
    [
        ((600, 100, 618, 150), "large_signal_region", "not two corners"),
        ((0, 0, 1280, 720), "large_signal_region", "one head"),
        ((1268, 100, 18, 50), "signal_region_cut", "another size"),
        ((-5, 100, 18, 50), "signal_region_cut", "another size"),
    ],
)
def test_a_region_that_holds_no_head_alone_is_said(region, code: str, words: str) -> None:
    [caution] = region_cautions(site([("a", HEAD)], [("a", region)]))
    assert (caution.code, caution.details["camera"]) == (code, "cam2")
    assert words in caution.hint


@pytest.mark.parametrize(
    ("region", "words"),
    [
        ((0.47, 0.14, 0.014, 0.07), "shares of its width"),
        ((600, 100, 1, 2), "x, y, width"),
        ((1279, 100, 18, 50), "x, y"),
    ],
)
def test_a_region_of_hardly_a_pixel_is_refused_with_the_site(region, words: str) -> None:
    with pytest.raises(SiteFileError, match="less than 2 x 4 px") as caught:
        site([("a", region)])
    assert words in caught.value.hint


def test_two_signals_at_one_place_are_said():
    assert codes(site([("a", HEAD), ("b", (602, 102, 18, 50))], [("a", HEAD), ("b", (30, 90, 20, 50))])) == [
        "signals_overlap"
    ]


def test_a_signal_that_no_other_camera_has_is_said_with_the_one_that_looks_like_it():
    first, second = region_cautions(site([("North", HEAD)], [("north ", HEAD)], []))
    assert first.code == second.code == "signal_alone"
    assert "'north '" in first.message and "letter by letter" in first.hint
    assert codes(site([("a", HEAD)], [])) == ["signal_alone"]


def test_signals_of_which_nothing_was_seen_are_said_by_name():
    made = site([("a", HEAD), ("b", (700, 100, 18, 50)), ("c", (800, 100, 18, 50))], [("a", HEAD)])
    seen = [SignalChange("cam1", name, 10**9, "red", "green", 0.9, 20_000_000) for name in ("a", "b", "b")]
    clear = [change for change in seen if change.signal_id == "a"]
    found = unseen_cautions(made, {"cam1": seen}, {"cam1": clear})
    assert [(caution.code, caution.details["signal"]) for caution in found] == [
        ("signal_unseen", "b"),
        ("signal_unseen", "c"),
    ]
    assert "2 light changes, none of them clear" in found[0].message and "no light change" in found[1].message
