"""The code that a stage's outputs depend on, as one digest."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

_CORE = Path(__file__).resolve().parent.parent
#: Code that every stage depends on, relative to wibam_core/.
_COMMON_CODE = ("errors.py", "road_users.py", "scene.py", "site.py", "geometry", "formats", "stages/base.py")


@cache
def code_digest(stage: str, code: tuple[str, ...]) -> str:
    """SHA-256 (hex) of the source and bundled data that a stage's outputs depend on.

    Args:
        stage: its name, which is that of its module.
        code: files and packages (relative to wibam_core/) that it depends on, besides its module and what all share.
    """
    digest = hashlib.sha256()
    for part in sorted({*_COMMON_CODE, f"stages/{stage}.py", *code}):
        root = _CORE / part
        files = [root] if root.is_file() else sorted(root.rglob("*"))
        for path in files:
            if path.suffix in {".py", ".safetensors", ".onnx", ".j2"} and path.is_file():
                digest.update(path.relative_to(_CORE).as_posix().encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
