"""Who may work on a stage, and for how long.

A worker that claims a stage holds it for `LeasePolicy.duration_s` and renews it with heartbeats. Every claim raises
the stage's fencing number; whatever a worker writes later counts only while the number is still its own. A worker
that was slow, suspended or cut off can therefore never overwrite the work of its successor.
"""

from __future__ import annotations

from dataclasses import dataclass

from wibam_core.jobs.states import StageState


@dataclass(frozen=True)
class LeasePolicy:
    """How leases are kept.

    Attributes:
        duration_s: a stage whose worker has not been heard of for this long is given to another.
        heartbeat_s: a worker renews its lease this often.
        max_attempts: a stage whose worker was lost is failed after so many attempts; it probably kills them.
        attempts_when_killed: a stage that is killed by a signal, as by a system that runs out of memory, is tried so
            often; a worker that was lost before counts, too.
        resend_s: a queued stage that nobody claimed for this long is dispatched again: its message may be lost.
    """

    duration_s: float = 20.0
    heartbeat_s: float = 3.0
    max_attempts: int = 3
    attempts_when_killed: int = 2
    resend_s: float = 60.0

    def __post_init__(self) -> None:
        if not 0 < self.heartbeat_s <= self.duration_s / 3:
            raise ValueError("heartbeat_s must be positive and leave at least three heartbeats to a lease")
        if self.max_attempts < 1 or self.attempts_when_killed < 1 or self.resend_s <= 0:
            raise ValueError("attempts and resend_s must be positive")

    def after_expiry(self, attempts: int) -> StageState:
        """What becomes of a stage whose lease expired in its attempt number ``attempts``."""
        return StageState.QUEUED if attempts < self.max_attempts else StageState.FAILED

    def after_kill(self, attempts: int) -> StageState:
        """What becomes of a stage that a signal ended in its attempt number ``attempts``."""
        return StageState.QUEUED if attempts < self.attempts_when_killed else StageState.FAILED


@dataclass(frozen=True)
class Claim:
    """The right to work on one stage of one job, held by ``owner`` as long as ``fence`` is the stage's number."""

    job_id: str
    stage: str
    owner: str
    fence: int
    attempt: int


@dataclass(frozen=True)
class Heartbeat:
    """The answer to a heartbeat.

    Attributes:
        held: the lease was renewed; otherwise somebody else has it, and the work must be dropped.
        wanted: the job still wants this stage; otherwise stop it and say so.
    """

    held: bool
    wanted: bool
