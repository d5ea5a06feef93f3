"""Keeps a lease alive while the work goes on."""

from __future__ import annotations

import logging
import threading
import time
from types import TracebackType
from typing import Self

from sqlalchemy.exc import SQLAlchemyError

from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.jobs.leases import Claim, LeasePolicy

_log = logging.getLogger(__name__)


class LeaseKeeper:
    """Renews a lease from a thread of its own. A context manager.

    Attributes:
        lost: the lease is somebody else's, or could not be renewed in time: drop the work, write nothing.
        unwanted: the job does not want the stage any more: stop it and say so.
    """

    def __init__(self, leases: LeaseStore, claim: Claim, policy: LeasePolicy) -> None:
        self._leases = leases
        self._claim = claim
        self._policy = policy
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"lease of {claim.stage}", daemon=True)
        self.lost = False
        self.unwanted = False

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        expires = time.monotonic() + self._policy.duration_s
        while not self._stop.wait(self._policy.heartbeat_s):
            started = time.monotonic()
            try:
                beat = self._leases.heartbeat(self._claim)
            except SQLAlchemyError as error:
                _log.warning("no heartbeat for %s: %s", self._claim, error)
                if time.monotonic() > expires:
                    self.lost = True
                    return
                continue
            expires = started + self._policy.duration_s
            self.unwanted = not beat.wanted
            if not beat.held:
                self.lost = True
                return
