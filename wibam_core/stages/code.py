"""The code that a stage's outputs depend on, as one digest.

Hashed are the stage's module and all that it imports, directly or through others, at the top of a file or inside a
function, each by its meaning: the syntax tree without docstrings, comments and layout, none of which can change an
output, since no such module reads its ``__doc__``. A string that is the dotted name of a module counts as an import of
it: registries name modules so that are to be imported late. A data file of the package, such as weights or a template,
belongs to the modules that spell its name, and is hashed by its content. Of other people's libraries, those that
compute are hashed by their version.

Python writes the syntax tree, so that another version of Python may give other digests.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import metadata
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

#: Modules of wibam_core that a stage imports and that cannot change what it writes.
LEFT_OUT = frozenset(
    {
        "artifacts.catalogue",  # all artifacts; the layouts of those that a stage reads and writes are hashed
        "config",  # options are hashed by their values, after all that it does to them
        "progress",  # only tells how far a stage is
    }
)
#: Libraries whose version can change a figure or a picture: name in an import -> name of the distribution.
COMPUTING = {
    "av": "av",
    "cv2": "opencv-python-headless",
    "jinja2": "Jinja2",
    "matplotlib": "matplotlib",
    "numpy": "numpy",
    "onnxruntime": "onnxruntime",
    "scipy": "scipy",
    "torch": "torch",
}
#: Libraries that check values, or write them so that they are read back equal: versions change no figure.
CARRYING = frozenset({"onnx", "pyarrow", "pydantic", "pydantic_core", "pyproj", "safetensors"})


@cache
def code_digest(stage: str, without: frozenset[str], layouts: frozenset[str]) -> str:
    """SHA-256 (hex) of the code, bundled data and libraries that a stage's outputs depend on.

    Files are read once a process: what changes on the disk of a running service changes nothing in it either.

    Args:
        stage: its name, which is that of its module.
        without: modules of wibam_core that change no output of this stage; left out with what only they import.
        layouts: dotted names of the modules that say how the artifacts look that the stage reads and writes.
    """
    left_out = {f"wibam_core.{name}" for name in LEFT_OUT | without}
    closure = _tree().closure([f"wibam_core.stages.{stage}", *layouts], left_out)
    computing = [COMPUTING[library] for library in closure.libraries & COMPUTING.keys()]
    return closure.digest({distribution: _version(distribution) for distribution in computing})


_version = cache(metadata.version)


@cache
def _tree() -> SourceTree:
    return SourceTree(Path(__file__).resolve().parent.parent)


@dataclass(frozen=True)
class Closure:
    """What a module depends on.

    Attributes:
        modules: dotted name -> digest of the module's meaning; itself, and what it imports, from its own package.
        data: path in the package -> digest of a data file's content.
        libraries: top-level names of all else that is imported, those of Python's own library among them.
    """

    modules: dict[str, str]
    data: dict[str, str]
    libraries: frozenset[str]

    def digest(self, versions: dict[str, str]) -> str:
        """SHA-256 (hex) of modules, data and the versions of libraries."""
        parts = (self.modules, self.data, versions)
        return _sha256(repr([sorted(part.items()) for part in parts]).encode())


class SourceTree:
    """The files of a Python package, each read and parsed once.

    Args:
        root: the package's folder, which bears its name.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._modules: dict[str, _Module] = {}
        self._data: dict[Path, tuple[str, frozenset[Path]]] = {}

    def closure(self, starts: Iterable[str], without: Collection[str] = ()) -> Closure:
        """What some modules depend on.

        Args:
            starts: dotted names of the modules.
            without: dotted names of modules that are left out, with what only they import.
        """
        modules: dict[str, str] = {}
        data: dict[str, str] = {}
        libraries: set[str] = set()
        pending = list(starts)
        while pending:
            name = pending.pop()
            if name not in modules and name not in without:
                module = self._module(name)
                modules[name] = module.digest
                libraries |= module.libraries
                pending += module.executes
                self._add_data(module.data, data)
        return Closure(modules, data, frozenset(libraries))

    def _add_data(self, paths: Iterable[Path], found: dict[str, str]) -> None:
        """Add data files, and those that these spell in turn."""
        for path in paths:
            relative = path.relative_to(self._root).as_posix()
            if relative not in found:
                found[relative], spelled = self._datum(path)
                self._add_data(spelled, found)

    @cached_property
    def _files(self) -> list[Path]:
        return sorted(path for path in self._root.rglob("*") if path.is_file() and path.suffix != ".pyc")

    @cached_property
    def _module_paths(self) -> dict[str, Path]:
        """Files of modules by their dotted names."""
        names = {}
        for path in self._files:
            if path.suffix == ".py":
                parts = path.relative_to(self._root.parent).with_suffix("").parts
                names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
        return names

    @cached_property
    def _data_paths(self) -> dict[str, list[Path]]:
        """All other files by their names."""
        names: dict[str, list[Path]] = {}
        for path in self._files:
            if path.suffix != ".py":
                names.setdefault(path.name, []).append(path)
        return names

    def _module(self, name: str) -> _Module:
        if name not in self._modules:
            path = self._module_paths[name]
            package = name if path.name == "__init__.py" else name.rpartition(".")[0]
            digest, imports, strings = _parse(path.read_bytes(), package)
            self._modules[name] = _Module(
                digest,
                frozenset(executed for word in imports | strings for executed in self._executed(word)),
                frozenset(datum for word in strings for datum in self._data_paths.get(word, ())),
                frozenset(imported.partition(".")[0] for imported in imports) - {self._root.name},
            )
        return self._modules[name]

    def _executed(self, dotted: str) -> Iterator[str]:
        """The modules of this package that importing a dotted name executes: it may end in a name from a module."""
        parts = dotted.split(".")
        if parts[0] == self._root.name:
            names = (".".join(parts[:length]) for length in range(1, len(parts) + 1))
            yield from (name for name in names if name in self._module_paths)

    def _datum(self, path: Path) -> tuple[str, frozenset[Path]]:
        """A data file's digest, and the data files that it spells, as a template does that includes another."""
        if path not in self._data:
            content = path.read_bytes()
            spelled = (paths for name, paths in self._data_paths.items() if name.encode() in content)
            self._data[path] = _sha256(content), frozenset(other for paths in spelled for other in paths)
        return self._data[path]


@dataclass(frozen=True)
class _Module:
    """One module by itself.

    Attributes:
        digest: of its meaning.
        executes: modules of its package that are executed where it imports them, packages above them included.
        data: data files that it spells.
        libraries: top-level names of other imports.
    """

    digest: str
    executes: frozenset[str]
    data: frozenset[Path]
    libraries: frozenset[str]


#: Fields of a node that say what its place says already, or nothing.
_IDLE_FIELDS = {"ctx", "kind", "type_comment", "type_ignores"}
#: Classes of nodes -> the fields that mean something. A table, since hundreds of thousands of nodes are looked up.
_FIELDS = {
    node: tuple(field for field in node._fields if field not in _IDLE_FIELDS)
    for node in vars(ast).values()
    if isinstance(node, type) and issubclass(node, ast.AST)
}


def _parse(source: bytes, package: str) -> tuple[str, set[str], set[str]]:
    """The digest of a module's meaning, the dotted names that it imports, and its strings, without docstrings.

    Args:
        source: its text.
        package: that relative imports start from.
    """
    written: list[str] = []
    imports: set[str] = set()
    strings: set[str] = set()

    def visit(value: Any) -> None:
        kind = type(value)
        if kind in _FIELDS:
            if kind is ast.Constant and isinstance(value.value, str):
                strings.add(value.value)
            elif kind in (ast.Import, ast.ImportFrom):
                imports.update(_imported(value, package))
            written.append(kind.__name__)
            for field in _FIELDS[kind]:
                visit(getattr(value, field))
            written.append(")")
        elif kind is list:
            written.append("[")
            for item in value:
                if not _is_text(item):
                    visit(item)
            written.append("]")
        else:
            written.append(repr(value))

    visit(ast.parse(source))
    return _sha256(" ".join(written).encode()), imports, strings


def _is_text(node: Any) -> bool:
    """Whether a statement is nothing but a string: a docstring, of an attribute perhaps."""
    return type(node) is ast.Expr and type(node.value) is ast.Constant and isinstance(node.value.value, str)


def _imported(node: ast.Import | ast.ImportFrom, package: str) -> Iterator[str]:
    """Dotted names that a statement imports; of ``from a import b`` both a and a.b, which may be a module."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    else:
        module = resolve_name("." * node.level + (node.module or ""), package)
        yield module
        yield from (f"{module}.{alias.name}" for alias in node.names)


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
