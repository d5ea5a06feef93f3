"""Comma-separated files: written row by row, read into checked columns.

Spreadsheets of many countries write semicolons between the columns, since their decimal mark is the comma; others
write tabs. All of these are read, and told by the names of the columns and by the numbers themselves.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from wibam_core.exchange import files
from wibam_core.formats import tables

#: Decimals of metres, degrees and their rates in text: finer than anything that is measured.
DECIMALS = 6
#: Far beyond all that is measured, and far below what overflows when it is added up.
_LARGEST = 1e9
#: So much of a table shows which decimal mark it has.
_LOOKED_AT = 1 << 24
#: A cell that is a number with the one decimal mark or the other.
_DECIMALS_WITH = {
    mark: re.compile(rf"^\"?[+-]?\d+{re.escape(mark)}\d+(?:[eE][+-]?\d+)?\"?\r?$", re.MULTILINE) for mark in ".,"
}


def write_columns(path: Path, columns: Mapping[str, Sequence[Any] | np.ndarray]) -> None:
    """Write columns of equal length under a line with their names; floats are rounded to `DECIMALS`, NaN is empty."""
    ready = [_texts(column) for column in columns.values()]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*ready, strict=True))


def _texts(column: Sequence[Any] | np.ndarray) -> list[Any]:
    values = np.asarray(column)
    if values.dtype.kind != "f":
        return values.tolist()
    return ["" if np.isnan(value) else value for value in (np.round(values, DECIMALS) + 0.0).tolist()]


def read_columns(path: Path, schema: pa.Schema, what: str) -> pa.Table:
    """Read the columns of ``schema``; others are ignored.

    Raises:
        InputError: the file is missing, too large or no such table; a column is missing or mistyped, or holds what
            cannot be measured.
    """
    text = files.read_text(path)
    delimiter = _delimiter(text.partition("\n")[0])
    parse = arrow_csv.ParseOptions(delimiter=delimiter)
    convert = arrow_csv.ConvertOptions(decimal_point=_decimal_mark(path, text, delimiter))
    try:
        table = arrow_csv.read_csv(pa.BufferReader(text.encode()), parse_options=parse, convert_options=convert)
    except pa.ArrowInvalid as cause:
        raise files.wrong(path, "the table", str(cause)) from cause
    table = tables.conform(table, schema, path.name, what)
    for column in schema:
        if pa.types.is_floating(column.type) and not (np.abs(table[column.name].to_numpy()) <= _LARGEST).all():
            raise files.wrong(path, column.name, f"has a value that is no number, or beyond {_LARGEST:g}")
    return table


def read_numbers(line: str) -> list[float]:
    """The numbers of one line of a table without names.

    Raises:
        ValueError: it holds something else.
    """
    delimiter = _delimiter(line)
    cells = line.split(delimiter)
    return [float(cell if delimiter == "," else cell.replace(",", ".")) for cell in cells]


def _delimiter(line: str) -> str:
    """What stands between the columns of a line."""
    return max((",", ";", "\t"), key=lambda mark: (mark != "," and mark in line, line.count(mark)))


def _decimal_mark(path: Path, text: str, delimiter: str) -> str:
    """The decimal mark of a table's numbers.

    Raises:
        InputError: some have a point and some have a comma.
    """
    if delimiter == ",":
        return "."
    marks = {
        mark for mark, pattern in _DECIMALS_WITH.items() if pattern.search(text[:_LOOKED_AT].replace(delimiter, "\n"))
    }
    if len(marks) == 2:
        raise files.wrong(path, "the numbers", "some have a decimal point and some a decimal comma")
    return marks.pop() if marks else "."
