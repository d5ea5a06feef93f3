"""Each how-to does what it says: its steps are applied to a copy of the package, and the tests that it adds pass there.

A step is a line ``New file `PATH`:`` or ``In `PATH`, after `LINE`:`` (or ``before``, or ``at the end of`` where the
line begins a block), and the code below it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HOWTOS = sorted((ROOT / "docs" / "howto").glob("*.md"))
_STEP = re.compile(
    r"^ *(?:New file `(?P<new>[^`]+)`|"
    r"In `(?P<old>[^`]+)`, (?P<where>after|before|at the end of) `(?P<line>[^`]+)`):\n\n"
    r"(?P<indent> *)```python\n(?P<code>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Step:
    """Code of a how-to: a new file, or lines beside a line of a file (``where`` is "" for a new one)."""

    path: str
    where: str
    line: str
    code: str

    def apply(self, root: Path) -> None:
        target = root / self.path
        if not self.where:
            assert not target.exists(), f"{self.path} is there already"
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(self.code, encoding="utf-8")
            return
        lines = target.read_text(encoding="utf-8").splitlines(keepends=True)
        assert lines.count(f"{self.line}\n") == 1, f"{self.path} has not one line {self.line!r}"
        at = lines.index(f"{self.line}\n") + (self.where != "before")
        if self.where == "at the end of":
            at = next((n for n in range(at, len(lines)) if lines[n][0] not in " \n"), len(lines))
            while not lines[at - 1].strip():
                at -= 1
        target.write_text("".join([*lines[:at], self.code, *lines[at:]]), encoding="utf-8")


def steps(howto: Path) -> Iterator[Step]:
    for found in _STEP.finditer(howto.read_text(encoding="utf-8")):
        # what the list that a step is an item of indents, no more: a line's own indentation belongs to the code
        code = "".join(
            line.removeprefix(found["indent"]) if line.strip() else "\n" for line in found["code"].splitlines(True)
        )
        yield Step(found["new"] or found["old"], found["where"] or "", found["line"] or "", code)


def copy_of_the_project(target: Path) -> Path:
    """Code is copied, since steps change it; all else is linked. What is compiled is known by dates."""

    def copy(source: str, to: str) -> None:
        if source.endswith(".py"):
            shutil.copy2(source, to)
        else:
            Path(to).symlink_to(source)

    without_tests = shutil.ignore_patterns("unit", "contract", "browser", "integration", "readers")
    for folder in ("wibam_core", "tests"):
        shutil.copytree(ROOT / folder, target / folder, copy_function=copy, ignore=without_tests)
    shutil.copyfile(ROOT / "pyproject.toml", target / "pyproject.toml")
    return target


def run(root: Path, *command: str) -> None:
    environment = {**os.environ, "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, "-m", *command], cwd=root, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"


@pytest.mark.slow
@pytest.mark.parametrize("howto", HOWTOS, ids=lambda p: p.stem)
def test_a_howto_does_what_it_says(howto: Path, tmp_path: Path) -> None:
    found = list(steps(howto))
    assert len(found) == howto.read_text(encoding="utf-8").count("```python"), "code that no step line introduces"
    root = copy_of_the_project(tmp_path)
    for step in found:
        step.apply(root)
    touched = sorted({step.path for step in found})
    tests = [path for path in touched if path.startswith("tests/")]
    assert tests, "a how-to tests what it adds"
    run(root, "pytest", "-p", "no:cacheprovider", *tests)
    run(root, "ruff", "check", "--no-cache", *touched)
    run(root, "ruff", "format", "--no-cache", "--check", *touched)


def test_a_step_puts_lines_where_it_says(tmp_path: Path) -> None:
    howto = tmp_path / "howto.md"
    howto.write_text(
        "1. Do.\n\n   In `a.py`, after `    x,`:\n\n   ```python\n       y,\n   ```\n\n"
        "   In `a.py`, before `ALL = (`:\n\n   ```python\n   y = 2\n\n   ```\n"
    )
    (tmp_path / "a.py").write_text("x = 1\nALL = (\n    x,\n)\n")
    for step in steps(howto):
        step.apply(tmp_path)
    assert (tmp_path / "a.py").read_text() == "x = 1\ny = 2\n\nALL = (\n    x,\n    y,\n)\n"
    (tmp_path / "b.py").write_text("class A:\n    x = 1\n\n\nclass B:\n    y = 1\n")
    Step("b.py", "at the end of", "class A:", "    x = 2\n").apply(tmp_path)
    Step("b.py", "at the end of", "class B:", "    y = 2\n").apply(tmp_path)
    assert (tmp_path / "b.py").read_text() == "class A:\n    x = 1\n    x = 2\n\n\nclass B:\n    y = 1\n    y = 2\n"
    with pytest.raises(AssertionError, match="has not one line"):
        Step("a.py", "after", "    z,", "").apply(tmp_path)
