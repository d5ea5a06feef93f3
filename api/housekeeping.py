"""What has to be done now and then, in a thread of its own: lost stages and clips, lost messages, forgotten files."""

from __future__ import annotations

import logging
import threading

from api.services import Services
from wibam_core.adapters.presence import departed

_REAP_EVERY_S = 1.0
_KEEP_EVERY, _TIDY_EVERY = 30, 300  # reaps
_log = logging.getLogger(__name__)


class Housekeeper:
    """Takes lost leases back, keeps the networks that jobs made, tidies uploads and what killed attempts left.

    Any number may run at once, in any number of processes.
    """

    def __init__(self, services: Services) -> None:
        self._services = services
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="housekeeping", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(timeout=10.0)

    def round(self, number: int) -> None:
        """One round; the first, and every so often another, a thorough one."""
        services = self._services
        lost = departed(services.folder.workers)
        services.queue.dispatch(services.leases.reap(gone=lost.owners, resend_all=number == 0))
        services.queue.dispatch_clips(services.clips.reap(gone=lost.owners, resend_all=number == 0))
        lost.forget()
        if number % _KEEP_EVERY == 0:
            services.keeper.keep_all()
            services.site_tracks.take_in_all()
        if number % _TIDY_EVERY == 0:
            services.uploads.tidy()
            services.audit.tidy()
            services.webhooks.tidy()
            services.site_tracks.tidy()
            services.stages.sweep(services.leases.running_hashes)
            services.folder.tidy_clips(services.clips.ids)
            services.folder.tidy_models(services.models.ids)

    def _run(self) -> None:
        number = 0
        while not self._stop.wait(_REAP_EVERY_S if number else 0.0):
            try:
                self.round(number)
            except Exception:  # whatever it was: the next round comes
                _log.exception("housekeeping failed")
            number += 1
