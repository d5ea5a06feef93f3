"""The table of conflicts as PDF: everything is in it, on pages that hold it."""

from __future__ import annotations

import re
import zlib
from typing import Any

import pytest

from tests.unit.report.documents import conflicts_json
from wibam_core.documents.conflicts import Conflicts
from wibam_core.report.conflict_table import conflict_table


def conflicts(count: int, **changes: Any) -> Conflicts:
    document = conflicts_json()
    [first] = document["conflicts"]
    rows = [{**first, "conflict_id": k, "time_ns": k * 61_500_000_000, **changes} for k in range(count)]
    return Conflicts.model_validate({**document, "conflicts": rows})


def pages_of(pdf: bytes) -> list[str]:
    """The words of each page, a line for each text: strings of its content, without the kerning between their parts.

    The embedded font's codes are those of UTF-16 where the letters are Latin.
    """
    found = []
    for packed in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL):
        try:
            content = zlib.decompress(packed).decode("latin-1")
        except zlib.error:
            continue
        if "BT" not in content:
            continue
        lines = []
        for text in re.findall(r"\nBT\n(.*?)\nET\n", content, re.DOTALL):
            codes = "".join(re.findall(r"\(((?:\\.|[^\\)])*)\)", text, re.DOTALL))
            lines.append(re.sub(r"\\(.)", r"\1", codes, flags=re.DOTALL).encode("latin-1").decode("utf-16-be"))
        found.append("\n".join(lines))
    return found


def test_the_table_says_what_is_known_of_each_conflict_and_what_people_said() -> None:
    reviews = {0: ("confirmed", "braked hard (late)"), 2: ("rejected", "$a parked^car$")}
    [page] = pages_of(conflict_table("Monday", "Site Crossing · job_1", conflicts(3), reviews))
    lines = page.splitlines()
    for words in ("Monday", "crossing", "car 1, van 3", "1.27 [0.90, 1.80]", "97 %", "8.0, 7.0", "3.4"):
        assert words in lines, words
    assert "braked hard (late)" in lines and "$a parked^car$" in lines, "no formula is made of it"
    assert "Reviewed: 1 confirmed, 1 rejected, 1 not yet." in page
    assert ("0:00.0" in lines, "1:01.5" in lines, "2:03.0" in lines) == (True, True, True)


def test_without_reviews_nothing_is_said_of_them() -> None:
    [page] = pages_of(conflict_table("Monday", "", conflicts(1), None))
    assert "Review" not in page and "not yet" not in page


def test_many_conflicts_and_long_notes_go_over_several_pages_and_none_is_lost() -> None:
    note = " ".join(f"word{k}" for k in range(330))
    pages = pages_of(
        conflict_table("Long", "", conflicts(120), {7: ("confirmed", note), 119: ("rejected", "x" * 2000)})
    )
    text = "\n".join(pages)
    assert len(pages) > 4
    assert [f"page {k + 1} of {len(pages)}" in page for k, page in enumerate(pages)] == [True] * len(pages)
    times = re.findall(r"^(\d+):(\d\d\.\d)$", text, re.MULTILINE)
    assert [int(m) * 60 + float(s) for m, s in times] == pytest.approx([61.5 * k for k in range(120)])
    assert [f"word{k}" for k in range(330)] == re.findall(r"word\d+", text)
    assert sum(map(len, re.findall(r"^x+$", text, re.MULTILINE))) == 2000
    assert all(page.splitlines().count("Road users") == 1 for page in pages), "each page has the titles"


def test_no_conflict_is_a_page_that_says_so() -> None:
    [page] = pages_of(conflict_table("Quiet", "", conflicts(0), {}))
    assert "0 conflicts." in page


def test_the_same_table_gives_the_same_bytes_and_control_characters_go() -> None:
    one, other = (conflict_table("A\x00\x1b", "b", conflicts(2), {0: ("confirmed", "a\tb\nc\x07")}) for _ in range(2))
    assert one == other
    assert one.startswith(b"%PDF-")


def test_times_before_the_reference_cameras_clock_begins_have_a_sign() -> None:
    def shown(time_ns: int) -> list[str]:
        [page] = pages_of(conflict_table("Early", "", conflicts(1, time_ns=time_ns), None))
        return re.findall(r"^-?\d+:\S+$", page, re.MULTILINE)

    assert shown(-1_000_000_000) == ["-0:01.0"]
    assert shown(-61_540_000_000) == ["-1:01.5"]
    assert shown(-40_000_000) == ["0:00.0"]


def test_notes_of_nothing_but_line_ends_take_no_pages() -> None:
    reviews = dict.fromkeys(range(30), ("confirmed", "seen" + "\n" * 1990 + "twice"))
    pages = pages_of(conflict_table("Empty lines", "", conflicts(30), reviews))
    assert len(pages) == 2
    assert [sum(page.splitlines().count(word) for page in pages) for word in ("seen", "twice")] == [30, 30]


def test_blanks_of_all_widths_are_spaces() -> None:
    reviews = {0: ("confirmed", "5\u202fm/s,\u00a0then\u3000none")}
    [page] = pages_of(conflict_table("Two\u00a0words", "", conflicts(1), reviews))
    assert "5 m/s, then none" in page.splitlines()
    assert "Two words" in page.splitlines()
