"""What of the code a stage's address depends on: all that it imports, by its meaning, and nothing else."""

from __future__ import annotations

import ast
import inspect
import sys
from functools import cache
from importlib import import_module, metadata
from modulefinder import ModuleFinder
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.config import StageConfig
from wibam_core.stages.code import CARRYING, COMPUTING, LEFT_OUT, SourceTree, code_digest
from wibam_core.stages.graph import STAGES

ROOT = Path(__file__).resolve().parents[3]


@cache
def imported(stage: str) -> tuple[frozenset[str], frozenset[str]]:
    """What Python's own finder says that a stage's module imports: modules of the core, and libraries.

    It is told of the modules that registries name, which are imported by what they hold.
    """
    finder = ModuleFinder(path=[str(ROOT)])  # so that it follows nothing else
    finder.run_script(str(ROOT / "wibam_core" / "stages" / f"{stage}.py"))
    followed = 0
    while followed < len(finder.modules):
        followed = len(finder.modules)
        for name in [name for name in finder.modules if name.rpartition(".")[2] == "registry"]:
            for package in import_module(name).FAMILIES.values():
                finder.import_hook(package)
    modules = {name for name in finder.modules if name.partition(".")[0] == "wibam_core"}
    libraries = {name.partition(".")[0] for name in finder.badmodules}
    return frozenset(modules), frozenset(libraries - sys.stdlib_module_names - {"wibam_core"})


def sources(stage: str) -> dict[str, str]:
    return {name: inspect.getsource(import_module(name)) for name in imported(stage)[0]}


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_depends_on_all_that_python_finds_it_to_import(stage: str) -> None:
    own = f"wibam_core.stages.{stage}"
    modules, libraries = imported(stage)
    closure = SourceTree(ROOT / "wibam_core").closure([own])
    assert set(closure.modules) == modules | {own}
    assert closure.libraries - sys.stdlib_module_names == libraries
    assert libraries <= COMPUTING.keys() | CARRYING


def test_every_data_file_belongs_to_a_stage_that_spells_its_name() -> None:
    tree = SourceTree(ROOT / "wibam_core")
    data = {stage: set(tree.closure([f"wibam_core.stages.{stage}"]).data) for stage in STAGES}
    assert data["detect"] == {"models/bundled/detector2d.onnx", "models/bundled/edge_refiner.onnx"}
    assert data["finetune"] == {"models/bundled/mono_small.safetensors", "models/bundled/edge_refiner.onnx"}
    assert data["report"] == {"report/report.html.j2", "report/style.html.j2"}  # the first includes the second
    shipped = {p.name for suffix in ("onnx", "safetensors", "j2") for p in (ROOT / "wibam_core").rglob(f"*.{suffix}")}
    assert shipped == {Path(path).name for paths in data.values() for path in paths}


def test_of_the_options_module_stages_use_classes_of_values_alone() -> None:
    """Else leaving it out would be wrong: options are hashed by their values, not by what code makes of them."""
    used = {
        alias.name
        for stage in STAGES
        for name, source in sources(stage).items()
        if name.removeprefix("wibam_core.") not in LEFT_OUT
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ImportFrom) and node.module == "wibam_core.config"
        for alias in node.names
    }
    options = import_module("wibam_core.config")
    classes = [found for name in used if isinstance(found := getattr(options, name), type)]  # the rest names types
    assert classes and all(issubclass(found, (StageConfig, options.PipelineConfig)) for found in classes)
    public = {n for found in classes for n, value in vars(found).items() if callable(value) and not n.startswith("_")}
    assert public <= {"parse"}


def test_no_stage_reads_docstrings_or_computes_what_to_import() -> None:
    for stage in STAGES:
        for name, source in sources(stage).items():
            nodes = list(ast.walk(ast.parse(source)))
            assert not [node for node in nodes if isinstance(node, ast.Attribute) and node.attr == "__doc__"], name
            calls = [node for node in nodes if isinstance(node, ast.Call) and "import" in ast.unparse(node.func)]
            assert not [call for call in calls if isinstance(call.args[0], (ast.JoinedStr, ast.BinOp))], name


def test_checks_of_assets_are_what_a_stage_imports() -> None:
    for stage, spec in STAGES.items():
        assert {f"wibam_core.{name}" for name in spec.asset_checks} <= imported(stage)[0]
        assert (spec.code(checks=False) != spec.code()) == bool(spec.asset_checks)


SITE = {
    "__init__.py": "",
    "base.py": "WIDTH = 3\n",
    "tables.py": "import json\n",
    "late.py": "import numpy.linalg\n",
    "named.py": "",
    "unused.py": "",
    "deep/__init__.py": "from ..base import WIDTH\n",
    "deep/inner.py": "WEIGHTS = 'net.onnx'\n",
    "weights/net.onnx": "1",
    "weights/other.onnx": "2",
    "start.py": '''"""What it does."""
from site_code.deep import inner
REGISTRY = {"late": "site_code.named"}
def run():
    """Says so."""
    from . import late  # slow
    return late, inner
''',
}


def tree_of(folder: Path, **changed: str) -> SourceTree:
    """A package of the files above, of which some are written otherwise; "_" in an argument stands for "/" and "."."""
    root = folder / "site_code"
    for name, content in SITE.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(changed.get(name.replace("/", "_").replace(".", "_"), content), encoding="utf-8")
    return SourceTree(root)


def test_imports_late_relative_through_packages_and_by_name_are_followed(tmp_path: Path) -> None:
    closure = tree_of(tmp_path).closure(["site_code.start"])
    expected = {"", ".start", ".deep", ".deep.inner", ".base", ".late", ".named"}
    assert set(closure.modules) == {f"site_code{name}" for name in expected}
    assert set(closure.data) == {"weights/net.onnx"}
    assert closure.libraries == {"numpy"}
    without = tree_of(tmp_path).closure(["site_code.start"], {"site_code.late", "site_code.deep.inner"})
    assert set(without.modules) == set(closure.modules) - {"site_code.late", "site_code.deep.inner"}
    assert not without.data and not without.libraries


@pytest.mark.parametrize(
    ("file", "content", "changes"),
    [
        ("start_py", SITE["start.py"].replace("# slow", "# slower"), False),
        ("start_py", SITE["start.py"].replace("Says so.", "Says otherwise."), False),
        ("start_py", SITE["start.py"].replace('    """Says so."""\n', ""), False),
        (
            "start_py",
            "\n\n" + SITE["start.py"].replace("return late, inner", "return (late,\n            inner)"),
            False,
        ),
        ("start_py", SITE["start.py"].replace("return late, inner", "return inner, late"), True),
        ("base_py", "WIDTH = 4\n", True),
        ("base_py", "WIDTH = 3.0\n", True),
        ("base_py", "WIDTH = '3'\n", True),
        ("late_py", "import numpy.random\n", True),
        ("named_py", "pass\n", True),
        ("weights_net_onnx", "3", True),
        ("weights_other_onnx", "3", False),
        ("unused_py", "import os\n", False),
    ],
)
def test_meaning_changes_the_digest_and_nothing_else_does(
    tmp_path: Path, file: str, content: str, changes: bool
) -> None:
    before = tree_of(tmp_path / "a").closure(["site_code.start"]).digest({})
    after = tree_of(tmp_path / "b", **{file: content}).closure(["site_code.start"]).digest({})
    assert (before != after) == changes


@given(st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=40))
def test_no_comment_and_no_docstring_changes_a_digest(tmp_path_factory: pytest.TempPathFactory, words: str) -> None:
    documented = f"# {words}\ndef area(side):\n    {words!r}\n    return side * side  # {words}\nWIDTH = 3\n{words!r}\n"
    plain = tree_of(tmp_path_factory.mktemp("a"), base_py="def area(side): return side * side\nWIDTH = 3")
    other = tree_of(tmp_path_factory.mktemp("b"), base_py=documented)
    assert plain.closure(["site_code.base"]).digest({}) == other.closure(["site_code.base"]).digest({})


def test_versions_of_libraries_that_compute_belong_to_the_stages_that_import_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = {stage: spec.code() for stage, spec in STAGES.items()}
    monkeypatch.setattr(
        "wibam_core.stages.code._version", lambda name: "0" if name == "scipy" else metadata.version(name)
    )
    monkeypatch.setattr("wibam_core.stages.graph.code_digest", code_digest.__wrapped__)  # which remembers nothing
    changed = {stage for stage, spec in STAGES.items() if spec.code() != before[stage]}
    assert changed == {stage for stage in STAGES if "scipy" in imported(stage)[1]}
    assert {"associate", "lift"} <= changed and not {"frames", "detect", "report"} & changed
