"""Everything: a folder a format, with a README that says what is there, what is lost, and what is left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.exchange_content import content
from wibam_core.errors import InputError
from wibam_core.exchange.base import Content
from wibam_core.exchange.everything import Everything
from wibam_core.exchange.registry import FORMATS
from wibam_core.site import Origin


def test_every_format_has_its_folder_and_its_lines_in_the_readme(tmp_path: Path) -> None:
    given = content()
    assert given.site is not None
    site = given.site.model_copy(update={"origin": Origin(latitude_deg=48.0, longitude_deg=11.0)})
    given = replace(given, site=site)
    *paths, readme = FORMATS["everything"].write(given, tmp_path)
    text = readme.read_text()
    others = [fmt for fmt in FORMATS.values() if fmt.name != "everything" and fmt.needs <= given.parts]
    assert {path.relative_to(tmp_path).parts[0] for path in paths} == {fmt.name for fmt in others}
    for fmt in others:
        assert f"## {fmt.title}\n" in text and fmt.loses in text
    assert "levelx/00_tracks.csv" in text and "Left out" not in text


def test_what_the_content_does_not_allow_is_left_out_with_the_reason(tmp_path: Path) -> None:
    *paths, readme = FORMATS["everything"].write(Content(tracks=content().tracks), tmp_path)
    assert {path.parent.name for path in paths} == {"levelx", "ssam"}
    text = readme.read_text()
    assert "GeoJSON (WGS 84) cannot be written without origin. Say in site.json" in text
    assert "COCO object detection cannot be written without 2D boxes" in text
    assert not (tmp_path / "coco").exists()


def test_our_own_files_are_there_as_they_are(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    own = tmp_path / "a" / "metrics.json"
    own.write_text('{"ate": 0.4}')
    folder = tmp_path / "out"
    folder.mkdir()
    *_, copy, readme = FORMATS["everything"].write(replace(content(), files={"evaluate/metrics.json": own}), folder)
    assert copy == folder / "wibam" / "evaluate" / "metrics.json"
    assert copy.read_text() == own.read_text()
    assert "- wibam/evaluate/metrics.json" in readme.read_text()


def test_a_format_of_many_files_does_not_flood_the_readme(tmp_path: Path) -> None:
    class Many:
        name, title, loses = "many", "Many files", "Nothing."
        needs = writes = frozenset()

        def write(self, content: Content, folder: Path) -> list[Path]:
            paths = [folder / f"{i:03}.txt" for i in range(100)]
            for path in paths:
                path.write_text("")
            return paths

    *paths, readme = Everything([Many()]).write(Content(), tmp_path)
    assert len(paths) == 100
    assert readme.read_text().count(".txt") == 20 and "... and 80 more" in readme.read_text()


def test_nothing_at_all_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing yet that any format holds"):
        list(FORMATS["everything"].write(Content(), tmp_path))
