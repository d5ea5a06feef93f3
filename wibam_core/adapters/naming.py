"""Errors and warnings in the user's own words: files by the names that the user gave them, no path of the service's."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from wibam_core.jobs.records import Purpose, StoredFile

_FILE = re.compile(r"(?:(?<![\w:/])/[^\s'\"]*/)?\b(file_[0-9a-f]{16})(?:\.[a-z]+)?\b")
_PATH = re.compile(r"(?<![\w:/.~-])/(?!v1/)(?:[^\s/'\"()<>|:,;]+/)+([^\s/'\"()<>|:,;]*)")


def in_users_words(value: Any, files: Iterable[StoredFile]) -> Any:
    """An error, or warnings, as JSON types, with all text in it rewritten.

    Args:
        value: a `WibamError.to_dict`, `StageWarning`s as JSON types, or a part of them.
        files: those that the job works on; their ids become the names that the user gave them.
    """
    return _rewritten(value, {file.id: _shown(file) for file in files})


def _rewritten(value: Any, names: dict[str, str]) -> Any:
    if isinstance(value, str):
        named = _FILE.sub(lambda found: names.get(found[1], found[1]), value)
        return _PATH.sub(lambda found: found[1] or "a folder", named)
    if isinstance(value, dict):
        return {key: _rewritten(item, names) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rewritten(item, names) for item in value]
    return value


def _shown(file: StoredFile) -> str:
    name = re.split(r"[/\\]", file.filename)[-1]
    if file.purpose is not Purpose.RECORDING:
        return name or f"the {file.purpose} file"
    if not name:
        return f"the recording of camera {file.camera_id}"
    return name if name.rpartition(".")[0] == file.camera_id else f"{name} (camera {file.camera_id})"
