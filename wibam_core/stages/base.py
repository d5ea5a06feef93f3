"""What every stage is given. A stage is a module with ``run(context, config) -> summary``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from wibam_core.artifacts.access import ArtifactReader, ArtifactWriter
from wibam_core.artifacts.artifact import Artifact
from wibam_core.config import FinetuneConfig, StageConfig
from wibam_core.documents.warnings import Caution, StageWarning
from wibam_core.progress import Progress
from wibam_core.site import Site
from wibam_core.video.recording import Recording

#: Figures of a stage for a person and for the job's status: JSON types only.
Summary = dict[str, Any]

#: Who is told of a stage's warnings, at once.
WarningListener = Callable[[StageWarning], None]

T = TypeVar("T")
Options = TypeVar("Options", bound=StageConfig)


@dataclass(frozen=True)
class StageContext:
    """The surroundings of one run of one stage, the same whoever runs it.

    Attributes:
        stage: its name.
        site: what the user said.
        recordings: camera id -> its uploaded file or files.
        assets: other uploaded files that the options use, by their names in `wibam_core.stages.assets`.
        inputs: what the stages before have made; see `read`.
        outputs: what this stage makes, published as a whole once it returns; see `write`.
        scratch: survives a killed attempt of this very stage (same hash): checkpoints to resume from.
        progress: call it a few times a second at most.
        warned: who is told of warnings; see `warn`.
        checked_options: options of fine-tuning that the site's own network must be able to do; None: not here.
        earlier: what this stage made before, of a stage that works frame by frame, where what it makes of a frame was
            the same; the newest first. Each may vanish while it is read, and changes no output: only what it costs.
        others: options of other stages that it uses, too; see `options_of`.
    """

    stage: str
    site: Site
    recordings: Mapping[str, Recording]
    assets: Mapping[str, Path]
    inputs: ArtifactReader
    outputs: ArtifactWriter
    scratch: Path
    progress: Progress
    warned: WarningListener
    checked_options: FinetuneConfig | None = None
    earlier: tuple[ArtifactReader, ...] = ()
    others: tuple[StageConfig, ...] = ()

    def warn(self, *cautions: Caution) -> None:
        """Say what makes the result doubtful: to the log, the job, the terminal and the top of the report."""
        for caution in cautions:
            self.warned(StageWarning(stage=self.stage, **caution.model_dump()))

    def options_of(self, kind: type[Options]) -> Options:
        """Options of another stage that this one was given, by their type."""
        return next(options for options in self.others if isinstance(options, kind))

    def read(self, artifact: Artifact[T]) -> T:
        """An artifact of a stage before."""
        return self.inputs.read(artifact)

    def write(self, artifact: Artifact[T], value: T) -> None:
        """Write an artifact of this stage."""
        self.outputs.write(artifact, value)

    def new_file(self, artifact: Artifact[Any]) -> Path:
        """Where the stage is to write an artifact itself, piece by piece."""
        return self.outputs.new_file(artifact)
