"""Recordings that show one and the same picture for long, and such as cameras of an empty road make."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from wibam_core.video.cautions import cautions_of
from wibam_core.video.probe import probe


def recorded(path: Path, pictures: list[np.ndarray], fps: int = 5) -> Path:
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate=fps, options={"preset": "ultrafast", "crf": "26", "g": "10"})
        stream.width, stream.height, stream.pix_fmt = 160, 96, "yuv420p"
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="bgr24").reformat(format="yuv420p")
            frame.pts, frame.time_base = number, Fraction(1, fps)
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    return path


def scene(count: int, noise: float, frozen_from: int | None = None) -> list[np.ndarray]:
    """An empty road, as a sensor sees it."""
    rng = np.random.default_rng(0)
    road = rng.integers(60, 140, (96, 160, 3)).astype(float)
    made = [np.clip(road + noise * rng.standard_normal(road.shape), 0, 255).astype(np.uint8) for _ in range(count)]
    return made if frozen_from is None else [made[min(number, frozen_from)] for number in range(count)]


@pytest.mark.parametrize(("frozen_from", "from_s"), [(0, 0.0), (100, 20.0)])
def test_a_frozen_picture_is_said(tmp_path: Path, frozen_from: int, from_s: float) -> None:
    [caution] = cautions_of(probe(recorded(tmp_path / "a.mp4", scene(300, 3.0, frozen_from))))
    assert caution.code == "picture_still"
    assert from_s <= caution.details["from_s"] <= from_s + 15.0 and caution.details["to_s"] == pytest.approx(59, abs=11)


def test_an_empty_road_is_no_frozen_picture(tmp_path: Path) -> None:
    assert cautions_of(probe(recorded(tmp_path / "a.mp4", scene(300, 3.0)))) == []


def test_few_pictures_a_second_are_said(tmp_path: Path) -> None:
    assert [c.code for c in cautions_of(probe(recorded(tmp_path / "a.mp4", scene(20, 3.0), fps=2)))] == ["few_pictures"]


def test_so_many_pictures_a_second_that_stamps_look_to_be_in_another_unit_are_said(tmp_path: Path) -> None:
    [caution] = cautions_of(probe(recorded(tmp_path / "a.mp4", scene(90, 3.0), fps=750)))
    assert caution.code == "many_pictures" and "lasts for 0.1 s" in caution.message
