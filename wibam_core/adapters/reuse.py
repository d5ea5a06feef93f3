"""Stages whose outputs are there already: settled at once, by whoever learns that they are due, without the queue."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial

from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.lease_store import LeaseStore, LostLease
from wibam_core.adapters.logs import JobLog
from wibam_core.jobs.leases import Claim
from wibam_core.stages.store import StageStore

_log = logging.getLogger(__name__)


class Reuse:
    """Settles due stages by outputs that are published.

    Args:
        leases: of the stages.
        folder: the data folder.
        owner: the name under which stages are taken for a moment.
    """

    def __init__(self, leases: LeaseStore, folder: DataFolder, owner: str) -> None:
        self._leases = leases
        self._folder = folder
        self._store = StageStore(folder.stages)
        self._owner = owner

    def settle(self, due: Iterable[StageKey]) -> list[StageKey]:
        """Settle what needs no work, and what becomes due by that; returns the stages that do, to be dispatched.

        A stage that is to be made anew needs work, whatever is there.
        """
        left = deque(due)
        to_do: list[StageKey] = []
        while left:
            key = left.popleft()
            following = self._settled(key)
            if following is None:
                to_do.append(key)
            else:
                left.extend(following)
        return to_do

    def _settled(self, key: StageKey) -> list[StageKey] | None:
        """What is due now that a stage is settled; None where it needs work, or somebody else has it."""
        hash = self._leases.reusable_hash(key)
        if hash is None or self._store.find(key.stage, hash) is None:
            return None
        claim = self._leases.claim(key, self._owner)
        if claim is None:
            return None
        try:
            with JobLog(self._folder.log(key.job_id)) as log:
                write = partial(log.write, key.stage)
                found = end_with_what_is_there(self._leases, self._store, claim, hash, write)
            return self._leases.release(claim) if found is None else found
        except LostLease as lost:
            _log.warning("%s", lost)
            return []


def end_with_what_is_there(
    leases: LeaseStore,
    store: StageStore,
    claim: Claim,
    hash: str,
    write: Callable[[str], None],
) -> list[StageKey] | None:
    """End a stage by outputs that are there already, and say what they say.

    Args:
        leases: of the stages.
        store: of outputs.
        claim: on the stage.
        hash: address of its outputs.
        write: takes a line for the job's log.

    Returns:
        The stages to dispatch next; None where nothing is there.

    Raises:
        LostLease: the stage is no longer the claim's.
    """
    if store.find(claim.stage, hash) is None:
        return None
    write(f"reused: {hash[:12]} is there already")
    made = store.manifest(claim.stage, hash)
    for warning in made.warnings:
        write(f"warning: {warning.message}. {warning.hint}")
    return leases.succeed(claim, made.summary, lambda: None, made.warnings, reused=True)
