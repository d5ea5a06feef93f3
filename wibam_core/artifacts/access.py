"""Reading and writing artifacts by name, wherever they are stored."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from wibam_core.artifacts.artifact import Artifact
from wibam_core.documents.manifest import Manifest
from wibam_core.errors import Conflict

T = TypeVar("T")

#: What the store writes beside the artifacts of a stage.
MANIFEST = "manifest.json"


class ArtifactReader:
    """Reads what stages have made.

    Args:
        folders: stage -> its published outputs.
    """

    def __init__(self, folders: Mapping[str, Path]) -> None:
        self._folders = dict(folders)

    @property
    def stages(self) -> tuple[str, ...]:
        """Whose outputs can be read."""
        return tuple(self._folders)

    def read(self, artifact: Artifact[T]) -> T:
        """The value of an artifact.

        Raises:
            KeyError: the outputs of its stage are not at hand.
            Conflict: another version made it, and it looked otherwise then.
        """
        try:
            return artifact.codec.read(self.local(artifact))
        except ValidationError as error:
            raise Conflict(
                f"{artifact.id} was made by another version, which wrote it otherwise",
                hint="Restart the job: what has changed is made anew.",
                stage=artifact.stage,
            ) from error

    def local(self, artifact: Artifact[Any]) -> Path:
        """A file with the artifact on this machine, for libraries that open files themselves. Nobody changes it."""
        return self._folders[artifact.stage] / artifact.file

    def folder(self, stage: str) -> Path:
        """The outputs of a stage.

        Raises:
            Conflict: they are not at hand.
        """
        if stage not in self._folders:
            raise Conflict(
                f"there are no outputs of the stage {stage}",
                hint="Wait until it has ended, or restart the job from it.",
            )
        return self._folders[stage]

    def manifest(self, stage: str) -> Manifest:
        """What the store knows about a stage that has made something."""
        return Manifest.model_validate_json((self._folders[stage] / MANIFEST).read_bytes())

    def has(self, artifact: Artifact[Any]) -> bool:
        """Whether the artifact was made."""
        return artifact.stage in self._folders and self.local(artifact).exists()


class ArtifactWriter:
    """Writes what one stage makes.

    Args:
        stage: which.
        folder: its own, empty.
        declared: what it may write.
    """

    def __init__(self, stage: str, folder: Path, declared: Collection[Artifact[Any]]) -> None:
        self._stage = stage
        self._folder = folder
        self._declared = declared

    def write(self, artifact: Artifact[T], value: T) -> None:
        """Write the value of an artifact."""
        write = artifact.codec.write
        assert write is not None, f"{artifact} grows piece by piece"
        write(self.new_file(artifact), value)

    def new_file(self, artifact: Artifact[Any]) -> Path:
        """Where the stage is to put a file (or folder) itself, which is not there yet."""
        assert artifact in self._declared, f"the stage {self._stage} does not make {artifact}"
        return self._folder / artifact.file
