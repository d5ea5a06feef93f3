"""Rows of the benchmarks of learning, in a file that they are appended to, so that a killed run goes on."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from wibam_core.stages.graph import STAGES

#: Metrics and figures of one run; ``row["run"]`` says which, and ``row["code"]`` by which version of the code: a row
#: in which both are equal is not computed again. Old rows do not say which code made them.
Row = dict[str, Any]
Run = Mapping[str, Any]

#: Stages whose code makes the figures.
_STAGES = ("detect", "lift", "finetune", "evaluate")


def code_version() -> str:
    """A short hash of the code that makes the figures."""
    joined = " ".join(STAGES[stage].code() for stage in _STAGES)
    return hashlib.sha256(joined.encode()).hexdigest()[:10]


class RowFile:
    """Rows in a JSON file, written after each.

    Args:
        path: of the file; what it holds is kept, but for rows that do not say what was run.
        fresh: forget what it holds.
        keep: rows of other versions of the code are as good.
        code: the version of the code that makes new rows; that of now without.
    """

    def __init__(self, path: Path, *, fresh: bool = False, keep: bool = False, code: str | None = None) -> None:
        self._path = path
        self._keep = keep
        self._code = code_version() if code is None else code
        self._rows: list[Row] = read_rows(path) if path.is_file() and not fresh else []

    def find(self, run: Run) -> Row | None:
        """The row of this run, or None; of this version of the code, unless others are as good."""
        wanted = _as_json(run)
        return next((row for row in self._rows if row["run"] == wanted and self._is_valid(row)), None)

    def add(self, run: Run, figures: Mapping[str, Any]) -> Row:
        """Append a row, in place of one of this run by other code, and write the file, whole or not at all."""
        row = _as_json({"run": run, "code": self._code, **figures})
        self._rows = [*(other for other in self._rows if other["run"] != row["run"]), row]
        write_rows(self._path, self._rows)
        return row

    def rows(self, runs: Iterable[Run], figures: Callable[[Run], Mapping[str, Any]]) -> Iterator[Row]:
        """The rows of runs, in order; ``figures`` computes those that are not in the file."""
        for run in runs:
            yield self.find(run) or self.add(run, figures(run))

    def _is_valid(self, row: Row) -> bool:
        return self._keep or row.get("code") == self._code


def read_rows(path: Path) -> list[Row]:
    """The rows of a file that say what was run."""
    return [row for row in json.loads(path.read_text(encoding="utf-8")) if "run" in row]


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_text(json.dumps(rows, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    temporary.replace(path)


def joined(paths: Iterable[Path]) -> list[Row]:
    """The rows of several files; of equal runs the first one, whatever code made it."""
    found: list[Row] = []
    for path in paths:
        for row in read_rows(path):
            if all(row["run"] != other["run"] for other in found):
                found.append(row)
    return found


def width_px_of(run: Run) -> int:
    """How wide the recordings of a run are, px; old rows do not say: theirs had 640."""
    width: int = run.get("width_px", 640)
    return width


def versions(rows: Sequence[Row]) -> str:
    """A sentence where rows were made by several versions of the code, else empty."""
    counts = Counter(row.get("code", "not recorded") for row in rows)
    if len(counts) < 2:
        return ""
    listed = ", ".join(f"{code} ({count})" for code, count in counts.items())
    return f"Rows of several versions of the code are mixed (version and number of rows): {listed}."


def mean_of(row: Mapping[str, Any], name: str) -> float | None:
    """A row's figure, or its mean where it has a spread; None where there is none."""
    value = row.get(name)
    return value["mean"] if isinstance(value, Mapping) else value


def _as_json(document: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(document, allow_nan=False))
