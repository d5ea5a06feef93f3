"""What the documents say is so: links resolve, targets and commands exist, examples parse."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from wibam_core.cli.app import COMMANDS
from wibam_core.config import PipelineConfig
from wibam_core.formats.labels import SCHEMA, read_labels
from wibam_core.site import Site
from wibam_core.stages.graph import STAGES

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def fenced(document: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", document.read_text(), re.DOTALL)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: p.name)
def test_links_resolve(document: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", document.read_text()):
        if not target.startswith(("http://", "https://")):
            assert (document.parent / target).exists(), f"{document.name} links to {target}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: p.name)
def test_make_targets_and_commands_exist(document: Path) -> None:
    text = document.read_text()
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert (
        set(re.findall(r"`make ([a-z-]+)", text)) | set(re.findall(r"^make ([a-z-]+)", text, re.MULTILINE)) <= targets
    )
    named = set(re.findall(r"(?:`|^|\$ )(?:\.venv/bin/)?wibam ([a-z]+)", text, re.MULTILINE))
    assert named <= set(COMMANDS), f"{document.name} names unknown commands {named - set(COMMANDS)}"


def test_the_example_site_is_one() -> None:
    example, _ = fenced(ROOT / "docs" / "site-format.md", "json")
    site = Site.parse(example)
    assert json.loads(example)["cameras"][0]["id"] == site.cameras[0].id


def test_the_labels_example_and_table_are_the_format(tmp_path: Path) -> None:
    document = ROOT / "docs" / "site-format.md"
    (tmp_path / "labels.json").write_text(fenced(document, "json")[1])
    (instant,) = read_labels(tmp_path / "labels.json")
    assert instant.vehicles.ids.tolist() == [7]
    table = document.read_text().split("## labels.parquet")[1]
    named = [name for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)]
    assert named == SCHEMA.names


def test_the_stage_table_is_the_graph() -> None:
    rows = re.findall(r"^\| (\w+) \| ([\w, ]*)\| ", (ROOT / "docs" / "architecture.md").read_text(), re.MULTILINE)
    table = {name: needs.strip() for name, needs in rows if name in STAGES}
    assert list(table) == list(STAGES)
    for name, needs in table.items():
        if needs != "all of them":
            assert tuple(filter(None, needs.split(", "))) == STAGES[name].requires, name


def test_options_that_documents_and_hints_name_exist() -> None:
    options = {
        f"{name}.{field}" for name, spec in STAGES.items() for field in type(spec.config(PipelineConfig())).model_fields
    }
    named: set[str] = set()
    for document in DOCUMENTS:
        named |= set(re.findall(rf"`((?:{'|'.join(STAGES)})\.[a-z_]+)`", document.read_text()))
    hints = (ROOT / "wibam_core" / "errors.py").read_text()
    named |= set(re.findall(rf"\b((?:{'|'.join(STAGES)})\.[a-z_]+)", hints))
    assert {name for name in named if not name.endswith((".json", ".html"))} <= options


def test_the_command_line_answers() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from wibam_core.cli import main; main()", "--help"],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    assert "Fine-tune" in done.stdout
