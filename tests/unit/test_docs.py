"""What the documents say is so: links resolve, targets and commands exist, examples parse."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

import pytest

from wibam_core.artifacts import catalogue
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
    example, *_ = fenced(ROOT / "docs" / "site-format.md", "json")
    site = Site.parse(example)
    assert json.loads(example)["cameras"][0]["id"] == site.cameras[0].id


def test_the_labels_example_and_table_are_the_format(tmp_path: Path) -> None:
    document = ROOT / "docs" / "site-format.md"
    (tmp_path / "labels.json").write_text(fenced(document, "json")[1])
    (instant,) = read_labels(tmp_path / "labels.json")
    assert instant.vehicles.ids.tolist() == [7]
    (tmp_path / "labels.json").write_text(fenced(document, "json")[2])
    (instant,) = read_labels(tmp_path / "labels.json")
    assert [len(polygon) for polygon in instant.do_not_care] == [3]
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


def test_the_glossary_speaks_of_what_the_code_has_and_once_of_each() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text()
    code = "\n".join(path.read_text() for path in sorted((ROOT / "wibam_core").rglob("*.py")))
    named = re.findall(r"`([A-Za-z_0-9]+)`", text)
    assert named
    assert [name for name in named if not re.search(rf"\b{name}\b", code)] == []
    terms = [term.lower() for term in re.findall(r"\*\*`?(.+?)`?\*\*", text)]
    assert sorted({term for term in terms if terms.count(term) > 1}) == []
    said = "\n".join(path.read_text() for path in DOCUMENTS if path.name != "glossary.md").lower() + code.lower()
    # a word of several parts may be written with a hyphen or a line's end between them
    unused = [
        term for term in terms if not re.search(r"[\s\-_#]+".join(map(re.escape, re.split(r"[\s-]+", term))), said)
    ]
    assert unused == [], "the glossary explains words that nobody uses"


def test_the_flow_of_a_frame_names_every_stage_and_the_artifacts_between() -> None:
    frame = fenced(ROOT / "docs" / "flow.md", "")[0]
    assert set(re.findall(r"\[ ?(\w+) ?\]", frame)) == set(STAGES) - {"report"}
    named = {name for name in re.findall(r"\b[A-Z][A-Z_]{2,}\b", frame) if name != "JPEG"}
    assert named <= {name for name in vars(catalogue) if name.isupper()}
    assert named >= {"FRAMES", "DETECTIONS", "ANNOTATIONS", "FITS", "WEIGHTS", "TRACKS", "CONFLICTS", "METRICS"}


def test_the_layout_is_that_of_the_package() -> None:
    layout = fenced(ROOT / "docs" / "architecture.md", "")[0]
    inside = "".join(re.findall(r"^  .*$", layout, re.MULTILINE))
    packages = {path.parent.name for path in (ROOT / "wibam_core").glob("*/__init__.py")}
    modules = {path.name for path in (ROOT / "wibam_core").glob("*.py") if path.name != "__init__.py"}
    assert set(re.findall(r"\b([a-z]+)/(?= )", inside)) - {"wibam_core"} == packages
    assert set(re.findall(r"\b[a-z_]+\.py\b", inside)) == modules


def test_the_order_of_imports_is_what_import_linter_holds() -> None:
    def layers(lines: Iterable[str]) -> list[set[str]]:
        return [set(re.findall(r"\w+", line.replace("wibam_core.", ""))) for line in lines]

    drawn = fenced(ROOT / "docs" / "architecture.md", "")[1]
    with (ROOT / "pyproject.toml").open("rb") as file:
        contract = tomllib.load(file)["tool"]["importlinter"]["contracts"][0]
    assert layers(drawn.split("→")) == layers(contract["layers"])
