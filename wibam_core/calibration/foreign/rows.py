"""Tables of text as programs and spreadsheets write them: a line of names, then rows."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from wibam_core.errors import InputError

_COMMENTS = ("#", "//", "%")
#: What people write behind a name: a unit, in brackets or behind an underscore.
_UNIT = re.compile(r"[\s_]*[\[(][^\])]*[\])]\s*$|_(?:m|px|deg)$")
_BRACKETED = re.compile(r"[\[(]([^\])]*)[\])]\s*\"?\s*$")
#: Degrees, minutes and seconds, or degrees of a hemisphere.
_DEGREES = re.compile(r"[+-]?\d{1,3}(?:[:\s]\d{1,2}){1,2}(?:[.,]\d*)?\s*[NSEWO]?|[NSEWO]\s*[\d.,]+|[\d.,]+\s*[NSEWO]")


@dataclass(frozen=True)
class Rows:
    """A table.

    Attributes:
        names: of the columns, in lower case, without their units.
        rows: (line in the file, column name -> text) of each that is not empty.
        units: column name -> what stands in brackets behind it, in lower case, where something does.
        crs: what a line ``#CRS: ...`` says; "" without one.
        decimal_commas: numbers may have a decimal comma, since the columns are told apart by something else.
    """

    names: tuple[str, ...]
    rows: Sequence[tuple[int, Mapping[str, str]]]
    units: Mapping[str, str]
    crs: str
    decimal_commas: bool

    def number(self, line: int, row: Mapping[str, str], name: str) -> float:
        """A number of a row.

        Raises:
            InputError: it is none, or its thousands are set apart.
        """
        text = row.get(name, "").strip()
        plain = text.replace(",", ".") if self.decimal_commas and "." not in text and text.count(",") == 1 else text
        try:
            return float(plain)
        except ValueError as error:
            hint = "Give plain numbers, such as 5334567.25."
            if re.fullmatch(r"[+-]?\d{1,3}(?:[.,'\u2019\s\u00a0\u202f]\d{3})+(?:[.,]\d*)?", text):
                raise InputError(f"line {line}, {name}: {text!r} has its thousands set apart", hint=hint) from error
            if "°" in text or _DEGREES.fullmatch(text):
                hint = "Give decimal degrees, such as 48.137154 and -0.127758, south and west negative."
            raise InputError(f"line {line}, {name}: {text!r} is no number", hint=hint) from error


def header_of(text: str) -> tuple[str, ...]:
    """The names in the first line that is no comment, in lower case, without their units; () where there is none."""
    return tuple(_plain(name) for name in _header(text))


def _header(text: str) -> list[str]:
    line = next((line for _, line in _lines(text)), "")
    with suppress(csv.Error):
        return _cells(line, _delimiter(line))
    return []


def read_rows(text: str) -> Rows:
    """Read a table of columns set apart by commas, semicolons, tabs or blanks; lines that are comments are passed over.

    Raises:
        InputError: a row is longer than the line of names, or a quotation does not end.
    """
    lines = _lines(text)
    names = header_of(text)
    delimiter = _delimiter(lines[0][1]) if lines else ","
    rows = []
    for number, line in lines[1:]:
        try:
            cells = _cells(line, delimiter)
        except csv.Error as error:
            raise InputError(f"line {number}: {error}", hint="Save the table again.") from error
        if len(cells) > len(names) and any(cell.strip() for cell in cells[len(names) :]):
            raise InputError(
                f"line {number} has {len(cells)} columns, the line of names has {len(names)}",
                hint="Where the decimal mark is a comma, set columns apart by semicolons or tabs.",
            )
        if any(cell.strip() for cell in cells):
            rows.append((number, dict(zip(names, cells, strict=False))))
    said = re.search(r"^#\s*CRS\s*:\s*(.*?)\s*$", text, re.IGNORECASE | re.MULTILINE)
    crs = said[1] if said else ""
    bracketed = ((_plain(name), _BRACKETED.search(name)) for name in _header(text))
    units = {name: found[1].strip().lower() for name, found in bracketed if found}
    return Rows(names, rows, units, crs, delimiter != ",")


def _lines(text: str) -> list[tuple[int, str]]:
    return [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith(_COMMENTS)
    ]


def _delimiter(line: str) -> str:
    if not any(mark in line for mark in (",", ";", "\t")) and len(line.split()) > 1:
        return " "
    return max((",", ";", "\t"), key=lambda mark: (mark != "," and mark in line, line.count(mark)))


def _cells(line: str, delimiter: str) -> list[str]:
    """Raises:
    csv.Error: a quotation does not end.
    """
    return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter, strict=True), [])


def _plain(name: str) -> str:
    """Of two names for one column, as Metashape's ``X/Easting``, the second, which says more."""
    return _UNIT.sub("", name.strip().strip('"').lower()).rpartition("/")[2].strip()
