"""One delivery of "render this clip": claim it, render it in a confined process, put the file into its place."""

from __future__ import annotations

import logging
import sys
import time
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from wibam_core.adapters.clip_process import ClipRequest
from wibam_core.adapters.clip_store import ClipStore
from wibam_core.adapters.lease_store import LostLease
from wibam_core.artifacts import catalogue
from wibam_core.documents.clips import ClipFacts
from wibam_core.errors import Conflict, DiskFull, StageCrashed, StageOutOfMemory, StageTimedOut, WibamError
from wibam_core.jobs.clips import ClipClaim
from wibam_core.stages.store import StageStore
from worker.process import Done, Failed, LogLine, Progress, StageProcess
from worker.workplace import Workplace

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_READS = (catalogue.RIG, catalogue.FRAMES, catalogue.TRACKS, catalogue.CONFLICTS)


class _WorkerStops(Exception):
    """This worker is asked to end."""


class ClipRunner:
    """Renders clips, one call at a time.

    Args:
        at: the worker.
        clips: what is to be rendered.
    """

    def __init__(self, at: Workplace, clips: ClipStore) -> None:
        self._at = at
        self._clips = clips
        self._store = StageStore(at.folder.stages)

    def run(self, clip_id: str) -> bool:
        """Do what a message asks for; returns whether this delivery did the work. A second delivery does nothing."""
        claim = self._clips.claim(clip_id, self._at.owner)
        if claim is None:
            return False
        try:
            self._render(claim)
        except LostLease as lost:
            _log.info("%s", lost)
            return False
        return True

    def _render(self, claim: ClipClaim) -> None:
        try:
            with self._at.folder.clip_workspace(claim.clip.id) as home:
                request = self._request(claim, Path(home) / "clip.mp4")
                facts = self._execute(claim, request, Path(home))
                size, target = request.target.stat().st_size, self._at.folder.clip(claim.clip.id)
                self._clips.succeed(claim, facts, size, lambda: request.target.replace(target))
        except _WorkerStops:
            self._clips.release(claim)
        except WibamError as error:
            self._clips.fail(claim, error)
        except OSError as error:
            self._clips.fail(claim, DiskFull(f"the clip could not be written: {error.strerror}"))

    def _request(self, claim: ClipClaim, target: Path) -> ClipRequest:
        job = self._at.jobs.job(claim.clip.job_id)
        outputs: dict[str, Path] = {}
        for artifact in _READS:
            stage = job.stage(artifact.stage)
            folder = self._store.find(stage.name, stage.hash) if stage is not None and stage.state.has_outputs else None
            if folder is not None:
                outputs[artifact.stage] = folder
        stage = job.stage(catalogue.TRACKS.stage)
        if stage is None or stage.hash != claim.clip.tracks_hash:
            raise Conflict("the job has made other tracks since this clip was asked for", hint="Ask for it again.")
        return ClipRequest(outputs=outputs, spec=claim.clip.spec, target=target)

    def _execute(self, claim: ClipClaim, request: ClipRequest, home: Path) -> ClipFacts:
        told = home / "request.json"
        told.write_text(request.model_dump_json())
        process = StageProcess.confined(
            [sys.executable, "-P", "-m", "wibam_core.adapters.clip_process", str(told)],
            home=home,
            cache=self._at.folder.cache,
            nice=self._at.limits.nice,
            reads=tuple(request.outputs.values()),
        )
        try:
            outcome = self._listen(claim, process)
        finally:
            process.close()
        if isinstance(outcome, Done) and process.process.returncode == 0:
            return ClipFacts.model_validate(outcome.summary)
        if isinstance(outcome, Failed):
            raise WibamError.from_dict(outcome.error)
        raise StageCrashed(
            f"the clip's process ended with exit code {process.process.returncode}, without a result",
            exit_code=process.process.returncode,
            log_tail=list(process.tail),
        )

    def _listen(self, claim: ClipClaim, process: StageProcess) -> Done | Failed | None:
        outcome: Done | Failed | None = None
        latest = Progress(0.0, "", {})
        started = heard = time.monotonic()
        next_report = 0.0
        while True:
            ended = process.ended
            for message in process.poll(_POLL_S):
                match message:
                    case LogLine(text):
                        _log.info("%s: %s", claim.clip.id, text)
                    case Progress():
                        latest = message
                    case Done() | Failed():
                        outcome = message
            if ended and process.quiet:
                return outcome
            now = time.monotonic()
            if now >= next_report:
                try:
                    self._clips.progress(claim, latest.fraction, latest.message)
                    heard = now
                except SQLAlchemyError as error:
                    if now - heard > self._at.policy.duration_s:
                        raise LostLease(f"the database has not answered while {claim.clip.id} was rendered") from error
                next_report = now + min(self._at.policy.heartbeat_s, 1.0)
                self._check(process, now - started)
            if self._at.stopping():
                raise _WorkerStops

    def _check(self, process: StageProcess, seconds: float) -> None:
        if seconds > self._at.limits.seconds:
            raise StageTimedOut(
                f"the clip took longer than {self._at.limits.seconds:g} s", hint="Ask for a shorter one."
            )
        used, allowed = process.memory_bytes(), self._at.limits.memory_bytes
        if used > allowed:
            raise StageOutOfMemory(
                f"the clip took {used / 1e9:.1f} GB of memory, {allowed / 1e9:.1f} GB are allowed",
                hint="Ask for a smaller one.",
            )
