"""Typed Parquet tables: the columns that vehicles in every file share, and reading with checks.

Units are in the column names. Files are compressed with zstd and sorted by time.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from wibam_core.errors import InputError
from wibam_core.geometry.box3d import BOX_FIELDS
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.text import decode_text, read_json

Array = NDArray[np.float64]

SD_FIELDS = tuple(f"sd_{name}" for name in BOX_FIELDS)

BOX_COLUMNS = [pa.field(name, pa.float64(), nullable=False) for name in BOX_FIELDS]
#: A null standard deviation is an unknown one.
SD_COLUMNS = [pa.field(name, pa.float64()) for name in SD_FIELDS]
CLASS_COLUMN = pa.field("class", pa.dictionary(pa.int8(), pa.string()), nullable=False)

_EMPTY_INSTANTS = b"wibam.empty_instants"


def float_columns(names: Sequence[str], values: Array) -> dict[str, pa.Array]:
    """Columns of ``values`` (N, len(names)); NaN becomes null where the schema allows it."""
    return {
        name: pa.array(column, type=pa.float64(), from_pandas=True)
        for name, column in zip(names, np.asarray(values, dtype=np.float64).reshape(-1, len(names)).T, strict=True)
    }


def class_column(indices: NDArray[np.int64]) -> pa.Array:
    """Class indices (N,) as a dictionary column of names."""
    return pa.DictionaryArray.from_arrays(
        pa.array(np.asarray(indices, dtype=np.int8), type=pa.int8()),
        pa.array([cls.value for cls in CLASSES], type=pa.string()),
    )


def stack_columns(table: pa.Table, names: Sequence[str]) -> Array:
    """(N, len(names)) float64 of named columns; null becomes NaN."""
    if table.num_rows == 0:
        return np.empty((0, len(names)))
    return np.stack([table[name].to_numpy().astype(np.float64) for name in names], axis=1)


def class_indices(table: pa.Table, error: type[InputError] = InputError) -> NDArray[np.int64]:
    """(N,) indices into `CLASSES` of the column ``class``.

    Raises:
        InputError: it names a class that is not in the catalogue; an ``error``.
    """
    names = table["class"].cast(pa.string()).to_pylist()
    numbers = {name: class_named(str(name), error).number for name in set(names)}
    return np.array([numbers[name] for name in names], dtype=np.int64)


def class_named(name: str, error: type[InputError] = InputError) -> RoadUserClass:
    """The class of road users that a file names.

    Raises:
        InputError: it is not in the catalogue; an ``error``.
    """
    found = next((road_user for road_user in CLASSES if road_user == name), None)
    if found is None:
        raise error(
            f"{name!r} is no class of road users that this version knows",
            hint=f"The classes are {', '.join(CLASSES)}: correct the name, or use the version that wrote the file.",
            classes=[name],
        )
    return found


def write_table(
    path: Path,
    table: pa.Table,
    *,
    empty_instants: Iterable[tuple[int, str | None]] = (),
    group_rows: int | None = None,
    notes: Mapping[bytes, bytes] = MappingProxyType({}),
) -> None:
    """Write a table.

    Args:
        path: of the file.
        table: its rows.
        empty_instants: (time_ns, camera_id) pairs that were looked at and hold nothing.
        group_rows: so many rows can be read without the others; None for the usual million.
        notes: what else the file's metadata say.
    """
    empty = json.dumps(sorted(empty_instants, key=lambda pair: (pair[0], pair[1] or ""))).encode()
    table = table.replace_schema_metadata({_EMPTY_INSTANTS: empty, **notes})
    pq.write_table(table, path, compression="zstd", row_group_size=group_rows)


def read_table(
    path: Path,
    schema: pa.Schema,
    what: str,
    error: type[InputError] = InputError,
    filters: list[tuple[str, str, int]] | None = None,
) -> tuple[pa.Table, list[tuple[int, str | None]]]:
    """Read a table and cast it to ``schema``.

    Args:
        path: the file.
        schema: what it must hold; further columns are ignored.
        what: the kind of file, for the error's sentence.
        error: the error to raise.
        filters: conditions on columns, all of which must hold, as pyarrow writes them; what cannot match is not read.

    Returns:
        The table, and its empty instants.

    Raises:
        InputError: (or ``error``) the file is no Parquet file, lacks or mistypes a column, or names its empty instants
            in no way that can be read.
    """
    try:
        table = pq.read_table(path, filters=filters)
    except (OSError, pa.ArrowInvalid) as cause:
        raise error(f"{path.name} cannot be read as Parquet: {cause}", hint=f"A {what} file is Parquet.") from cause
    pairs = read_note(table.schema, _EMPTY_INSTANTS, path.name, error)
    try:
        empty = [(int(time), camera) for time, camera in pairs]
    except (TypeError, ValueError, OverflowError) as cause:
        raise error(
            f"{path.name}: {_EMPTY_INSTANTS.decode()} is no list of instants",
            hint="Each is [time_ns, camera], or [time_ns, null] where it is of all cameras.",
        ) from cause
    return conform(table, schema, path.name, what, error), empty


def read_note(schema: pa.Schema, key: bytes, name: str, error: type[InputError] = InputError) -> Any:
    """What a file's metadata say under a key, in JSON; an empty list where they say nothing.

    Args:
        schema: of the file, with its metadata.
        key: in the metadata.
        name: of the file, for the error's sentence.
        error: the error to raise.

    Raises:
        InputError: (or ``error``) it is no JSON in Unicode.
    """
    try:
        return read_json(decode_text((schema.metadata or {}).get(key, b"[]")))
    except ValueError as cause:
        raise error(
            f"{name}: {key.decode()} in its metadata is no JSON: {cause}", hint="Write it as JSON, in UTF-8."
        ) from cause


def conform(table: pa.Table, schema: pa.Schema, name: str, what: str, error: type[InputError] = InputError) -> pa.Table:
    """The columns of ``schema``, cast to its types; a nullable column may be absent."""
    columns = []
    for column in schema:
        if column.name not in table.column_names:
            if not column.nullable:
                raise error(
                    f"{name} has no column {column.name}",
                    hint=f"A {what} file has the columns {', '.join(schema.names)}.",
                    column=column.name,
                )
            columns.append(pa.nulls(table.num_rows, type=column.type))
            continue
        values = table[column.name]
        if not column.nullable and values.null_count:
            raise error(f"{name}: column {column.name} has empty values", hint="Fill them in.", column=column.name)
        try:
            columns.append(values.cast(column.type))
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as cause:
            raise error(
                f"{name}: column {column.name} must be {column.type}, not {values.type}",
                hint="Correct the column's type.",
                column=column.name,
            ) from cause
    return pa.table(columns, schema=schema)
