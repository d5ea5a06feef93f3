"""How an artifact's value becomes files, and files a value again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from wibam_core.documents.base import Document

T = TypeVar("T")
D = TypeVar("D", bound=Document)

JSON = "application/json"
PARQUET = "application/vnd.apache.parquet"
BINARY = "application/octet-stream"


@dataclass(frozen=True)
class Codec(Generic[T]):
    """Reads values of one kind, and writes them.

    Attributes:
        media_type: of the file.
        read: from a file, or from the first of several.
        write: to a file that is not there yet; None where the value grows piece by piece and the stage that makes it
            writes to the place that it is given.
        layout: dotted name of the module that says how the file looks: with its code, what is read changes.
    """

    media_type: str
    read: Callable[[Path], T]
    write: Callable[[Path, T], None] | None
    layout: str


def document(model: type[D]) -> Codec[D]:
    """A typed document, as JSON."""

    def read(path: Path) -> D:
        return model.model_validate_json(path.read_bytes())

    def write(path: Path, value: D) -> None:
        path.write_text(value.model_dump_json(indent=1, by_alias=True), encoding="utf-8")

    return Codec(JSON, read, write, model.__module__)


def own_format(read: Callable[[Path], T], write: Callable[[Path, T], None], media_type: str = PARQUET) -> Codec[T]:
    """A format of `wibam_core.formats`, unless said otherwise as a Parquet table."""
    return Codec(media_type, read, write, read.__module__)


def text(media_type: str) -> Codec[str]:
    """Text in UTF-8."""

    def read(path: Path) -> str:
        return path.read_text(encoding="utf-8")

    def write(path: Path, value: str) -> None:
        path.write_text(value, encoding="utf-8")

    return Codec(media_type, read, write, __name__)


def opaque(media_type: str = BINARY) -> Codec[Path]:
    """A file that only the package understands which wrote it: its value is its path."""
    return Codec(media_type, lambda path: path, None, __name__)
