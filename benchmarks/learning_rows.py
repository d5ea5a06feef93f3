"""Rows of the benchmarks of learning, in a file that they are appended to, so that a killed run goes on."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

#: Metrics and figures of one run; ``row["run"]`` says which: a row with an equal one is not computed again.
Row = dict[str, Any]
Run = Mapping[str, Any]


class RowFile:
    """Rows in a JSON file, written after each.

    Args:
        path: of the file; what it holds is kept, but for rows that do not say what was run.
        fresh: forget what it holds.
    """

    def __init__(self, path: Path, *, fresh: bool = False) -> None:
        self._path = path
        known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() and not fresh else []
        self._rows: list[Row] = [row for row in known if "run" in row]

    def find(self, run: Run) -> Row | None:
        """The row of this run, or None."""
        wanted = _as_json(run)
        return next((row for row in self._rows if row["run"] == wanted), None)

    def add(self, run: Run, figures: Mapping[str, Any]) -> Row:
        """Append a row and write the file, whole or not at all."""
        row = _as_json({"run": run, **figures})
        self._rows.append(row)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        temporary = self._path.with_name(self._path.name + ".tmp")
        temporary.write_text(json.dumps(self._rows, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        temporary.replace(self._path)
        return row

    def rows(self, runs: Iterable[Run], figures: Callable[[Run], Mapping[str, Any]]) -> Iterator[Row]:
        """The rows of runs, in order; ``figures`` computes those that are not in the file."""
        for run in runs:
            yield self.find(run) or self.add(run, figures(run))


def mean_of(row: Mapping[str, Any], name: str) -> float | None:
    """A row's figure, or its mean where it has a spread; None where there is none."""
    value = row.get(name)
    return value["mean"] if isinstance(value, Mapping) else value


def _as_json(document: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(document, allow_nan=False))
