"""Lenses that are solved from points, and recordings whose pixels are not square."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest

from tests.foreign_recordings import write
from tests.unit.stages.reading import Run
from wibam_core.config import PreflightConfig
from wibam_core.errors import InputError
from wibam_core.site import HomographyCalibration, MatrixCalibration, Site, SiteCamera
from wibam_core.stages import preflight

K = ((200.0, 0.0, 119.5), (0.0, 200.0, 89.5), (0.0, 0.0, 1.0))


def preflighted(tmp_path: Path, size: tuple[int, int], aspect: Fraction | None, calibration) -> list[str]:  # type: ignore[no-untyped-def]
    def prepare(stream) -> None:  # type: ignore[no-untyped-def]
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect

    stored = (240, 180) if size in ((240, 180), (320, 180)) else size
    path = write(tmp_path / "a.mp4", range(30), size=stored, prepare=prepare)
    run = Run(tmp_path / "run", {"cam1": path})
    camera = SiteCamera(id="cam1", width_px=size[0], height_px=size[1], calibration=calibration)
    run.site = Site(name="t", cameras=(camera,))
    preflight.run(run.of("preflight"), PreflightConfig(min_overlap_s=0.5))
    return [warning.code for warning in run.warnings]


def homography(aspect: float = 1.0) -> HomographyCalibration:
    return HomographyCalibration(correspondences=(), pixel_aspect=aspect)


def test_a_focal_length_solved_for_square_pixels_is_refused_where_they_are_not(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"square, and those of its recording are 1\.333 times") as caught:
        preflighted(tmp_path, (240, 180), Fraction(4, 3), homography())
    assert '"pixel_aspect": 1.333' in caught.value.hint and "320x180 px" in caught.value.hint


@pytest.mark.parametrize(
    ("calibration", "said"),
    [
        (homography(4 / 3), ["pixels_not_square"]),
        (MatrixCalibration(K=K, rvec=(1.9, 0, 0), tvec=(0, 2, 15)), ["pixels_not_square"]),
        (homography(1.5), ["pixels_not_square", "pixel_aspect"]),
    ],
)
def test_what_a_calibration_says_of_its_pixels_is_believed(tmp_path: Path, calibration, said: list[str]) -> None:  # type: ignore[no-untyped-def]
    assert preflighted(tmp_path, (240, 180), Fraction(4, 3), calibration) == said


def test_pictures_of_the_size_that_players_show_have_square_pixels(tmp_path: Path) -> None:
    assert preflighted(tmp_path, (320, 180), Fraction(4, 3), homography()) == []
    with pytest.raises(InputError, match="is stretched to the size that players show"):
        preflighted(tmp_path, (320, 180), Fraction(4, 3), homography(4 / 3))


def test_a_size_that_hardly_has_square_pixels_is_said_where_the_file_tells_nothing(tmp_path: Path) -> None:
    assert preflighted(tmp_path, (352, 288), None, homography()) == ["pixels_perhaps_not_square"]
    assert preflighted(tmp_path, (352, 288), None, homography(12 / 11)) == []
    assert preflighted(tmp_path, (320, 240), None, homography()) == []
