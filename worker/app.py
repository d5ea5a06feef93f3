"""The Celery app: ``python -m celery -A worker.app worker``. Settings come from the environment."""

from __future__ import annotations

import atexit
import contextlib
import logging
import os
from functools import cache
from typing import Any

from celery.signals import worker_init, worker_process_init, worker_shutting_down

from wibam_core.adapters import confine
from wibam_core.adapters.database import Database
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.adapters.ownership import claim_folder
from wibam_core.adapters.presence import Presence
from wibam_core.adapters.queue import RUN_STAGE, JobQueue, make_celery
from wibam_core.adapters.settings import ServiceSettings
from wibam_core.errors import Conflict
from worker.attacks import ATTACKS, kept_out
from worker.notice import Notice
from worker.runner import StageRunner

_log = logging.getLogger(__name__)
confine.keep_secrets()  # the settings are in this process's environment, and stages belong to the same user
_settings = ServiceSettings.from_environment(os.environ)
_stopping = Notice()
app = make_celery(_settings.broker_url)


@app.task(name=RUN_STAGE)
def run_stage(job_id: str, stage: str) -> None:
    """Look at a stage of a job, and run it if it is to be run and nobody else does."""
    _runner().run(StageKey(job_id, stage))


@cache
def _runner() -> StageRunner:
    """One a process, made in the process that uses it: database connections do not survive a fork."""
    database, folder = Database(_settings.database_url), DataFolder(_settings.data_dir)
    until_the_end = contextlib.ExitStack()
    atexit.register(until_the_end.close)
    presence = until_the_end.enter_context(Presence(folder.workers))
    return StageRunner(
        JobStore(database),
        LeaseStore(database, _settings.leases),
        folder,
        _settings.limits,
        _settings.leases,
        JobQueue(app).dispatch,
        presence.owner,
        lambda: _stopping.given,
    )


@worker_init.connect
def _make_sure_of_database_and_folder(**_: Any) -> None:
    database = Database(_settings.database_url)
    database.migrate()
    try:
        claim_folder(database, DataFolder(_settings.data_dir))
    except Conflict as error:
        # Celery goes on after an exception of a handler; a worker without the service's files fails its users' jobs
        raise SystemExit(f"{error.message}. {error.hint}") from error
    finally:
        database.close()


@worker_init.connect
def _say_what_stages_can_reach(**_: Any) -> None:
    succeeding = [ATTACKS[name] for name, held in kept_out().items() if not held]
    if succeeding:
        _log.warning("this system cannot keep a stage that was taken over from this: %s", "; ".join(succeeding))


@worker_process_init.connect
def _stay_in_the_family(**_: Any) -> None:
    confine.die_with_parent(os.getppid())
    confine.adopt_orphans()


@worker_shutting_down.connect
def _tell_the_children(**_: Any) -> None:
    _stopping.give()
