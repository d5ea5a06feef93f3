"""What all that a worker does is done with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.settings import StageLimits
from wibam_core.jobs.leases import LeasePolicy


@dataclass(frozen=True)
class Workplace:
    """A worker process and its surroundings.

    Attributes:
        jobs: what is to be done.
        folder: the data folder.
        limits: what a stage, or the rendering of a clip, may take.
        policy: how leases are kept.
        owner: the name under which this process takes work (`wibam_core.adapters.presence.Presence.owner`).
        stopping: whether it is asked to end.
    """

    jobs: JobStore
    folder: DataFolder
    limits: StageLimits
    policy: LeasePolicy
    owner: str
    stopping: Callable[[], bool] = lambda: False
