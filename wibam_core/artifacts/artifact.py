"""What an artifact is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from wibam_core.artifacts.codecs import Codec

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Artifact(Generic[T]):
    """A file, or a folder of files, that a stage leaves.

    Attributes:
        name: what code and people call it; no two artifacts share one.
        stage: the stage that makes it.
        file: its name, or that of its folder, in the outputs of the stage. Nothing but `wibam_core.artifacts` and the
            stores knows it.
        title: for a person.
        codec: how it is written and read.
        version: raised when the layout changes, so that what was made before is made again.
        optional: not every run of the stage makes it.
    """

    name: str
    stage: str
    file: str
    title: str
    codec: Codec[T]
    version: int = 1
    optional: bool = False

    @property
    def id(self) -> str:
        """What it is called among all files of a job: ``<stage>/<file>``."""
        return f"{self.stage}/{self.file}"

    def __repr__(self) -> str:
        return f"<artifact {self.name} of {self.stage}>"
