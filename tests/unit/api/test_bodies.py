"""Bodies that hold too much cost little: they are counted, and few of their errors are told."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from typing import Any

import pydantic
import pytest

from api.bodies import MOST_MEMBERS, MOST_VALUES, count_values
from wibam_core.errors import TooLarge
from wibam_core.site import Site

POINT = {"world": [0, 0, 0], "pixel": [1, 2]}
CAMERA = {
    "id": "c",
    "width_px": 640,
    "height_px": 360,
    "calibration": {"kind": "homography", "correspondences": [POINT]},
}


def with_cameras(cameras: list[Any]) -> dict[str, Any]:
    return {"name": "site", "cameras": cameras}


def with_points(points: list[Any]) -> dict[str, Any]:
    return with_cameras([{**CAMERA, "calibration": {"kind": "homography", "correspondences": points}}])


FLOODS: dict[str, Callable[[int], Any]] = {
    "empty cameras": lambda n: with_cameras([{}] * n),
    "numbers for cameras": lambda n: with_cameras([7] * n),
    "good cameras": lambda n: with_cameras([CAMERA] * n),
    "empty points": lambda n: with_points([{}] * n),
    "good points": lambda n: with_points([POINT] * n),
    "signals": lambda n: with_cameras([{**CAMERA, "signals": [{}] * n}]),
    "distortion": lambda n: with_cameras([{**CAMERA, "calibration": {"kind": "pnp", "dist": ["x"] * n}}]),
}


@pytest.mark.parametrize("flood", FLOODS.values(), ids=FLOODS)
def test_a_flood_is_refused_with_few_errors_and_little_memory(flood: Callable[[int], Any]) -> None:
    content = flood(11_000)
    size = len(json.dumps(content))
    count_values(content)
    Site.model_validate(with_cameras([CAMERA]))  # what is made once is not the flood's
    tracemalloc.start()
    with pytest.raises(pydantic.ValidationError) as refused:
        Site.model_validate(content)
    errors = refused.value.errors(include_input=False)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(errors) <= 20
    assert peak < 20 * size


def test_an_object_with_more_members_than_any_has_is_refused_unread() -> None:
    count_values({"cameras": [dict.fromkeys(map(str, range(MOST_MEMBERS)), 0)]})
    with pytest.raises(TooLarge, match="201 members"):
        count_values({"cameras": [dict.fromkeys(map(str, range(MOST_MEMBERS + 1)), 0)]})


def test_values_are_counted_at_all_depths() -> None:
    count_values([[0] * 1000] * (MOST_VALUES // 1001))
    with pytest.raises(TooLarge, match="300,000 values"):
        count_values([[0] * 1000] * (MOST_VALUES // 1000))


def test_numbers_that_nothing_measures_are_refused() -> None:
    far = {**CAMERA, "calibration": {"kind": "homography", "correspondences": [{**POINT, "world": [1e308, 0, 0]}]}}
    with pytest.raises(pydantic.ValidationError):
        Site.model_validate(with_cameras([far]))
