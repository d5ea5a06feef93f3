"""What pictures of a job are drawn from: its cameras, its road users' classes, and the frames of its recordings."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Header, Path, Query, Response
from pydantic import BaseModel, Field

from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.schemas import MapOut
from api.services import ServicesDep
from api.track_parameters import Int64
from wibam_core.adapters.findings import findings
from wibam_core.artifacts import catalogue
from wibam_core.documents.findings import InstantFindings
from wibam_core.errors import InputError, NotFound
from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.camera import Camera
from wibam_core.road_users import CLASSES
from wibam_core.site import Lens, Origin

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"], responses=documented(401, 404, 409))


class SceneCameraOut(BaseModel):
    """A calibrated camera. Pixels are those of the recording; frames are stored ``stored_width_px`` wide."""

    id: str
    width_px: int
    height_px: int
    K: list[list[float]] = Field(description="(3, 3) intrinsic matrix in px")
    dist: list[float] = Field(description="distortion coefficients in OpenCV order")
    lens: Lens
    xi: float = Field(description="of an omnidirectional lens")
    distortion_limit: float | None = Field(
        description="undistorted radius (of a pinhole: tan of the angle to the axis) beyond which the distortion goes "
        "on in straight lines; null where there is none"
    )
    limit_rad: float | None = Field(description="angle to the axis beyond which a wide lens sees nothing")
    T_world_cam: list[list[float]] = Field(description="(3, 4) pose [R|t] in m: x_world = R x_cam + t")
    stored_width_px: int | None = Field(description="of the frames; null before they are read")
    stored_height_px: int | None


class SceneClassOut(BaseModel):
    """A class of road users, and how to draw it."""

    name: str
    colour: str = Field(examples=["#0072b2"])
    size_m: tuple[float, float, float] = Field(description="usual length, width and height")
    vulnerable: bool


class SceneOut(BaseModel):
    """What a picture of the job needs besides tracks and frames."""

    name: str = Field(description="of the site")
    reference: str = Field(description="id of the camera whose clock is the results'")
    cameras: list[SceneCameraOut]
    classes: list[SceneClassOut]
    origin: Origin | None
    map: MapOut | None = Field(description="the site's picture from above; `/map` of the job is the picture")


class InstantsOut(BaseModel):
    """The instants of which frames are stored, ascending, and when each camera's frame was exposed."""

    times_ns: list[int] = Field(description="instants on the reference clock")
    frame_times_ns: dict[str, list[int | None]] = Field(
        description="camera id -> for each instant the exposure on the reference clock; null where it has no frame"
    )


def scene_camera(camera_id: str, camera: Camera, stored: tuple[int, int] | None) -> SceneCameraOut:
    """A camera as the API says it."""
    wide = camera.wide_lens if camera.is_wide else None
    limit = getattr(wide, "distortion_limit", np.inf) if wide is not None else camera.distortion_limit
    return SceneCameraOut(
        id=camera_id,
        width_px=camera.width_px,
        height_px=camera.height_px,
        K=camera.K.tolist(),
        dist=camera.dist.tolist(),
        lens=camera.lens,
        xi=camera.xi,
        limit_rad=None if wide is None else wide.limit_rad,
        distortion_limit=limit if np.isfinite(limit) else None,
        T_world_cam=camera.T_world_cam.matrix[:3].tolist(),
        stored_width_px=None if stored is None else stored[0],
        stored_height_px=None if stored is None else stored[1],
    )


@router.get("/scene", summary="Cameras and classes, for drawing")
def scene(job_id: str, services: ServicesDep) -> SceneOut:
    """As the job uses the cameras; before that is known, as it calibrated them."""
    job = services.jobs.job(job_id)
    has = partial(services.results.has, job)
    rig = services.results.read(job, catalogue.RIG if has(catalogue.RIG) else catalogue.CALIBRATED_RIG)
    store = services.results.frames(job) if has(catalogue.FRAMES) else None
    stored = {} if store is None else {camera_id: store.size(camera_id) for camera_id in store.camera_ids}
    return SceneOut(
        name=job.site.name,
        reference=next(iter(rig)),  # a view, where the lens of the reference camera is wide
        cameras=[scene_camera(camera_id, camera, stored.get(camera_id)) for camera_id, camera in rig.items()],
        classes=[
            SceneClassOut(
                name=item.value,
                colour=item.traits.colour,
                size_m=item.traits.size.size_m,
                vulnerable=item.traits.vulnerable,
            )
            for item in CLASSES
        ],
        origin=job.site.origin,
        map=MapOut.of(services.maps.find(job.site_id), job.site.origin),
    )


@router.get(
    "/instants",
    summary="Which frames are stored",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(422),
)
def instants(
    job_id: str,
    services: ServicesDep,
    start_ns: Annotated[Int64 | None, Query(description="reference clock; counts in")] = None,
    end_ns: Annotated[Int64 | None, Query(description="reference clock; does not count in")] = None,
) -> InstantsOut:
    """`GET /v1/jobs/{job_id}/frames/{camera}` gives them as pictures."""
    store = services.results.frames(services.jobs.job(job_id))
    sets = [
        instant
        for instant in store.frame_sets
        if (start_ns is None or instant.time_ns >= start_ns) and (end_ns is None or instant.time_ns < end_ns)
    ]
    return InstantsOut(
        times_ns=[instant.time_ns for instant in sets],
        frame_times_ns={
            camera_id: [instant.frame_times_ns.get(camera_id) for instant in sets] for camera_id in store.camera_ids
        },
    )


@router.get("/instants/{time_ns}", summary="What was found at an instant", responses=documented(422))
def instant(
    job_id: str, time_ns: Annotated[int, Path(ge=-(2**62), le=2**62)], services: ServicesDep
) -> InstantFindings:
    """2D boxes of all cameras and how they were associated, fits, and in the test part what the network says of single
    frames, before and after fine-tuning. Of an instant of the `split`; others have fewer findings, or none."""
    job = services.jobs.job(job_id)
    if all(one.time_ns != time_ns for one in services.results.frames(job).frame_sets):
        raise NotFound(
            f"job {job_id} has no instant at {time_ns} ns", hint=f"GET /v1/jobs/{job_id}/instants lists them."
        )
    return findings(services.results, job, time_ns)


@router.get(
    "/frames/{camera}",
    summary="A stored frame",
    response_class=Response,
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses={200: {"content": {"image/jpeg": {}}}, 304: {"description": "Not Modified"}, **documented(422)},
)
def frame(
    job_id: str,
    camera: str,
    services: ServicesDep,
    time_ns: Annotated[int, Query(ge=-(2**62), le=2**62, description="the instant nearest to it is shown")],
    width_px: Annotated[int | None, Query(ge=16, le=16384, description="no wider than this; never enlarged")] = None,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """As JPEG. The header `X-Wibam-Time` says the instant in ns on the reference clock. Who keeps a frame asks with its
    `ETag` whether it is still the one: a restart of the job may make others."""
    job = services.jobs.job(job_id)
    store = services.results.frames(job)
    if camera not in store.camera_ids:
        raise NotFound(
            f"job {job_id} has no frames of camera {camera!r}", hint=f"Its cameras are {', '.join(store.camera_ids)}."
        )
    times = [instant.time_ns for instant in store.frame_sets if camera in instant.local_times_ns]
    if not times:
        raise NotFound(f"no instant has a frame of camera {camera}", hint="GET /v1/jobs/{id}/instants lists them.")
    nearest = _nearest(times, time_ns)
    stage = job.stage(catalogue.FRAMES.stage)
    etag = f'"{stage.hash[:16] if stage else ""}-{camera}-{nearest}-{width_px or 0}"'
    headers = {"ETag": etag, "Cache-Control": "private, no-cache", "X-Wibam-Time": str(nearest)}
    if if_none_match == etag:
        return Response(status_code=304, headers=headers)
    jpeg = _jpeg(store, camera, nearest, width_px)
    return Response(jpeg, media_type="image/jpeg", headers={**headers, "X-Content-Type-Options": "nosniff"})


def _nearest(times_ns: list[int], wanted_ns: int) -> int:
    """Of ascending times the one nearest to the wanted."""
    at = int(np.searchsorted(times_ns, wanted_ns))
    return min(times_ns[max(at - 1, 0) : at + 1] or times_ns[-1:], key=lambda time_ns: abs(time_ns - wanted_ns))


def _jpeg(store: FrameStore, camera_id: str, time_ns: int, width_px: int | None) -> bytes:
    """A frame of an instant as it is stored, or shrunk."""
    local_ns = next(i.local_times_ns[camera_id] for i in store.frame_sets if i.time_ns == time_ns)
    if width_px is None or width_px >= store.size(camera_id)[0]:
        return store.jpeg_at(camera_id, local_ns)
    import cv2

    from wibam_core.geometry.pixels import shrunk_image

    done, data = cv2.imencode(".jpg", shrunk_image(store.image_at(camera_id, local_ns), width_px))
    if not done:
        raise InputError("the frame cannot be shrunk", hint="Leave width_px out.")
    return data.tobytes()
