"""What a job has produced: files of its published stages, found through their manifests."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wibam_core.errors import Conflict, NotFound
from wibam_core.jobs.records import Job
from wibam_core.stages.store import StageStore

_LISTED_STAGE_FILES = 200  # a stage with more files than this is a store of frames, not a list of results


@dataclass(frozen=True)
class Artifact:
    """A file that a stage of the job wrote. ``id`` is ``<stage>/<name>``."""

    id: str
    stage: str
    name: str
    size_bytes: int
    sha256: str
    path: Path


class JobResults:
    """Finds result files. A file is served only if its stage's manifest names it."""

    def __init__(self, stages: Path) -> None:
        self._store = StageStore(stages)

    def artifacts(self, job: Job) -> list[Artifact]:
        """All files of all finished stages, but for the frame store."""
        found: list[Artifact] = []
        for stage in job.stages:
            if stage.state.has_outputs and self._store.find(stage.name, stage.hash) is not None:
                files = self._files(stage.name, stage.hash)
                if len(files) <= _LISTED_STAGE_FILES:
                    found += [self._artifact(stage.name, stage.hash, name, files[name]) for name in sorted(files)]
        return found

    def artifact(self, job: Job, stage_name: str, name: str) -> Artifact:
        """One file.

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
        return self._artifact(stage_name, stage.hash, name, files[name])

    def document(self, job: Job, stage_name: str, name: str) -> Any:
        """A JSON file of a stage. Raises as `artifact` does."""
        return json.loads(self.artifact(job, stage_name, name).path.read_bytes())

    def _files(self, stage: str, digest: str) -> Mapping[str, Mapping[str, Any]]:
        files: Mapping[str, Mapping[str, Any]] = self._store.manifest(stage, digest)["files"]
        return files

    def _artifact(self, stage: str, digest: str, name: str, facts: Mapping[str, Any]) -> Artifact:
        folder = self._store.find(stage, digest)
        assert folder is not None
        return Artifact(f"{stage}/{name}", stage, name, int(facts["bytes"]), str(facts["sha256"]), folder / name)


def conflicts_csv(document: Mapping[str, Any]) -> Iterator[str]:
    """``conflicts.json`` as CSV: pairs become two columns each, intervals ``_low`` and ``_high``."""
    rows = [_flat(conflict) for conflict in document["conflicts"]]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns)
    writer.writeheader()
    for row in rows:
        writer.writerow(row)
        yield buffer.getvalue()
        buffer.seek(0)
        buffer.truncate()
    yield buffer.getvalue()


def _flat(conflict: Mapping[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for name, value in conflict.items():
        if isinstance(value, list) and len(value) == 2:
            ends = ("low", "high") if "interval" in name else ("1", "2")
            row |= {f"{name}_{end}": item for end, item in zip(ends, value, strict=True)}
        else:
            row[name] = value
    return row
