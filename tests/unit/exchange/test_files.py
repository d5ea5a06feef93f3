"""Files of others are bounded, and their names lead nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest

from wibam_core.errors import InputError, NotFound
from wibam_core.exchange.base import Content, Part, parse_image_name, require_parts
from wibam_core.exchange.coco import Coco
from wibam_core.exchange.files import read_bytes, read_text, within
from wibam_core.exchange.registry import FORMATS, format_of


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b"0123456789")
    assert read_bytes(tmp_path / "a.json", 10) == b"0123456789"
    with pytest.raises(InputError, match=r"a\.json has 10 bytes"):
        read_bytes(tmp_path / "a.json", 9)


def test_what_is_no_file_or_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no file none"):
        read_text(tmp_path / "none")
    with pytest.raises(InputError, match="there is no file"):
        read_text(tmp_path)
    (tmp_path / "a.txt").write_bytes(b"\xff")
    with pytest.raises(InputError, match=r"a\.txt: it is not in UTF-8"):
        read_text(tmp_path / "a.txt")


@pytest.mark.parametrize("name", ["../secret", "a/../../secret", "/etc/passwd", "link/secret", "a\0b"])
def test_no_name_leads_out_of_its_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    with pytest.raises(InputError):
        within(folder, name)


def test_names_within_a_folder_are_followed(tmp_path: Path) -> None:
    assert within(tmp_path, "0/12.jpg") == (tmp_path / "0" / "12.jpg").resolve()


def test_image_names_say_whose_and_when() -> None:
    assert parse_image_name(Content().image_name("north", 80)) == ("north", 80)
    assert parse_image_name("somewhere/else/north/80.png") == ("north", 80)
    assert parse_image_name("frame 12.jpg") is None


def test_a_format_says_which_part_it_lacks() -> None:
    with pytest.raises(InputError, match="without 2D boxes"):
        require_parts(Coco(), Content(labels=[]))
    assert Content(labels=[]).parts == {Part.LABELS}


@pytest.mark.parametrize("fmt", FORMATS.values(), ids=FORMATS)
def test_every_format_says_what_it_can_and_loses(fmt) -> None:
    assert fmt.needs <= fmt.writes
    assert fmt.title and fmt.loses.endswith(".")
    assert format_of(fmt.name) is fmt


def test_a_format_that_is_not_there_is_named_with_all_that_are() -> None:
    with pytest.raises(NotFound) as refused:
        format_of("dbf")
    assert "coco" in refused.value.hint
