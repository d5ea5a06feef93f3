"""How many mistakes the tests notice: wrong lines are written into a copy of the project, and its tests are run.

    python -m benchmarks.mutants                       # the mistakes that once passed unseen
    python -m benchmarks.mutants --random 40 --seed 0  # and so many more, drawn from the core's source

A mistake that no test notices is printed with its place. A random one may also be harmless (a bound that nothing ever
meets), so that survivors are read by a person; of the known ones none may survive, and the exit status says so.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.known_mutants import KNOWN, Mistake

ROOT = Path(__file__).parents[1]
_COPIED = ("api", "benchmarks", "docs", "tests", "wibam_core", "worker", "pyproject.toml", "README.md")
_SWAPPED: dict[type[ast.AST], str] = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.And: "or",
    ast.Or: "and",
}
#: A test run that takes longer than this has met an endless loop, which counts as noticed.
_LIMIT_S = 900


def random_mistakes(seed: int, count: int, package: str) -> list[Mistake]:
    """Drawn evenly from all that can be written into the package's modules that have tests of their own."""
    every = [
        mistake
        for path in sorted((ROOT / "wibam_core" / package).rglob("*.py"))
        if (tests := unit_tests(path.relative_to(ROOT)))
        for mistake in mistakes_in(path.relative_to(ROOT), path.read_text(encoding="utf-8"), tests)
    ]
    return random.Random(seed).sample(every, min(count, len(every)))


def unit_tests(path: Path) -> tuple[str, ...]:
    """The unit tests of a module of the core: its package's folder, or its own file."""
    inner = path.parts[1:]
    if len(inner) > 1:
        own = Path("tests/unit", *inner[:-1])
        while own != Path("tests/unit") and not (ROOT / own).is_dir():
            own = own.parent
        return (str(own),) if own != Path("tests/unit") else ()
    own = Path("tests/unit", f"test_{path.stem}.py")
    return (str(own),) if (ROOT / own).is_file() else ()


def mistakes_in(path: Path, source: str, tests: tuple[str, ...]) -> Iterator[Mistake]:
    """Every change of one operator, sign, number or truth value within the functions of a module."""
    tree = ast.parse(source)
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        for node in (inner for statement in function.body for inner in ast.walk(statement)):
            for text, line, begin, end in _changes(node, source):
                first, last = starts[line - 1] + begin, starts[line - 1] + end
                wrong = source[:first] + text + source[last:]
                changed = wrong.splitlines()[line - 1].strip()
                yield Mistake(f"{path}:{line}: {changed}", str(path), source, wrong, tests)


def _changes(node: ast.AST, source: str) -> Iterator[tuple[str, int, int, int]]:
    """What to write, the line (from 1), and from which to which of its characters."""
    lines = source.splitlines()
    pairs: list[tuple[ast.expr, ast.AST, ast.expr]] = []
    if isinstance(node, ast.BinOp):
        pairs = [(node.left, node.op, node.right)]
    elif isinstance(node, ast.BoolOp):
        pairs = [(node.values[0], node.op, node.values[1])]
    elif isinstance(node, ast.Compare):
        pairs = [(node.left, node.ops[0], node.comparators[0])]
    for left, operator, right in pairs:
        text = _SWAPPED.get(type(operator))
        if text is None or left.end_lineno != right.lineno or not lines[right.lineno - 1].isascii():
            continue
        begin, end = left.end_col_offset or 0, right.col_offset
        between = lines[right.lineno - 1][begin:end]
        if between.strip(" ()") and "(" not in between and ")" not in between:
            yield f" {text} ", right.lineno, begin, end
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and lines[node.lineno - 1].isascii():
        yield "", node.lineno, node.col_offset, node.col_offset + 1
    if isinstance(node, ast.Constant) and node.end_lineno == node.lineno and lines[node.lineno - 1].isascii():
        end = node.end_col_offset or 0
        if isinstance(node.value, bool):
            yield str(not node.value), node.lineno, node.col_offset, end
        elif isinstance(node.value, int | float) and node.value:
            yield f"{node.value * 2}", node.lineno, node.col_offset, end


def noticed(mistake: Mistake, copy: Path) -> bool:
    """Whether a test fails while the mistake stands in the copy.

    Raises:
        SystemExit: the file does not hold the line that the mistake changes, or not once.
    """
    path = copy / mistake.path
    source = path.read_text(encoding="utf-8")
    if source.count(mistake.right) != 1:
        raise SystemExit(f"{mistake.path} does not hold this text once, so that it cannot be changed: {mistake.right}")
    path.write_text(source.replace(mistake.right, mistake.wrong), encoding="utf-8")
    try:
        return not passes(mistake.tests, copy)
    finally:
        path.write_text(source, encoding="utf-8")


def passes(tests: Sequence[str], copy: Path) -> bool:
    """Whether these tests of the copy pass."""
    run = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    # The copy comes before the project itself, wherever that is installed; one seed of Hypothesis makes it repeatable.
    environment = os.environ | {"PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            [*run, "--hypothesis-seed=0"], cwd=copy, env=environment, timeout=_LIMIT_S, capture_output=True
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--random", type=int, default=0, help="so many more, drawn from the core (default: none)")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (default: 0)")
    parser.add_argument("--package", default="", help="draw from this package of wibam_core alone, e.g. tracking")
    options = parser.parse_args()
    drawn = random_mistakes(options.seed, options.random, options.package)
    survivors: list[Mistake] = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in _COPIED:
            whole = ROOT / name
            (shutil.copytree if whole.is_dir() else shutil.copy)(whole, copy / name)
        for tests in sorted({mistake.tests for mistake in (*KNOWN, *drawn)}):
            if not passes(tests, copy):
                raise SystemExit(f"{' '.join(tests)} fails without any mistake; nothing can be said of it")
        for number, mistake in enumerate((*KNOWN, *drawn), 1):
            seen = noticed(mistake, copy)
            print(f"{number:>3} of {len(KNOWN) + len(drawn)}  {'noticed ' if seen else 'SURVIVED'}  {mistake.name}")
            if not seen:
                survivors.append(mistake)
    count = len(KNOWN) + len(drawn)
    print(f"{count - len(survivors)} of {count} mistakes were noticed")
    sys.exit(any(mistake in KNOWN for mistake in survivors))


if __name__ == "__main__":
    main()
