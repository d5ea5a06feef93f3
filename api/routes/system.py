"""Health, version, options."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Response

from api.problems import documented
from api.schemas import HealthOut, OptionsOut, VersionOut
from api.services import ServicesDep
from wibam_core import __version__
from wibam_core.config import PipelineConfig
from wibam_core.stages.graph import STAGES

router = APIRouter(tags=["system"])
options_router = APIRouter(prefix="/v1", tags=["jobs"])


@router.get("/healthz", summary="Is the process alive?")
def healthz() -> HealthOut:
    return HealthOut()


@router.get("/readyz", summary="Can it work?", responses=documented(503))
def readyz(services: ServicesDep) -> HealthOut:
    """Asks the database and the message broker."""
    services.database.ping()
    services.queue.ping()
    return HealthOut()


@router.get("/version", summary="Version and stages")
def version() -> VersionOut:
    return VersionOut(version=__version__, stages=list(STAGES))


@router.get(
    "/metrics",
    summary="Figures for Prometheus",
    response_class=Response,
    responses={200: {"content": {"text/plain": {}, "application/openmetrics-text": {}}}, **documented(401, 503)},
)
def metrics(services: ServicesDep, accept: Annotated[str, Header()] = "") -> Response:
    """Queue, stages, leases and uploads of the whole service; requests and problems of this process alone."""
    text, media_type = services.figures.exposition(accept)
    return Response(text, media_type=media_type, headers={"Cache-Control": "no-store"})


@options_router.get("/options", summary="All options of a job", responses=documented(401))
def options() -> OptionsOut:
    """Their defaults by stage, and their meaning and limits."""
    return OptionsOut(defaults=PipelineConfig(), schema=PipelineConfig.model_json_schema())
