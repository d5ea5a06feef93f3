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
from wibam_core.adapters.clip_store import ClipStore
from wibam_core.adapters.database import Database
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.adapters.ownership import claim_folder
from wibam_core.adapters.presence import Presence
from wibam_core.adapters.queue import RENDER_CLIP, RUN_STAGE, JobQueue, make_celery
from wibam_core.adapters.settings import ServiceSettings
from wibam_core.errors import Conflict
from worker.attacks import ATTACKS, kept_out
from worker.clips import ClipRunner
from worker.notice import Notice
from worker.runner import StageRunner
from worker.workplace import Workplace

_log = logging.getLogger(__name__)
confine.keep_secrets()  # the settings are in this process's environment, and stages belong to the same user
_settings = ServiceSettings.from_environment(os.environ)
_stopping = Notice()
app = make_celery(_settings.broker_url)


@app.task(name=RUN_STAGE)
def run_stage(job_id: str, stage: str) -> None:
    """Look at a stage of a job, and run it if it is to be run and nobody else does."""
    _runner().run(StageKey(job_id, stage))


@app.task(name=RENDER_CLIP)
def render_clip(clip_id: str) -> None:
    """Look at a clip, and render it if it is to be rendered and nobody else does."""
    _clip_runner().run(clip_id)


@cache
def _clip_runner() -> ClipRunner:
    """One a process, as `_runner`."""
    database = Database(_settings.database_url)
    return ClipRunner(_workplace(database), ClipStore(database, _settings.leases))


def _workplace(database: Database) -> Workplace:
    return Workplace(
        JobStore(database),
        DataFolder(_settings.data_dir),
        _settings.limits,
        _settings.leases,
        _presence().owner,
        lambda: _stopping.given,
    )


@cache
def _presence() -> Presence:
    """Of this process, until it ends: by it others know that it is there."""
    until_the_end = contextlib.ExitStack()
    atexit.register(until_the_end.close)
    return until_the_end.enter_context(Presence(DataFolder(_settings.data_dir).workers))


@cache
def _runner() -> StageRunner:
    """One a process, made in the process that uses it: database connections do not survive a fork."""
    database = Database(_settings.database_url)
    return StageRunner(_workplace(database), LeaseStore(database, _settings.leases), JobQueue(app).dispatch)


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
