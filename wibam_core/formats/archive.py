"""Zip archives that are sent on while they are written."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from pathlib import Path

from wibam_core.formats.outlet import Outlet

_BLOCK_BYTES = 1 << 20
#: Members that compressing makes no smaller.
_COMPRESSED = frozenset({".jpg", ".mp4", ".npz", ".onnx", ".ottrk", ".parquet", ".safetensors"})


@dataclass(frozen=True)
class Member:
    """A file of an archive.

    Attributes:
        name: in the archive, with slashes.
        content: a file, or what it is to hold.
        passing: the file goes once it is in the archive.
    """

    name: str
    content: Path | bytes
    passing: bool = False


def zip_blocks(members: Iterable[Member]) -> Generator[bytes]:
    """The blocks of a zip archive, file by file: never more than a piece of one is in memory.

    Equal members make equal archives: the time of writing is left at zip's oldest.

    Raises:
        OSError: a file cannot be read. What was sent until then is no archive.
    """
    outlet = Outlet()
    with zipfile.ZipFile(outlet, "w") as archive:
        for member in members:
            info = zipfile.ZipInfo(member.name)
            stored = Path(member.name).suffix in _COMPRESSED
            info.compress_type = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
            content = member.content
            with (
                content.open("rb") if isinstance(content, Path) else io.BytesIO(content) as file,
                archive.open(info, "w", force_zip64=True) as target,
            ):
                while block := file.read(_BLOCK_BYTES):
                    target.write(block)
                    if len(outlet) >= _BLOCK_BYTES:
                        yield outlet.take()
            if member.passing and isinstance(content, Path):
                content.unlink()
    yield outlet.take()
