"""Run one stage: in this process (`run_stage`), or as a program of its own for a worker to watch and kill.

``python -m wibam_core.stages.execute REQUEST.json`` reads a `StageRequest`, runs the stage and speaks JSON lines on
standard output: ``{"event": "progress", "fraction", "message", "figures"}``, ``{"event": "warning", "warning"}`` (a
`StageWarning`), and last either
``{"event": "done", "summary"}`` (exit code 0) or ``{"event": "failed", "error"}`` (exit code 1). Everything else that
any library prints goes to standard error, which is the log.
"""

from __future__ import annotations

import errno
import importlib
import json
import os
import sys
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from pydantic import BaseModel, ConfigDict
from threadpoolctl import threadpool_limits

from wibam_core.artifacts.access import ArtifactReader, ArtifactWriter
from wibam_core.config import PipelineConfig
from wibam_core.documents.warnings import StageWarning
from wibam_core.errors import DiskFull, StageCrashed, StageOutOfMemory, WibamError
from wibam_core.job_kind import JobKind
from wibam_core.progress import Progress
from wibam_core.site import Site
from wibam_core.stages.base import StageContext, Summary, WarningListener
from wibam_core.stages.graph import STAGES_OF, StageSpec
from wibam_core.stages.store import Attempt
from wibam_core.video.recording import Recording

_SECONDS_BETWEEN_REPORTS = 0.2


class StageRequest(BaseModel):
    """What a stage's process is told. Paths are the service's own, never a user's."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    stage: str
    kind: JobKind = JobKind.TRAINING
    site: Site
    config: PipelineConfig
    recordings: dict[str, Recording]
    assets: dict[str, Path] = {}
    upstream: dict[str, Path]
    earlier: tuple[Path, ...] = ()
    output: Path
    scratch: Path

    @classmethod
    def of(
        cls,
        attempt: Attempt,
        site: Site,
        config: PipelineConfig,
        recordings: Mapping[str, Recording],
        assets: Mapping[str, Path],
        upstream: Mapping[str, Path],
        kind: JobKind = JobKind.TRAINING,
    ) -> StageRequest:
        """What a stage is given, of all that its caller has, to make an attempt.

        Args:
            attempt: which stage, and where it may write.
            site: what the user said.
            config: all options.
            recordings: camera id -> its uploaded file or files.
            assets: all other uploaded files; those that the stage does not read are kept from it.
            upstream: published outputs by stage, of at least those that it reads.
            kind: of the job that the stage is one of.
        """
        spec = STAGES_OF[kind][attempt.stage]
        return cls(
            stage=attempt.stage,
            kind=kind,
            site=site,
            config=config,
            recordings=dict(recordings),
            assets={name: assets[name] for name in spec.assets_read(config) if name in assets},
            upstream={name: upstream[name] for name in spec.requires_of(site)},
            earlier=attempt.earlier,
            output=attempt.output,
            scratch=attempt.scratch,
        )

    @property
    def spec(self) -> StageSpec:
        """What is known of the stage."""
        return STAGES_OF[self.kind][self.stage]

    @property
    def reads(self) -> tuple[Path, ...]:
        """All files and folders that the stage is given to read."""
        footage = (file.path for recording in self.recordings.values() for file in recording.files)
        return (*footage, *self.assets.values(), *self.upstream.values(), *self.earlier)

    @property
    def writes(self) -> tuple[Path, Path]:
        """The folders that are its own."""
        return (self.output, self.scratch)

    def context(self, progress: Progress, warned: WarningListener) -> StageContext:
        """The stage's surroundings."""
        return StageContext(
            self.stage,
            self.site,
            self.recordings,
            self.assets,
            ArtifactReader(self.upstream),
            ArtifactWriter(self.stage, self.output, self.spec.writes),
            self.scratch,
            progress,
            warned,
            self.spec.checked_options(self.config),
            tuple(ArtifactReader({self.stage: folder}) for folder in self.earlier),
            self.spec.other_options(self.config),
        )


def run_stage(request: StageRequest, progress: Progress, warned: WarningListener) -> Summary:
    """Run a stage in this process.

    Its linear algebra keeps to one thread: the matrices are small, so that several threads gain nothing, and beside
    other work wait for each other many times longer than they compute. Networks use all cores that they are given.

    Args:
        request: which, and on what.
        progress: told how far it is.
        warned: told of its warnings, as they come; those of a stage that fails, too.

    Raises:
        WibamError: whatever went wrong, as the tree of errors says it.
    """
    stage = request.stage
    module = importlib.import_module(f"wibam_core.stages.{request.spec.module_name}")
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            summary: Summary = module.run(request.context(progress, warned), request.spec.config(request.config))
    except WibamError:
        raise
    except MemoryError as error:
        raise StageOutOfMemory(f"the stage {stage} ran out of memory") from error
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise DiskFull(f"no space left for the stage {stage}: {error.filename or request.output}") from error
        raise StageCrashed(f"the stage {stage} stopped: {error}") from error
    except Exception as error:
        traceback.print_exc()
        raise StageCrashed(f"the stage {stage} stopped: {type(error).__name__}: {error}") from error
    return summary


class Reporter:
    """Progress as JSON lines, a few a second at most; the last one always."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._last = 0.0

    @classmethod
    def on_standard_output(cls) -> Reporter:
        """One that alone writes to standard output: what others print there goes to standard error from now on."""
        reporter = cls(os.fdopen(os.dup(1), "w"))
        os.dup2(2, 1)
        return reporter

    def emit(self, event: str, **fields: Any) -> None:
        self._stream.write(json.dumps({"event": event, **fields}) + "\n")
        self._stream.flush()

    def warn(self, warning: StageWarning) -> None:
        self.emit("warning", warning=warning.model_dump(mode="json"))

    def __call__(self, fraction: float, message: str = "", **figures: float) -> None:
        now = time.monotonic()
        if fraction < 1.0 and now - self._last < _SECONDS_BETWEEN_REPORTS:
            return
        self._last = now
        plain = {name: float(value) for name, value in figures.items()}
        self.emit("progress", fraction=float(min(max(fraction, 0.0), 1.0)), message=message, figures=plain)


def main(arguments: list[str]) -> int:
    """The program: see the module's docstring."""
    reporter = Reporter.on_standard_output()
    request = StageRequest.model_validate_json(Path(arguments[0]).read_bytes())
    try:
        summary = run_stage(request, reporter, reporter.warn)
    except WibamError as error:
        reporter.emit("failed", error=error.to_dict())
        return 1
    reporter.emit("done", summary=summary)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
