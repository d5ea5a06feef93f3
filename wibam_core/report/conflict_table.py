"""The table of a job's conflicts with what people said of each, as a PDF file of A4 pages."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from wibam_core.documents.conflicts import ConflictRow, Conflicts
from wibam_core.report.style import GRID, INK, MUTED, printable
from wibam_core.report.words import braking, interval, number, percent

_MM_PER_INCH, _MM_PER_POINT = 25.4, 25.4 / 72
_PAGE_MM = (297.0, 210.0)
_MARGIN_MM = 12.0
_FONT_PT, _HEADING_PT = 7.0, 13.0
#: A line of text, and what a row has above and beneath its lines.
_LINE_MM, _PAD_MM = 3.3, 1.4
#: The width of a character as a share of the font's size: wide enough that wrapped text stays in its column.
_CHARACTER = 0.6
#: Lines of one row at most; what is left of a longer note is a row of its own, so that every row fits on a page.
_MOST_LINES = 25
#: Verdict and note of a conflict that nobody has judged.
_NOT_REVIEWED = ("not yet", "")


@dataclass(frozen=True)
class _Column:
    title: str
    width_mm: float
    is_number: bool = False


_COLUMNS = (
    _Column("No.", 10, True),
    _Column("Time", 17, True),
    _Column("Type", 20),
    _Column("Road users", 40),
    _Column("TTC, s", 31, True),
    _Column("PET, s", 31, True),
    _Column("Probability", 18, True),
    _Column("Speeds, m/s", 20, True),
    _Column("DRAC, m/s²", 18, True),
)
_REVIEW_COLUMNS = (_Column("Review", 17), _Column("Note", 51))

_Row = tuple[tuple[str, ...], ...]
"""The lines of each cell of a row."""


def conflict_table(
    heading: str, about: str, document: Conflicts, reviews: Mapping[int, tuple[str, str]] | None
) -> bytes:
    """The PDF file; the same table gives the same bytes.

    Letters that the font, DejaVu Sans, does not have are empty boxes.

    Args:
        heading: the name of the job.
        about: what else tells which job it is, in a line.
        document: its conflicts.
        reviews: conflict id -> verdict and note, of those that were judged; None for a table without these columns.
    """
    columns = _COLUMNS if reviews is None else (*_COLUMNS, *_REVIEW_COLUMNS)
    rows = [row for one in document.conflicts for row in _rows(_cells(one, reviews), columns)]
    head = [printable(heading), printable(about), *_wrapped(_words(document, reviews), _PAGE_MM[0] - 2 * _MARGIN_MM)]
    pages = list(_pages(rows, len(head)))
    buffer = io.BytesIO()
    metadata = {"Title": printable(heading), "Creator": "WIBAM", "Producer": None, "CreationDate": None}
    with mpl.rc_context({"pdf.fonttype": 42}), PdfPages(buffer, metadata=metadata) as file:
        for place, of_page in enumerate(pages):
            sheet = _Sheet(columns, head if place == 0 else [])
            for row in of_page:
                sheet.add(row)
            sheet.foot(f"{printable(heading)} · page {place + 1} of {len(pages)}")
            file.savefig(sheet.figure)
    return buffer.getvalue()


def _words(document: Conflicts, reviews: Mapping[int, tuple[str, str]] | None) -> str:
    """What the table is of, in sentences."""
    count = len(document.conflicts)
    sentences = [f"{count} conflict{'' if count == 1 else 's'}."]
    if reviews is not None:
        verdicts = [reviews.get(one.conflict_id, _NOT_REVIEWED)[0] for one in document.conflicts]
        said = ", ".join(f"{verdicts.count(name)} {name}" for name in ("confirmed", "rejected"))
        sentences.append(f"Reviewed: {said}, {verdicts.count(_NOT_REVIEWED[0])} not yet.")
    thresholds = {"TTC": document.thresholds.get("ttc_s"), "PET": document.thresholds.get("pet_s")}
    told = " and ".join(f"{name} {value:g} s" for name, value in thresholds.items() if value is not None)
    if told:
        sentences.append(f"Thresholds: {told}. Brackets are 90 % intervals.")
    if document.exposure is not None:
        seen = document.exposure
        sentences.append(
            f"Told of {seen.area_m2:.0f} m², where road users spent {60 * seen.road_user_hours:.1f} minutes and went "
            f"{seen.road_user_km:.1f} km in {60 * seen.hours:.1f} minutes of recording."
        )
    return " ".join(sentences)


def _cells(one: ConflictRow, reviews: Mapping[int, tuple[str, str]] | None) -> tuple[str, ...]:
    cells = (
        str(one.conflict_id),
        _clock(one.time_ns),
        one.type.replace("_", " "),
        ", ".join(f"{name} {track}" for name, track in zip(one.classes, one.track_ids, strict=True)),
        interval(one.ttc_s, one.ttc_interval_s),
        interval(one.pet_s, one.pet_interval_s),
        percent(one.probability),
        ", ".join(number(speed, 1) for speed in one.speeds_mps),
        braking(None if one.ttc_s is None else one.deceleration_mps2),
    )
    return cells if reviews is None else (*cells, *reviews.get(one.conflict_id, _NOT_REVIEWED))


def _clock(time_ns: int) -> str:
    """Minutes and seconds on the reference camera's clock; what another camera saw earlier has times before 0."""
    time_s = round(time_ns / 1e9, 1)
    minutes, seconds = divmod(abs(time_s), 60)
    sign = "-" if time_s < 0 else ""
    return f"{sign}{minutes:.0f}:{seconds:04.1f}"


def _rows(cells: Sequence[str], columns: Sequence[_Column]) -> Iterator[_Row]:
    """A row, and more where one of its cells has too many lines."""
    lines = [tuple(_wrapped(cell, column.width_mm - 2)) for cell, column in zip(cells, columns, strict=True)]
    for start in range(0, max(map(len, lines)), _MOST_LINES):
        yield tuple(of_cell[start : start + _MOST_LINES] for of_cell in lines)


def _wrapped(text: str, width_mm: float) -> list[str]:
    """Lines that are no wider, of a text that may have lines of its own; empty ones are left out."""
    characters = int(width_mm / (_FONT_PT * _MM_PER_POINT * _CHARACTER))
    parts = text.splitlines()
    return [line for part in parts for line in textwrap.wrap(printable(part.replace("\t", " ")), characters)] or [""]


def _height_mm(row: _Row) -> float:
    return 2 * _PAD_MM + _LINE_MM * max(1, *map(len, row))


def _pages(rows: Sequence[_Row], head_lines: int) -> Iterator[list[_Row]]:
    """The rows of each page; one page at least."""
    page: list[_Row] = []
    room = _Sheet.room_mm(head_lines)
    for row in rows:
        if page and _height_mm(row) > room:
            yield page
            page, room = [], _Sheet.room_mm(0)
        page.append(row)
        room -= _height_mm(row)
    yield page


class _Sheet:
    """One page that is written from the top downwards."""

    def __init__(self, columns: Sequence[_Column], head: Sequence[str]) -> None:
        self.figure = Figure(figsize=(_PAGE_MM[0] / _MM_PER_INCH, _PAGE_MM[1] / _MM_PER_INCH), facecolor="white")
        self._columns = columns
        self._down_mm = _MARGIN_MM
        for number_, line in enumerate(head):
            self._write(line, _MARGIN_MM, _HEADING_PT if number_ == 0 else _FONT_PT, is_bold=number_ == 0)
            self._down_mm += self._head_line_mm(number_)
        self._titles()

    @staticmethod
    def _head_line_mm(line: int) -> float:
        return 8.0 if line == 0 else 4.2

    @classmethod
    def room_mm(cls, head_lines: int) -> float:
        """How high all rows of a page may be."""
        head = sum(cls._head_line_mm(line) for line in range(head_lines))
        return _PAGE_MM[1] - 2 * _MARGIN_MM - head - _LINE_MM - 2 * _PAD_MM - 5.0  # of the titles, and of the foot

    def _titles(self) -> None:
        self._cells([(column.title,) for column in self._columns], colour=MUTED, is_bold=True)

    def add(self, row: _Row) -> None:
        """Write a row."""
        self._cells(row, colour=INK, is_bold=False)

    def foot(self, text: str) -> None:
        """Write the last line of the page."""
        self._down_mm = _PAGE_MM[1] - _MARGIN_MM
        self._write(text, _MARGIN_MM, 6.0, colour=MUTED)

    def _cells(self, row: Sequence[Sequence[str]], *, colour: str, is_bold: bool) -> None:
        left, top = _MARGIN_MM, self._down_mm
        for column, lines in zip(self._columns, row, strict=True):
            for place, line in enumerate(lines):
                self._down_mm = top + _PAD_MM + place * _LINE_MM
                at = left + column.width_mm - 2 if column.is_number else left
                self._write(line, at, _FONT_PT, colour=colour, is_bold=is_bold, is_number=column.is_number)
            left += column.width_mm
        self._down_mm = top + _height_mm(tuple(map(tuple, row)))
        y = 1 - self._down_mm / _PAGE_MM[1]
        ends = [_MARGIN_MM / _PAGE_MM[0], 1 - _MARGIN_MM / _PAGE_MM[0]]
        self.figure.add_artist(mpl.lines.Line2D(ends, [y, y], color=GRID, linewidth=0.6))

    def _write(
        self, text: str, x_mm: float, size: float, *, colour: str = INK, is_bold: bool = False, is_number: bool = False
    ) -> None:
        self.figure.text(
            x_mm / _PAGE_MM[0],
            1 - self._down_mm / _PAGE_MM[1],
            text,
            fontsize=size,
            color=colour,
            fontweight="bold" if is_bold else "normal",
            horizontalalignment="right" if is_number else "left",
            verticalalignment="top",
            parse_math=False,
            fontfeatures=("-liga",),  # so that "confirmed" is found by whoever searches for it
        )
