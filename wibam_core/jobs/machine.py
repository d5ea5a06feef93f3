"""The state machine of jobs: which moves are legal, and what follows once a stage has changed its state.

Everything here is a pure function of states; the job store calls `settle` inside the transaction that changed a
stage, so that a job and its stages never disagree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from wibam_core.jobs.states import JobState, StageState

#: Moves of a job. Leaving a terminal state is a restart; QUEUED to SUCCEEDED is one that finds all outputs there.
JOB_MOVES: Mapping[JobState, frozenset[JobState]] = {
    JobState.QUEUED: frozenset({JobState.RUNNING, JobState.CANCELLED, JobState.SUCCEEDED}),
    JobState.RUNNING: frozenset({JobState.CANCELLING, JobState.CANCELLED, JobState.FAILED, JobState.SUCCEEDED}),
    JobState.CANCELLING: frozenset({JobState.CANCELLED}),
    JobState.CANCELLED: frozenset({JobState.QUEUED}),
    JobState.FAILED: frozenset({JobState.QUEUED}),
    JobState.SUCCEEDED: frozenset({JobState.QUEUED}),
}

#: Moves of a stage. RUNNING to QUEUED is a lost lease; QUEUED to PENDING is a stage parked because another one failed.
STAGE_MOVES: Mapping[StageState, frozenset[StageState]] = {
    StageState.PENDING: frozenset({StageState.QUEUED, StageState.CANCELLED}),
    StageState.QUEUED: frozenset({StageState.RUNNING, StageState.PENDING, StageState.CANCELLED}),
    StageState.RUNNING: frozenset(
        {StageState.SUCCEEDED, StageState.REUSED, StageState.FAILED, StageState.CANCELLED, StageState.QUEUED}
    ),
    StageState.SUCCEEDED: frozenset({StageState.PENDING}),
    StageState.REUSED: frozenset({StageState.PENDING}),
    StageState.FAILED: frozenset({StageState.PENDING}),
    StageState.CANCELLED: frozenset({StageState.PENDING}),
}


class IllegalMove(ValueError):
    """A programming error: the move is not in the table."""


def check_job_move(before: JobState, after: JobState) -> None:
    """Raises:
    IllegalMove: a job may not go from ``before`` to ``after``.
    """
    if after not in JOB_MOVES[before]:
        raise IllegalMove(f"a job may not go from {before} to {after}")


def check_stage_move(before: StageState, after: StageState) -> None:
    """Raises:
    IllegalMove: a stage may not go from ``before`` to ``after``.
    """
    if after not in STAGE_MOVES[before]:
        raise IllegalMove(f"a stage may not go from {before} to {after}")


@dataclass(frozen=True)
class StageNode:
    """What the machine sees of a stage: its name, its state and the stages it requires."""

    name: str
    state: StageState
    requires: tuple[str, ...] = ()


@dataclass(frozen=True)
class Settlement:
    """What follows from the states of a job and its stages.

    Attributes:
        job: the job's state from now on.
        moves: stage name -> its state from now on, for the stages that change.
    """

    job: JobState
    moves: Mapping[str, StageState]

    @property
    def queued(self) -> tuple[str, ...]:
        """Stages that are to be dispatched now."""
        return tuple(name for name, state in self.moves.items() if state is StageState.QUEUED)


def settle(job: JobState, stages: Sequence[StageNode]) -> Settlement:
    """Let everything happen that follows from the present states, up to the next event from outside.

    - Stages whose requirements have outputs are queued, as long as the job is wanted and nothing failed.
    - After a failure, queued stages are parked as pending: a restart picks them up. The job fails once nothing runs.
    - While cancelling, stages that have not started are cancelled. The job is cancelled once nothing runs.
    - The job succeeds when every stage has outputs.
    """
    running = any(stage.state is StageState.RUNNING for stage in stages)
    failed = any(stage.state is StageState.FAILED for stage in stages)
    if job.is_terminal:
        return Settlement(job, {})
    if job is JobState.CANCELLING:
        waiting = _in_states(stages, StageState.PENDING, StageState.QUEUED)
        after = JobState.CANCELLING if running else JobState.CANCELLED
        return Settlement(after, dict.fromkeys(waiting, StageState.CANCELLED))
    if failed:
        parked = _in_states(stages, StageState.QUEUED)
        after = job if running else JobState.FAILED
        return Settlement(after, dict.fromkeys(parked, StageState.PENDING))
    if all(stage.state.has_outputs for stage in stages):
        return Settlement(JobState.SUCCEEDED, {})
    return Settlement(job, dict.fromkeys(_ready(stages), StageState.QUEUED))


def cancel(job: JobState, stages: Sequence[StageNode]) -> Settlement:
    """Somebody asked to cancel. A terminal job stays as it is."""
    if job.is_terminal:
        return Settlement(job, {})
    return settle(JobState.CANCELLING, stages)


def _ready(stages: Sequence[StageNode]) -> tuple[str, ...]:
    done = {stage.name for stage in stages if stage.state.has_outputs}
    return tuple(s.name for s in stages if s.state is StageState.PENDING and done.issuperset(s.requires))


def _in_states(stages: Sequence[StageNode], *states: StageState) -> tuple[str, ...]:
    return tuple(stage.name for stage in stages if stage.state in states)
