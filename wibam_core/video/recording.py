"""The files of one camera's recording, as they were uploaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wibam_core.text import nfc


@dataclass(frozen=True)
class RecordingFile:
    """One file.

    Attributes:
        path: where it lies.
        name: what the camera, or the user, called it: chapters are told by it.
        started_ns: when its first frame was taken, Unix time; None: nobody said.
    """

    path: Path
    name: str
    started_ns: int | None = None

    @classmethod
    def at(cls, path: Path) -> RecordingFile:
        """A file that lies under its own name."""
        return cls(path, nfc(path.name))


@dataclass(frozen=True)
class Recording:
    """A camera's recording: one file, or several (chapters, numbered parts, segments) in any order."""

    files: tuple[RecordingFile, ...]

    def __post_init__(self) -> None:
        if not self.files:
            raise ValueError("a recording has at least one file")

    @property
    def is_dated(self) -> bool:
        """Whether it is known of every file when it began; then the recording's clock is Unix time."""
        return all(file.started_ns is not None for file in self.files)

    @classmethod
    def at(cls, *paths: Path) -> Recording:
        """Files that lie under their own names."""
        return cls(tuple(RecordingFile.at(path) for path in paths))
