"""A picture of a site from above, beneath every plan of the site and of its jobs."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Header, Response
from pydantic import BaseModel, ConfigDict, Field, model_validator

from api.problems import documented
from api.schemas import MapOut
from api.services import Services, ServicesDep
from wibam_core.adapters.site_maps import Given
from wibam_core.errors import NotFound

router = APIRouter(prefix="/v1/sites/{site_id}/map", tags=["sites"], responses=documented(401, 404))
job_router = APIRouter(prefix="/v1/jobs/{job_id}/map", tags=["results"], responses=documented(401, 404))
Coordinate = Annotated[float, Field(ge=-1e8, le=1e8, allow_inf_nan=False)]


class KnownPointIn(BaseModel):
    """A place in the picture, and in the world."""

    model_config = ConfigDict(extra="forbid")

    pixel: tuple[Coordinate, Coordinate] = Field(description="(0, 0) is the centre of the top-left one")
    world: tuple[Coordinate, Coordinate] = Field(description="X and Y in m")


class MapIn(BaseModel):
    """A picture to take, or where the one that is there lies, or both."""

    model_config = ConfigDict(extra="forbid")

    file: str | None = Field(None, description="id of a file that was uploaded with the purpose `map`; it is used up")
    world_file: str | None = Field(None, max_length=2000, description="text of the picture's world file")
    points: tuple[KnownPointIn, KnownPointIn] | None = Field(
        None, description="two known places, of a picture that shows the ground from straight above"
    )

    @model_validator(mode="after")
    def _says_something(self) -> MapIn:
        if self.world_file is not None and self.points is not None:
            raise ValueError("give a world file or two points, not both")
        if self.file is None and self.world_file is None and self.points is None:
            raise ValueError("give a file, a world file or two points")
        return self


_PICTURE: dict[int | str, dict[str, Any]] = {200: {"content": {"image/jpeg": {}}}, 304: {"description": "Not Modified"}}


@router.put("", summary="Give a site a map, or place it", responses=documented(413, 422, 503))
def put(site_id: str, body: MapIn, services: ServicesDep) -> MapOut:
    """A file replaces the picture that was there: PNG, JPEG, WebP or TIFF, which a process of its own decodes. A
    GeoTIFF says by itself where it lies, unless a world file or two points come with it. The coordinates of a world
    file are the world's."""
    from wibam_core.formats.map_pictures import two_points, world_file

    services.sites.site(site_id)
    given = None
    if body.world_file is not None:
        given = Given(world_file(body.world_file), "world file")
    if body.points is not None:
        affine = two_points(*(np.array([getattr(one, of) for one in body.points]) for of in ("pixel", "world")))
        given = Given(affine, "points")
    kept = None
    if body.file is not None:
        named = next((file for file in services.sites.all_files(site_id) if file.id == body.file), None)
        if named is None:
            raise NotFound(f"site {site_id} has no file {body.file}", hint="Upload it with the purpose 'map'.")
        kept = services.maps.take(named, given)
    elif given is not None:
        kept = services.maps.place(site_id, given)
    assert kept is not None, "the body says something"
    return MapOut(map=kept.map, version=kept.version)


@router.get("", summary="A site's map", response_class=Response, responses=_PICTURE)
def get(site_id: str, services: ServicesDep, if_none_match: Annotated[str | None, Header()] = None) -> Response:
    """The picture as JPEG; `GET /v1/sites/{site_id}` says where it lies."""
    services.sites.site(site_id)
    return _picture(services, site_id, if_none_match)


@router.delete("", status_code=204, summary="Take a site's map away")
def delete(site_id: str, services: ServicesDep) -> None:
    services.maps.remove(site_id)


@job_router.get("", summary="The map of a job's site", response_class=Response, responses=_PICTURE)
def of_job(job_id: str, services: ServicesDep, if_none_match: Annotated[str | None, Header()] = None) -> Response:
    """The picture as JPEG; `GET /v1/jobs/{job_id}/scene` says where it lies."""
    return _picture(services, services.jobs.job(job_id).site_id, if_none_match)


def _picture(services: Services, site_id: str, known: str | None) -> Response:
    kept = services.maps.find(site_id)
    headers = {"ETag": f'"{kept.version}"' if kept else '""', "Cache-Control": "private, no-cache"}
    if kept is not None and known == headers["ETag"]:
        return Response(status_code=304, headers=headers)
    headers["X-Content-Type-Options"] = "nosniff"
    return Response(services.maps.picture(site_id), media_type="image/jpeg", headers=headers)
