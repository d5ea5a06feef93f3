"""What the service remembers of video clips of a job's results. Times are Unix seconds (UTC)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from wibam_core.documents.clips import ClipFacts, ClipSpec


class ClipState(StrEnum):
    """Where a clip stands."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"

    @property
    def is_terminal(self) -> bool:
        return self in (ClipState.SUCCEEDED, ClipState.FAILED)


@dataclass(frozen=True)
class Clip:
    """A clip that somebody asked for.

    Attributes:
        tracks_hash: address of the outputs whose tracks it shows.
        fraction: done, in [0, 1]. message: how it goes, for a person.
        error: why it failed (`WibamError.to_dict`).
        facts, size_bytes: of the finished file.
    """

    id: str
    job_id: str
    spec: ClipSpec
    tracks_hash: str
    state: ClipState
    fraction: float
    message: str
    error: Mapping[str, Any] | None
    facts: ClipFacts | None
    size_bytes: int | None
    created_at: float
    finished_at: float | None


@dataclass(frozen=True)
class ClipClaim:
    """The right to render a clip, held as long as ``fence`` is the clip's number."""

    clip: Clip
    fence: int
    attempt: int
