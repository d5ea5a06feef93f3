"""What a job has produced: files of its published stages, found through their manifests."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, get_origin

from wibam_core.artifacts.access import ArtifactReader
from wibam_core.artifacts.artifact import Artifact
from wibam_core.artifacts.catalogue import FRAMES, made_by
from wibam_core.documents.conflicts import ConflictRow, Conflicts
from wibam_core.documents.manifest import FileFacts
from wibam_core.errors import Conflict, NotFound
from wibam_core.formats.archive import Member
from wibam_core.formats.framestore import FrameStore
from wibam_core.jobs.records import Job
from wibam_core.stages.store import StageStore

T = TypeVar("T")


@dataclass(frozen=True)
class ResultFile:
    """A file that a stage of a job wrote. ``id`` is ``<stage>/<name>``; ``artifact`` is what it is, or is a part of."""

    id: str
    stage: str
    name: str
    artifact: Artifact[Any]
    size_bytes: int
    sha256: str
    path: Path


class JobResults:
    """Finds result files. A file is served only if its stage's manifest names it."""

    def __init__(self, stages: Path) -> None:
        self._store = StageStore(stages)
        #: Published outputs never change, so that a store stays as it was opened.
        self._open_frames = lru_cache(maxsize=8)(FrameStore)

    def files(self, job: Job) -> list[ResultFile]:
        """All files of all finished stages."""
        found: list[ResultFile] = []
        for stage in job.stages:
            if stage.state.has_outputs and self._store.find(stage.name, stage.hash) is not None:
                found += self._files(stage.name, stage.hash).values()
        return found

    def has(self, job: Job, artifact: Artifact[Any]) -> bool:
        """Whether the artifact is there: its stage has published, and wrote it."""
        stage = job.stage(artifact.stage)
        if stage is None or not stage.state.has_outputs or self._store.find(stage.name, stage.hash) is None:
            return False
        return any(file.artifact == artifact for file in self._files(stage.name, stage.hash).values())

    def finished(self, job: Job) -> ArtifactReader:
        """What the job's finished stages have made."""
        folders = {
            stage.name: self._store.find(stage.name, stage.hash) for stage in job.stages if stage.state.has_outputs
        }
        return ArtifactReader({name: folder for name, folder in folders.items() if folder is not None})

    def named(self, job: Job, stage_name: str, name: str) -> ResultFile:
        """One file by its name.

        Raises:
            NotFound: the job has no such stage, or the stage wrote no such file.
            Conflict: the stage has not finished.
        """
        stage = job.stage(stage_name)
        if stage is None:
            names = ", ".join(stage.name for stage in job.stages)
            raise NotFound(f"job {job.id} has no stage {stage_name!r}", hint=f"Its stages are {names}.")
        if not stage.state.has_outputs:
            raise Conflict(
                f"the stage {stage_name} of job {job.id} is {stage.state}",
                hint="Wait until the stage has finished." if not job.state.is_terminal else "Restart the job.",
                stage=stage_name,
                state=stage.state.value,
            )
        if self._store.find(stage_name, stage.hash) is None:
            raise NotFound(f"the outputs of {stage_name} are gone", hint=f"Restart the job from {stage_name}.")
        files = self._files(stage_name, stage.hash)
        if name not in files:
            raise NotFound(
                f"the stage {stage_name} of job {job.id} wrote no {name!r}",
                hint=f"GET /v1/jobs/{job.id}/artifacts lists all files.",
            )
        return files[name]

    def file(self, job: Job, artifact: Artifact[Any]) -> ResultFile:
        """The file of an artifact. Raises as `named` does."""
        return self.named(job, artifact.stage, artifact.file)

    def read(self, job: Job, artifact: Artifact[T]) -> T:
        """The value of an artifact.

        Raises:
            NotFound: as `named` does.
            Conflict: as `named` and `ArtifactReader.read` do.
        """
        return ArtifactReader({artifact.stage: self.file(job, artifact).path.parent}).read(artifact)

    def frames(self, job: Job) -> FrameStore:
        """The frames of a job's recordings. Raises as `named` does."""
        index = self.named(job, FRAMES.stage, f"{FRAMES.file}/frames.parquet")
        return self._open_frames(index.path.parent)

    def _files(self, stage: str, hash: str) -> dict[str, ResultFile]:
        """The files of a published stage by name; those that are no part of an artifact are nobody's business."""
        folder = self._store.find(stage, hash)
        assert folder is not None
        facts = self._store.manifest(stage, hash).files
        artifacts = {artifact.file: artifact for artifact in made_by(stage)}
        return {
            name: _result_file(artifact, name, facts[name], folder)
            for name in sorted(facts)
            if (artifact := artifacts.get(name.partition("/")[0])) is not None
        }


def archive_of(job: Job, files: Sequence[ResultFile], described: bytes) -> Iterator[Member]:
    """Results as members of an archive, in a folder with the job's id.

    Args:
        job: whose.
        files: which.
        described: what is said of the job (JSON), for ``job.json``.

    Yields:
        ``job.json``, the digests of all files for ``sha256sum --check SHA256SUMS``, and the files by their ids.
    """
    sums = "".join(f"{file.sha256}  {file.id}\n" for file in files)
    yield Member(f"{job.id}/job.json", described)
    yield Member(f"{job.id}/SHA256SUMS", sums.encode())
    for file in files:
        yield Member(f"{job.id}/{file.id}", file.path)


def _result_file(artifact: Artifact[Any], name: str, facts: FileFacts, folder: Path) -> ResultFile:
    stage = artifact.stage
    return ResultFile(f"{stage}/{name}", stage, name, artifact, facts.bytes, facts.sha256, folder / name)


def conflicts_csv(document: Conflicts, verdicts: Mapping[int, tuple[str, str]] | None = None) -> Iterator[str]:
    """Conflicts as CSV: pairs become two columns each, intervals ``_low`` and ``_high``, measures one by name.

    Args:
        document: the conflicts.
        verdicts: conflict id -> what was said of it and the note, for two more columns; None for none.
    """
    rows = [dict(_flat(conflict)) for conflict in document.conflicts]
    columns = list(rows[0]) if rows else _columns()
    if verdicts is not None:
        columns += _REVIEW
        for row in rows:
            row |= dict(zip(_REVIEW, verdicts.get(row["conflict_id"], ("", "")), strict=True))
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns)
    writer.writeheader()
    for row in rows:
        writer.writerow(row)
        yield buffer.getvalue()
        buffer.seek(0)
        buffer.truncate()
    yield buffer.getvalue()


#: Columns of what people said of conflicts.
_REVIEW = ("verdict", "note")


def _flat(conflict: ConflictRow) -> Mapping[str, Any]:
    row: dict[str, Any] = {}
    for name, value in conflict.model_dump().items():
        if isinstance(value, tuple):
            row |= dict(zip(_pair(name), value, strict=True))
        elif isinstance(value, dict):
            row |= value
        else:
            row[name] = value
    return row


def _columns() -> list[str]:
    """Those of every conflict; which measures there are is known where there is one."""
    fields = {name: get_origin(field.annotation) for name, field in ConflictRow.model_fields.items()}
    columns = (_pair(name) if kind is tuple else (name,) for name, kind in fields.items() if kind is not dict)
    return [column for of_field in columns for column in of_field]


def _pair(name: str) -> tuple[str, str]:
    first, second = ("low", "high") if "interval" in name else ("1", "2")
    return f"{name}_{first}", f"{name}_{second}"
