"""The queue: Celery on Redis. Messages say "look at this stage" and nothing else; the database knows the rest.

Of the messages that wait, those of the latest stages go first: a job that has begun is done before another begins, so
that sixty jobs end one after the other and not all at the very end. Among jobs that stand alike the oldest goes first.

A message may arrive twice, late or never without harm: claims make a second delivery do nothing, and the reaper
dispatches again what nobody claimed.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable

from celery import Celery
from kombu.exceptions import OperationalError

from wibam_core.adapters.job_rows import StageKey
from wibam_core.errors import ServiceUnavailable
from wibam_core.stages.graph import STAGES

RUN_STAGE, RENDER_CLIP = "wibam.run_stage", "wibam.render_clip"
_DAY_S = 24 * 3600
_LEAST_URGENT = 9
#: Of a stage's message, from 0, the most urgent, to 9, as many as Celery tells apart on Redis.
PRIORITIES = {name: _LEAST_URGENT - place * _LEAST_URGENT // (len(STAGES) - 1) for place, name in enumerate(STAGES)}
_log = logging.getLogger(__name__)


def make_celery(broker_url: str) -> Celery:
    """The Celery app that api and worker share, so that its settings cannot differ between them.

    The visibility timeout is the time after which Redis delivers an unacknowledged message again. It is long, because
    stages are; a redelivery is harmless all the same.
    """
    app = Celery("wibam", broker=broker_url)
    app.conf.update(
        broker_transport_options={
            "visibility_timeout": _DAY_S,
            "priority_steps": list(range(_LEAST_URGENT + 1)),
            "queue_order_strategy": "priority",
            "socket_connect_timeout": 3,
            "socket_timeout": 30,
            # whoever dispatches does not wait for a broker that is away: the reaper tries again
            "max_retries": 1,
            "interval_start": 0,
            "interval_step": 0,
            "interval_max": 0,
        },
        broker_connection_timeout=3,
        broker_connection_retry_on_startup=True,
        task_acks_late=True,
        task_reject_on_worker_lost=False,
        task_ignore_result=True,
        task_serializer="json",
        accept_content=["json"],
        worker_prefetch_multiplier=1,
        worker_cancel_long_running_tasks_on_connection_loss=False,
        worker_hijack_root_logger=False,
        worker_send_task_events=False,
        enable_utc=True,
    )
    return app


class JobQueue:
    """Sends messages to the workers."""

    def __init__(self, app: Celery) -> None:
        self._app = app

    def dispatch(self, keys: Iterable[StageKey]) -> None:
        """Tell the workers of stages that are queued. A broker that does not answer is no error: the reaper will."""
        for key in keys:
            try:
                urgency = PRIORITIES[key.stage]
                self._app.send_task(RUN_STAGE, args=[key.job_id, key.stage], retry=False, priority=urgency)
            except OperationalError as error:
                _log.warning("could not dispatch %s of %s: %s; it will be tried again", key.stage, key.job_id, error)
                return

    def dispatch_clips(self, clip_ids: Iterable[str]) -> None:
        """Tell the workers of clips that are queued, before all stages: somebody waits in front of a page."""
        for clip_id in clip_ids:
            try:
                self._app.send_task(RENDER_CLIP, args=[clip_id], retry=False, priority=0)
            except OperationalError as error:
                _log.warning("could not dispatch %s: %s; it will be tried again", clip_id, error)
                return

    def ping(self) -> None:
        """Raises:
        ServiceUnavailable: the broker does not answer.
        """
        try:
            with self._app.connection_for_write() as connection:
                connection.ensure_connection(max_retries=1, interval_start=0, interval_step=0, timeout=3)
        except OperationalError as error:
            raise ServiceUnavailable("the message broker does not answer", hint="Is Redis running?") from error
