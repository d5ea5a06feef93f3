"""Sites and their files."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Query, Response

from api.bodies import BoundedJsonRoute
from api.paging import MadeDep, PageDep, Text
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.schemas import RecordingOut, SiteOut
from api.services import Services, ServicesDep
from wibam_core.adapters.amounts import amounts
from wibam_core.artifacts import catalogue
from wibam_core.documents.amounts import JobAmount
from wibam_core.documents.recordings import VideoInfo
from wibam_core.errors import WibamError
from wibam_core.job_kind import JobKind
from wibam_core.jobs.records import Purpose, SiteRecord
from wibam_core.site import Site

router = APIRouter(prefix="/v1/sites", tags=["sites"], responses=documented(401), route_class=BoundedJsonRoute)


@router.post("", status_code=201, summary="Describe a site", responses=documented(413, 422))
def create(site: Site, services: ServicesDep) -> SiteOut:
    """The body is the same document as the ``site.json`` of a site folder: cameras, calibration, signal regions."""
    site.check()
    return SiteOut.of(services.sites.add_site(site))


@router.get("", summary="List sites", dependencies=[ONLY_KNOWN_PARAMETERS], responses=documented(422))
def list_sites(services: ServicesDep, page: PageDep, made: MadeDep, text: Text = "") -> list[SiteOut]:
    """The newest first."""
    found = services.sites.sites(page.one_more, text=text, made=made, after=page.place)
    return [SiteOut.of(record) for record in page.cut(found, lambda record: (record.created_at, record.id))]


@router.get("/{site_id}", summary="Look at a site", responses=documented(404))
def get(site_id: str, services: ServicesDep, response: Response) -> SiteOut:
    """The header `ETag` has the version of the description, for the `If-Match` of describing it anew."""
    return _out(services, services.sites.site(site_id), response)


@router.put("/{site_id}", summary="Describe a site anew", responses=documented(404, 412, 413, 422))
def replace(
    site_id: str,
    site: Site,
    services: ServicesDep,
    response: Response,
    if_match: Annotated[
        str | None,
        Header(max_length=80, description="the `ETag` of the description that yours was made from; any without it"),
    ] = None,
) -> SiteOut:
    """The whole document, with what was wrong corrected. Recordings stay with the cameras of the same id; those of
    cameras that the site no longer has are taken off it.

    Jobs keep the description that they were created with, even when they are restarted: create a new job to use this
    one. It reuses the stages that the change does not touch. With another origin, a GeoTIFF that was placed by the one
    before has no place; `note` of `map` says so.

    With `If-Match`, what others have changed meanwhile is not overwritten: nothing is changed then (412,
    `changed_meanwhile`).
    """
    site.check()
    made_from = None if if_match is None or if_match.strip() == "*" else if_match.strip().strip('"')
    return _out(services, services.sites.replace_site(site_id, site, made_from), response)


@router.delete("/{site_id}", status_code=204, summary="Delete a site", responses=documented(404, 409))
def delete(site_id: str, services: ServicesDep) -> None:
    """Its recordings go with it. A site that still has jobs is kept (409)."""
    for file_id in services.sites.delete_site(site_id):
        services.folder.remove_file(file_id)


@router.get(
    "/{site_id}/recordings",
    summary="List the files of a site",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(404, 422),
)
def recordings(
    site_id: str,
    services: ServicesDep,
    page: PageDep,
    purpose: Annotated[list[Purpose] | None, Query(max_length=10, description="for any of these purposes")] = None,
    camera: Annotated[list[str] | None, Query(max_length=100, description="of any of these cameras")] = None,
) -> list[RecordingOut]:
    """Detector, labels, network, and the recordings by camera. Upload again to replace one."""
    wanted = [
        file
        for file in services.sites.files(site_id)
        if (not purpose or file.purpose in purpose) and (not camera or file.camera_id in camera)
    ]
    files = page.of_all(wanted, lambda file: (file.purpose.value, file.camera_id, file.filename, file.id), *[str] * 4)
    probes = _probes(services, site_id)
    return [RecordingOut.of(file, probes.get(file.id) if file.purpose is Purpose.RECORDING else None) for file in files]


@router.delete(
    "/{site_id}/recordings/{file_id}", status_code=204, summary="Take a file off a site", responses=documented(404)
)
def delete_recording(site_id: str, file_id: str, services: ServicesDep) -> None:
    """Jobs that were made with the file keep it until they are deleted."""
    services.sites.retire_file(site_id, file_id)


@router.get("/{site_id}/amounts", summary="How good networks are by the amount of footage", responses=documented(404))
def amounts_of_footage(site_id: str, services: ServicesDep) -> list[JobAmount]:
    """Of the evaluated ones among the newest 100 jobs of the site; the smallest amount first. Jobs whose test part and
    labels are the same can be compared: keep `dataset.train_share` + `dataset.val_share` when you vary the first."""
    services.sites.site(site_id)
    return amounts(services.results, services.jobs.jobs(site_id, limit=100, kind=JobKind.TRAINING))


def _out(services: Services, record: SiteRecord, response: Response) -> SiteOut:
    response.headers["ETag"] = f'"{record.version}"'
    return SiteOut.of(record, services.maps.find(record.id))


def _probes(services: Services, site_id: str) -> dict[str, VideoInfo]:
    """File id -> what the preflight stage of the site's latest jobs found out about it."""
    found: dict[str, VideoInfo] = {}
    for job in reversed(services.jobs.jobs(site_id, limit=5)):
        try:
            cameras = services.results.read(job, catalogue.PROBE).cameras
        except WibamError:
            continue
        found |= {
            file.id: cameras[camera] for camera, files in job.recordings.items() if camera in cameras for file in files
        }
    return found
