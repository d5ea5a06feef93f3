"""Files with anything in them: read, or refused as `InputError`, never anything else."""

from __future__ import annotations

import csv
import json
import tempfile
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.exchange_content import content
from tests.unit.exchange.test_openlabel import tum_traffic
from wibam_core.errors import InputError
from wibam_core.exchange.base import ReadableFormat
from wibam_core.exchange.levelx import LevelX
from wibam_core.exchange.openlabel import OpenLabel

#: In the place of a value: what others write by mistake, and what they write to do harm.
STRANGE: st.SearchStrategy[Any] = st.sampled_from(
    [
        None,
        True,
        "",
        "x",
        "NaN",
        [],
        {},
        [[]],
        {"val": 1},
        0,
        -1,
        0.5,
        1e-300,
        1e308,
        -1e308,
        10**30,
        2**63,
        float("nan"),
    ]
)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The path of everything in a JSON document."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(found for key, item in inside for found in places(item, (*path, key)))]


def put(document: Any, path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    where = document
    for key in path[:-1]:
        where = where[key]
    where[path[-1]] = value
    return document


def is_read_or_refused(fmt: ReadableFormat, path: Path) -> bool:
    """Anything but an `InputError` with its words fails the test that asks."""
    try:
        fmt.read(path)
    except InputError as refused:
        return bool(refused.message and refused.hint)
    return True


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Our scenes of all parts, and one of others."""
    folder = tmp_path_factory.mktemp("scenes")
    OpenLabel().write(content(steps=1), folder)
    (folder / "other.json").write_text(json.dumps(tum_traffic()))
    return folder


@given(st.data())
@settings(max_examples=300)
def test_openlabel_is_read_or_refused(scenes: Path, data: st.DataObject) -> None:
    document = json.loads(data.draw(st.sampled_from(sorted(scenes.iterdir()))).read_text())
    for _ in range(data.draw(st.integers(1, 3))):
        document = put(document, data.draw(st.sampled_from(places(document))), deepcopy(data.draw(STRANGE)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.json"
        path.write_text(json.dumps(document))
        assert is_read_or_refused(OpenLabel(), path)


@given(st.data())
@settings(max_examples=200)
def test_levelx_is_read_or_refused(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        paths = LevelX().write(content(steps=2), Path(folder))
        path = data.draw(st.sampled_from(paths))
        rows = list(csv.reader(path.open()))
        row = data.draw(st.sampled_from(rows))
        row[data.draw(st.integers(0, len(row) - 1))] = str(data.draw(STRANGE))
        with path.open("w", newline="") as file:
            csv.writer(file).writerows(rows)
        assert is_read_or_refused(LevelX(), Path(folder))
