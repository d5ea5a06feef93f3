"""Text files as editors on any system save them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import site_of
from wibam_core.errors import InvalidLabels, SiteFileError
from wibam_core.formats.labels import read_labels
from wibam_core.site import Site
from wibam_core.text import NotJson, NotUnicode, decode_text, read_json

ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-le", "utf-32-be")
NAME = "Knotenpunkt Süd, 交差点"
LABELS = [
    {
        "time_ns": 1,
        "class": "car",
        "x_m": 0,
        "y_m": 0,
        "z_m": 0.7,
        "length_m": 4.4,
        "width_m": 1.8,
        "height_m": 1.4,
        "yaw_rad": 0,
        "visibility": {"Süd": 1},
    }
]


@given(text=st.text(st.characters(codec="utf-8", exclude_characters="\0\ufeff")), encoding=st.sampled_from(ENCODINGS))
def test_law_text_that_begins_in_ascii_comes_back(text: str, encoding: str) -> None:
    assert decode_text(("{}" + text).encode(encoding)) == "{}" + text


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_sites_and_labels_are_read_in_any_unicode(tmp_path: Path, encoding: str) -> None:
    site = tmp_path / "site.json"
    site.write_bytes(site_of(name=NAME).model_dump_json().encode(encoding))
    assert Site.load(site).name == NAME
    labels = tmp_path / "labels.json"
    labels.write_bytes(json.dumps(LABELS, ensure_ascii=False).encode(encoding))
    assert list(read_labels(labels)[0].visibility) == ["Süd"]


def test_other_encodings_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "site.json"
    path.write_bytes(site_of(name="Knotenpunkt Süd").model_dump_json(indent=1).encode("cp1252"))
    with pytest.raises(SiteFileError, match="such as Windows-1252: line 2 has the byte 0xfc") as refused:
        Site.load(path)
    assert "UTF-8" in refused.value.hint
    path.write_bytes(json.dumps(LABELS, ensure_ascii=False).encode("cp1252"))
    with pytest.raises(InvalidLabels, match="such as Windows-1252") as refused_labels:
        read_labels(path)
    assert "UTF-8" in refused_labels.value.hint


@pytest.mark.parametrize("content", [b"\x89PNG\0\xff\xd8", b"\xff\xfe\0"])
def test_what_is_no_text_is_said_to_be_none(content: bytes) -> None:
    with pytest.raises(NotUnicode, match="it is no text"):
        decode_text(content)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"a": 1, "b": {"c": 2, "c": 3}}', "an object has 'c' twice"),
        ('{\n "a": 1, // metres\n "b": 2}', "line 2, column 10: JSON has no comments"),
        ('{"a": [1, 2,]}', "a comma too many"),
        ("{'a': 1}", "double quotes"),
        ("", "Expecting value"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a": [1,\n', "line 2, column 1: Expecting value"),
        ('{"a": 1' + "0" * 5000 + "}", "a number that is too long"),
    ],
)
def test_what_is_wrong_with_json_is_said_with_its_place(text: str, words: str) -> None:
    with pytest.raises(NotJson, match=re.escape(words)):
        read_json(text)


def test_a_name_that_is_there_twice_is_found_in_one_pass() -> None:
    names = ", ".join(f'"{number}": 0' for number in range(200_000))
    with pytest.raises(NotJson, match="'199999' twice"):
        read_json("{" + names + ', "199999": 1}')  # in hours, if each were compared with each


def test_a_site_that_says_one_thing_twice_is_refused() -> None:
    text = site_of().model_dump_json()
    assert Site.parse(text) == site_of()
    with pytest.raises(SiteFileError, match="'name' twice"):
        Site.parse(text[:-1] + ', "name": "other"}')
