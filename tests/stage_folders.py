"""Outputs of stages in folders below one root, given by a test or made by the stages themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import MANIFEST, ArtifactReader, ArtifactWriter
from wibam_core.artifacts.artifact import Artifact
from wibam_core.artifacts.catalogue import made_by
from wibam_core.config import FinetuneConfig, StageConfig
from wibam_core.detection.instants import annotated, by_frame
from wibam_core.documents.manifest import Manifest
from wibam_core.documents.warnings import StageWarning
from wibam_core.progress import Progress, silent
from wibam_core.scene import AnnotatedInstant
from wibam_core.site import Site
from wibam_core.stages.base import StageContext
from wibam_core.stages.graph import STAGES
from wibam_core.video.recording import Recording

T = TypeVar("T")


class StageFolders:
    """One folder a stage, made when it is first asked for; ``warnings`` are those of all stages that ran here."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.warnings: list[StageWarning] = []

    def folder(self, stage: str) -> Path:
        folder = self.root / stage
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    @property
    def reader(self) -> ArtifactReader:
        return ArtifactReader({stage: self.folder(stage) for stage in STAGES})

    def give(self, artifact: Artifact[T], value: T) -> None:
        """As if its stage had made it."""
        ArtifactWriter(artifact.stage, self.folder(artifact.stage), made_by(artifact.stage)).write(artifact, value)

    def give_detected(self, instants: Sequence[AnnotatedInstant]) -> None:
        """As if 2D boxes had been detected at these instants, by cameras that keep the reference clock."""
        searched, detected = by_frame(instants)
        self.give(catalogue.SEARCHED_INSTANTS, searched)
        self.give(catalogue.DETECTIONS, detected)
        self.give(catalogue.ROUND_DETECTIONS, detected)

    def detected(self) -> list[AnnotatedInstant]:
        """The instants with the 2D boxes that were detected at them."""
        searched, detected = self.read(catalogue.SEARCHED_INSTANTS), self.read(catalogue.DETECTIONS)
        return annotated(searched, detected)

    def place(self, artifact: Artifact[Any]) -> Path:
        """Where an artifact is, or would be."""
        return self.folder(artifact.stage) / artifact.file

    def read(self, artifact: Artifact[T]) -> T:
        return self.reader.read(artifact)

    def seal(self, stage: str, hash: str = "5e" * 32, seconds: float = 1.5) -> None:
        """Write a manifest, as the store does."""
        manifest = Manifest(stage=stage, hash=hash, seconds=seconds, summary={}, files={})
        (self.folder(stage) / MANIFEST).write_text(manifest.model_dump_json())

    def context(
        self,
        stage: str,
        site: Site,
        recordings: Mapping[str, Path] | None = None,
        assets: Mapping[str, Path] | None = None,
        progress: Progress = silent,
        checked_options: FinetuneConfig | None = None,
        earlier: Sequence[ArtifactReader] = (),
        others: Sequence[StageConfig] = (),
    ) -> StageContext:
        """What the stage would be given; it reads and writes here."""
        spec = STAGES[stage]
        scratch = self.root / "scratch" / stage
        scratch.mkdir(parents=True, exist_ok=True)
        return StageContext(
            stage,
            site,
            {
                camera_id: one if isinstance(one, Recording) else Recording.at(one)
                for camera_id, one in (recordings or {}).items()
            },
            assets or {},
            ArtifactReader({name: self.folder(name) for name in spec.requires}),
            ArtifactWriter(stage, self.folder(stage), spec.writes),
            scratch,
            progress,
            self.warnings.append,
            checked_options,
            tuple(earlier),
            tuple(others),
        )
