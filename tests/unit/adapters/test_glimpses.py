"""Short looks into uploaded files: what their processes are held to, and what is said where one takes too long."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.unit.report.documents import conflicts_json
from wibam_core.adapters.glimpses import GlimpseRequest, Glimpses, ReviewedConflicts, confined
from wibam_core.documents.conflicts import Conflicts
from wibam_core.errors import ServiceUnavailable

PRINT_LIMIT = "import resource; print(*resource.getrlimit(resource.RLIMIT_DATA))"


@pytest.mark.parametrize(("look", "most"), [("map", "4294967296"), ("calibration", "4294967296"), ("network", None)])
def test_looks_that_run_no_network_have_only_so_much_memory(look: str, most: str | None, tmp_path: Path) -> None:
    own = subprocess.run([sys.executable, "-c", PRINT_LIMIT], capture_output=True, text=True, check=True).stdout
    request = GlimpseRequest.model_validate({"look": look, "path": tmp_path})
    program = confined(request, [sys.executable, "-c", PRINT_LIMIT])
    held = subprocess.run(program, capture_output=True, text=True, check=True).stdout
    assert held.split() == ([most, most] if most else own.split())


def test_a_look_at_a_map_is_refused_memory_beyond_that(tmp_path: Path) -> None:
    program = confined(GlimpseRequest(look="map", path=tmp_path), [sys.executable, "-c", "bytearray(5 << 30)"])
    assert "MemoryError" in subprocess.run(program, capture_output=True, text=True, check=False).stderr


@pytest.mark.parametrize(
    ("look", "said", "hint"),
    [
        ("header", "the file was not read within 0.001 s", "later"),
        ("signals", "the file was not read within 0.001 s", "shorter stretch"),
        ("map", "the file was not read within 0.001 s", "smaller picture"),
        ("calibration", "the files were not read within 0.001 s", "one camera"),
        ("network", "the file was not read within 0.004 s", "later"),
        ("comparison", "the two networks were not compared within 0.004 s", "later"),
    ],
)
def test_a_look_that_takes_too_long_says_what_helps(look: str, said: str, hint: str, tmp_path: Path) -> None:
    """No process starts within so short a time; networks and their comparison are given four times as long."""
    request = GlimpseRequest.model_validate({"look": look, "path": tmp_path / "file"})
    with pytest.raises(ServiceUnavailable) as raised:
        Glimpses(patience_s=0.001).look(request)
    assert str(raised.value) == said and hint in raised.value.hint


def test_a_table_has_a_place_of_its_own() -> None:
    """Where there is no place for recordings at all, it is made none the less."""
    document = Conflicts.model_validate(conflicts_json())
    table = ReviewedConflicts(heading="Monday", about="", conflicts=document, reviews=None)
    request = GlimpseRequest(look="conflicts")
    _, pdf = Glimpses(at_once=0).look(request, table.model_dump_json().encode())
    assert pdf.startswith(b"%PDF-")
