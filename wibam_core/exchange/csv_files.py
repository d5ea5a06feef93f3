"""Comma-separated files: written row by row, read into checked columns."""

from __future__ import annotations

import csv
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
    content = files.read_bytes(path)
    try:
        table = arrow_csv.read_csv(pa.BufferReader(content))
    except pa.ArrowInvalid as cause:
        raise files.wrong(path, "the table", str(cause)) from cause
    table = tables.conform(table, schema, path.name, what)
    for column in schema:
        if pa.types.is_floating(column.type) and not (np.abs(table[column.name].to_numpy()) <= _LARGEST).all():
            raise files.wrong(path, column.name, f"has a value that is no number, or beyond {_LARGEST:g}")
    return table
