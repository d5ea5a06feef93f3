"""The application: ``python -m api``, or `create_app` with settings of one's own."""

from __future__ import annotations

import gc
import logging
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.middleware.cors import CORSMiddleware

from api.access import REQUEST_ID
from api.housekeeping import Housekeeper
from api.openapi import document_of, operation_id
from api.paging import LINK
from api.problems import add_handlers
from api.routes import (
    access,
    clips,
    exports,
    jobs,
    labels,
    looks,
    maps,
    models,
    results,
    reviews,
    scene,
    site_tracks,
    sites,
    system,
    track_views,
    uploads,
    webhooks,
)
from api.security import Gate
from api.services import Services
from api.telemetry import Telemetry
from api.tus import TUS_RESPONSE_HEADERS, TusHeaders
from api.web.pages import add_pages
from wibam_core import __version__
from wibam_core.adapters.ownership import claim_folder
from wibam_core.adapters.settings import ServiceSettings
from wibam_core.errors import Conflict

_log = logging.getLogger(__name__)
#: What pages of other origins may see of an answer's headers, beside those of uploads.
_EXPOSED = (REQUEST_ID, LINK, "Location", "ETag", "Retry-After", "Content-Disposition")
_DESCRIPTION = """
Fine-tune a monocular 3D vehicle detector for an intersection, from recordings of a few ordinary cameras and their
calibration, without hand labels; get 7DoF tracks and the conflicts between road users.

1. `POST /v1/sites`: describe the cameras. `PUT /v1/sites/{id}` corrects the description; recordings stay.
2. `POST /v1/uploads` (tus 1.0): send a recording for each camera.
3. `POST /v1/sites/{id}/jobs`: start. `GET /v1/jobs/{id}/events` tells how it goes.
4. `GET /v1/jobs/{id}/metrics`, `/model`, `/tracks`, `/conflicts`, `/report`: the results;
   `/exports/{format}` has them in formats of others, `/archive` all files at once.
5. `GET /v1/models`: the networks that jobs have made. `POST /v1/models/{id}/runs`: new footage to tracks and conflicts.

Lists come in pages: the header `Link` leads to the next one. `POST /v1/webhooks`: be told that a job has ended.

Everything under `/v1`, and `/metrics`, needs `Authorization: Bearer TOKEN`, with the token of the service, which may
do everything, or a key (`POST /v1/keys`), which may do what its scopes say; each operation names the one that it
takes. The pages, at `/`, sign in with the token once and then send a cookie in its place, and the header
`X-Wibam-Page` with everything that changes something. Errors are `application/problem+json` (RFC 9457) with a stable
`code`, a sentence and a `hint`.
"""


def create_app(settings: ServiceSettings) -> FastAPI:
    """The application for these settings. On start it brings the database up to date.

    It does not start on a data folder that belongs to another database.
    """
    services = Services.connect(settings)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await run_in_threadpool(_prepare, services)
        housekeeper = Housekeeper(services)
        housekeeper.start()
        services.webhook_sender.start()
        yield
        await run_in_threadpool(services.webhook_sender.stop)
        await run_in_threadpool(housekeeper.stop)
        services.database.close()

    app = FastAPI(
        title="WIBAM",
        summary="Recordings in; fine-tuned 3D detector, 7DoF tracks and conflicts out.",
        description=_DESCRIPTION,
        version=__version__,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        docs_url=None,  # its page loads scripts from elsewhere; ours does not
        redoc_url=None,
        lifespan=lifespan,
        generate_unique_id_function=operation_id,
    )
    app.state.services = services
    add_handlers(app)
    for router in (
        sites.router,
        looks.router,
        maps.router,
        maps.job_router,
        looks.calibration_router,
        uploads.router,
        jobs.router,
        results.router,
        track_views.router,
        scene.router,
        clips.router,
        reviews.router,
        labels.router,
        exports.router,
        access.router,
        webhooks.router,
        models.router,
        models.footage_router,
        site_tracks.router,
        results.public_router,
        system.options_router,
        system.router,
    ):
        app.include_router(router)
    add_pages(app)
    app.openapi = lambda: document_of(app)  # type: ignore[method-assign]
    app.add_middleware(Gate, token_sha256=settings.token_sha256, passes=services.passes, keys=services.keys)
    app.add_middleware(TusHeaders)
    if settings.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"],
            allow_headers=["*"],
            expose_headers=[
                *_EXPOSED,
                *TUS_RESPONSE_HEADERS,
            ],
        )
    app.add_middleware(Telemetry, audit=services.audit, figures=services.figures)
    return app


def _prepare(services: Services) -> None:
    services.database.migrate()
    try:
        claim_folder(services.database, services.folder)
    except Conflict as error:
        _log.error("%s. %s", error.message, error.hint)
        raise


def create() -> FastAPI:
    """The application for the settings in the environment; it is the only one of its process."""
    app = create_app(ServiceSettings.from_environment(os.environ))
    # what stands by now stays to the end: to look for garbage in it would take longer than most requests
    gc.collect()
    gc.freeze()
    return app
