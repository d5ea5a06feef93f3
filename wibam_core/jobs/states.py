"""The states of a job and of one stage of it."""

from __future__ import annotations

from enum import StrEnum


class JobState(StrEnum):
    """Where a job stands. A job is terminal only once none of its stages runs any more."""

    QUEUED = "queued"
    RUNNING = "running"
    CANCELLING = "cancelling"
    CANCELLED = "cancelled"
    FAILED = "failed"
    SUCCEEDED = "succeeded"

    @property
    def is_terminal(self) -> bool:
        """Nothing happens any more unless somebody restarts the job."""
        return self in (JobState.CANCELLED, JobState.FAILED, JobState.SUCCEEDED)


class StageState(StrEnum):
    """Where one stage of a job stands.

    ``PENDING`` waits for the stages it requires, ``QUEUED`` for a worker; ``REUSED`` found its outputs already
    published under its hash.
    """

    PENDING = "pending"
    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    REUSED = "reused"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def is_terminal(self) -> bool:
        return self in (StageState.SUCCEEDED, StageState.REUSED, StageState.FAILED, StageState.CANCELLED)

    @property
    def has_outputs(self) -> bool:
        """Its outputs are published, so stages that require it can run."""
        return self in (StageState.SUCCEEDED, StageState.REUSED)
