"""One delivery of "run this stage": claim it, run it as a process, publish, tell what comes next."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy.exc import DBAPIError, OperationalError, SQLAlchemyError

from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.lease_store import LeaseStore, LostLease
from wibam_core.adapters.logs import JobLog
from wibam_core.adapters.machine import this_machine
from wibam_core.adapters.planning import are_dated
from wibam_core.adapters.records import plain_json
from wibam_core.adapters.reuse import Reuse, end_with_what_is_there
from wibam_core.adapters.runs import run_assets
from wibam_core.config import PipelineConfig
from wibam_core.documents.warnings import StageWarning
from wibam_core.errors import StageError, StageOutOfMemory, WibamError
from wibam_core.job_kind import JobKind
from wibam_core.jobs.estimate import TimeLimit, check_cost, time_limit
from wibam_core.jobs.leases import Claim
from wibam_core.jobs.records import Job, StageRun
from wibam_core.jobs.states import StageState
from wibam_core.stages.base import Summary
from wibam_core.stages.execute import StageRequest
from wibam_core.stages.graph import STAGES_OF
from wibam_core.stages.store import Attempt, StageStore
from wibam_core.video.recording import Recording, RecordingFile
from worker.failures import crash, is_full, no_space, system_error, was_killed
from worker.keeper import LeaseKeeper
from worker.process import Done, Failed, LogLine, Progress, StageProcess, Warned, system_oom_kills
from worker.workplace import Workplace

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_SECONDS_BETWEEN_REPORTS = 0.5
_SECONDS_BETWEEN_MEMORY_CHECKS = 0.5


class _Unwanted(Exception):
    """The job was cancelled, or another stage of it failed."""


class _Killed(Exception):
    """A signal ended the stage; ``error`` is what that means to its user."""

    def __init__(self, error: StageError) -> None:
        self.error = error


class _WorkerStops(Exception):
    """This worker is asked to end."""


@dataclass(frozen=True)
class _Account:
    """What is said about a stage while it runs: lines in the job's log, and its warnings, which the job keeps."""

    stage: str
    log: JobLog
    warnings: list[StageWarning] = field(default_factory=list)

    def write(self, text: str) -> None:
        self.log.write(self.stage, text)

    def warn(self, warning: StageWarning) -> None:
        self.warnings.append(warning)
        self.write(f"warning: {warning.message}. {warning.hint}")


class StageRunner:
    """Runs stages, one call at a time.

    Args:
        at: the worker.
        leases: who does what.
        dispatch: told of the stages that became ready.
    """

    def __init__(self, at: Workplace, leases: LeaseStore, dispatch: Callable[[Iterable[StageKey]], None]) -> None:
        self._at = at
        self._leases = leases
        self._store = StageStore(at.folder.stages)
        self._dispatch = dispatch
        self._reuse = Reuse(leases, at.folder, at.owner)

    def run(self, key: StageKey) -> bool:
        """Do what a message asks for; returns whether this delivery did the work. A second delivery does nothing."""
        claim = self._leases.claim(key, self._at.owner)
        if claim is None:
            return False
        try:
            ready = self._work(claim)
        except LostLease as lost:
            _log.warning("%s", lost)
            return False
        self._dispatch(self._reuse.settle(ready))
        self._tidy()
        return True

    def _tidy(self) -> None:
        try:
            addresses = self._store.addresses()
            for stage, frame_hash in self._at.jobs.frame_hashes_to_come():
                addresses -= self._store.addresses_with(stage, frame_hash)
            self._at.jobs.drop_unnamed(addresses, self._store.remove)
        except (SQLAlchemyError, OSError) as error:  # the next one tries again
            _log.warning("outputs that nobody needs are left: %s", error)

    def _work(self, claim: Claim) -> list[StageKey]:
        job = self._at.jobs.job(claim.job_id)
        stage = job.stage(claim.stage)
        assert stage is not None
        with (
            JobLog(self._at.folder.log(job.id)) as log,
            LeaseKeeper(self._leases, claim, self._at.policy) as keeper,
        ):
            account = _Account(stage.name, log)
            try:
                return self._make_or_find(claim, job, stage, keeper, account)
            except _Unwanted:
                account.write("stopped: the job does not want it any more")
                return self._leases.stopped(claim)
            except _WorkerStops:
                account.write("given back: the worker was asked to end")
                return self._leases.release(claim)
            except _Killed as killed:
                if self._at.policy.after_kill(claim.attempt) is StageState.QUEUED:
                    account.write(f"{killed.error.message}; it is tried once more")
                    return self._leases.retry(claim, killed.error.message)
                return self._fail(claim, killed.error, keeper, account)
            except WibamError as error:
                return self._fail(claim, error, keeper, account)
            except OSError as error:
                return self._fail(claim, system_error(stage.name, error), keeper, account)
            except DBAPIError as error:
                if not is_full(error):
                    raise
                return self._fail(claim, no_space(stage.name), keeper, account)

    def _fail(self, claim: Claim, error: WibamError, keeper: LeaseKeeper, account: _Account) -> list[StageKey]:
        """Tell the job. Where the database is full, too, try for as long as the lease can be kept."""
        account.write(f"failed: {error.message}")
        while True:
            try:
                return self._leases.fail(claim, error, account.warnings)
            except DBAPIError as full:
                if not is_full(full):
                    raise
                if keeper.lost:
                    raise LostLease(f"the database has no space to say that {claim} failed") from full
            time.sleep(_POLL_S)

    def _make_or_find(
        self, claim: Claim, job: Job, stage: StageRun, keeper: LeaseKeeper, account: _Account
    ) -> list[StageKey]:
        if self._leases.make_way(claim, self._store.remove):
            account.write("is made anew: its old outputs are removed")
        ready = end_with_what_is_there(self._leases, self._store, claim, stage.hash, account.write)
        if ready is not None:
            return ready
        check_cost(job, this_machine(), self._at.limits.job_seconds)
        attempt = self._store.begin(stage.name, stage.hash, stage.frame_hash)
        try:
            account.write(f"started, attempt {claim.attempt}")
            started = time.monotonic()
            summary = plain_json(self._execute(claim, job, stage, attempt, keeper, account))
            seconds = time.monotonic() - started
            self._store.seal(attempt, summary, seconds, account.warnings)
            if keeper.lost:
                raise LostLease(f"the lease of {claim} was lost at its end")
            ready = self._leases.succeed(claim, summary, lambda: self._store.reveal(attempt), account.warnings)
            self._store.drop_scratch(attempt)
            account.write(f"done in {seconds:.1f} s")
            return ready
        finally:
            self._store.discard(attempt)

    def _execute(
        self, claim: Claim, job: Job, stage: StageRun, attempt: Attempt, keeper: LeaseKeeper, account: _Account
    ) -> Summary:
        with self._store.temporary(attempt) as home:
            request = self._request(job, stage, attempt)
            oom_kills = system_oom_kills()
            process = StageProcess.start(
                request, home=Path(home), cache=self._at.folder.cache, nice=self._at.limits.nice
            )
            try:
                limits = self._at.limits
                allowed = time_limit(
                    job, stage.name, this_machine(), limits.seconds, limits.times_expected, limits.least_seconds
                )
                outcome = self._listen(claim, process, keeper, account, allowed)
            finally:
                process.close()
            if isinstance(outcome, Done) and process.process.returncode == 0:
                return dict(outcome.summary)
            if isinstance(outcome, Failed):
                raise WibamError.from_dict(outcome.error)
            system_killed = system_oom_kills() > oom_kills
            error = crash(stage.name, process, attempt=claim.attempt, system_killed=system_killed)
            raise _Killed(error) if was_killed(process) else error

    def _listen(
        self, claim: Claim, process: StageProcess, keeper: LeaseKeeper, account: _Account, allowed: TimeLimit
    ) -> Done | Failed | None:
        outcome: Done | Failed | None = None
        latest: Progress | None = None
        started = time.monotonic()
        next_report = next_memory_check = 0.0
        while True:
            ended = process.ended
            for message in process.poll(_POLL_S):
                match message:
                    case LogLine(text):
                        account.write(text)
                    case Progress():
                        latest = message
                    case Warned(warning):
                        account.warn(warning)
                    case Done() | Failed():
                        outcome = message
            now = time.monotonic()
            if latest is not None and now >= next_report:
                self._report(claim, latest)
                latest, next_report = None, now + _SECONDS_BETWEEN_REPORTS
            if ended and process.quiet:
                return outcome
            if now >= next_memory_check:
                self._check_memory(claim.stage, process)
                next_memory_check = now + _SECONDS_BETWEEN_MEMORY_CHECKS
            self._check_wanted(claim, process, keeper)
            if now - started > allowed.seconds:
                process.kill()
                raise allowed.error(claim.stage)

    def _check_wanted(self, claim: Claim, process: StageProcess, keeper: LeaseKeeper) -> None:
        if keeper.lost:
            process.kill()
            raise LostLease(f"the lease of {claim} was lost")
        if keeper.unwanted:
            process.kill()
            raise _Unwanted
        if self._at.stopping():
            process.kill()
            raise _WorkerStops

    def _report(self, claim: Claim, progress: Progress) -> None:
        try:
            self._leases.progress(claim, progress.fraction, progress.message, progress.figures)
        except OperationalError as error:  # whether the database stays away is for the lease keeper to judge
            _log.warning("could not report the progress of %s: %s", claim, error)

    def _check_memory(self, stage: str, process: StageProcess) -> None:
        used, allowed = process.memory_bytes(), self._at.limits.memory_bytes
        if used > allowed:
            process.kill()
            raise StageOutOfMemory(
                f"the stage {stage} took {used / 1e9:.1f} GB of memory, {allowed / 1e9:.1f} GB are allowed",
                used_bytes=used,
                limit_bytes=allowed,
            )

    def _request(self, job: Job, stage: StageRun, attempt: Attempt) -> StageRequest:
        upstream: dict[str, Path] = {}
        for name in STAGES_OF[job.kind][stage.name].requires_of(job.site):
            required = job.stage(name)
            folder = self._store.find(name, required.hash) if required is not None else None
            if folder is None:
                raise StageError(f"the outputs of the stage {name} are gone", hint=f"Restart the job from {name}.")
            upstream[name] = folder
        dated = are_dated(job.files)
        recordings = {
            camera: Recording(
                tuple(
                    RecordingFile(self._at.folder.file(file), file.filename, file.started_ns if dated else None)
                    for file in files
                )
            )
            for camera, files in job.recordings.items()
        }
        if job.kind is JobKind.RUN:
            assets = run_assets(job, self._at.folder, self._at.jobs, self._store)
        else:
            assets = {name: self._at.folder.file(file) for name, file in job.assets.items()}
        config = PipelineConfig.parse(job.options)
        return StageRequest.of(attempt, job.site, config, recordings, assets, upstream, job.kind)
