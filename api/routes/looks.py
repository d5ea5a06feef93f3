"""What one needs while one describes a site: frames and signals of recordings, and cameras solved from points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field

from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.routes.scene import SceneCameraOut, scene_camera
from api.schemas import ErrorOut
from api.services import Services, ServicesDep
from wibam_core.adapters.glimpses import ForeignCalibration, GlimpseRequest
from wibam_core.documents.calibration import CameraResiduals
from wibam_core.documents.synchronisation import SeenChange
from wibam_core.documents.warnings import Caution
from wibam_core.errors import InputError, NotFound
from wibam_core.jobs.records import Purpose, StoredFile
from wibam_core.site import Origin, RecordingName, SignalRegion, SiteCamera

router = APIRouter(prefix="/v1/sites/{site_id}/recordings/{file_id}", tags=["sites"], responses=documented(401, 404))
calibration_router = APIRouter(prefix="/v1/calibration", tags=["sites"], responses=documented(401))
#: Characters of a calibration file over HTTP; larger ones, such as COLMAP's images of a whole survey, are for `wibam
#: calibration`.
_LONGEST_TEXT = 1 << 17
#: A file with an id never changes.
_KEPT = "private, max-age=86400, immutable"
Seconds = Annotated[float, Query(ge=0, le=1e7, allow_inf_nan=False, description="on the recording's own clock")]


class VideoHeaderOut(BaseModel):
    """What a recording's header says of it; a job measures it (`probe` of a recording)."""

    duration_s: float = Field(description="0 where the header does not say")
    fps: float = Field(description="0 where the header does not say")
    width_px: int
    height_px: int


class SignalStripOut(BaseModel):
    """What a region shows over a stretch of a recording."""

    from_s: float
    to_s: float
    changes: list[SeenChange] = Field(description="by time; none where the region shows no signal")


class SolvedCameraOut(BaseModel):
    """A camera as its calibration comes out; without `camera` and `residuals` where it does not."""

    camera: SceneCameraOut | None = None
    residuals: CameraResiduals | None = None
    problem: ErrorOut | None = Field(None, description="why these points give no camera")
    cautions: list[Caution] = Field(default=[], description="what is doubtful about it, and what to do")


class CalibrationFileIn(BaseModel):
    """A file of another program."""

    name: RecordingName = Field(description="its ending is part of what tells its format")
    text: str = Field(max_length=_LONGEST_TEXT)


class CalibrationFilesIn(BaseModel):
    """Files that together describe one camera."""

    camera: SiteCamera = Field(description="as the site has it; says the size of its pictures")
    files: list[CalibrationFileIn] = Field(min_length=1, max_length=8)
    names: list[Annotated[str, Field(max_length=255)]] = Field(
        default=[], max_length=8, description="what files with several cameras call this one, beside its id"
    )
    origin: Origin | None = Field(default=None, description="of the site, which points on Earth are counted from")


class ReadCalibrationOut(BaseModel):
    """A camera as files describe it."""

    camera: SiteCamera
    origin: Origin | None = Field(description="of the site: the given one, or one amid the points where it had none")
    formats: list[str] = Field(description="of each file")
    notes: list[str] = Field(description="what was taken for granted, changed or left out")


@router.get("/header", summary="Length, rate and size of a recording", responses=documented(422, 503))
def header(site_id: str, file_id: str, services: ServicesDep, response: Response) -> VideoHeaderOut:
    """From the header alone."""
    response.headers["Cache-Control"] = _KEPT
    answer, _ = services.glimpses.look(GlimpseRequest(look="header", path=_recording(services, site_id, file_id)))
    return VideoHeaderOut.model_validate(answer)


@router.get(
    "/frame",
    summary="A frame of a recording",
    response_class=Response,
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses={200: {"content": {"image/jpeg": {}}}, **documented(422, 503)},
)
def frame(
    site_id: str,
    file_id: str,
    services: ServicesDep,
    time_s: Seconds = 0.0,
    width_px: Annotated[int | None, Query(ge=16, le=16384, description="no wider than this")] = None,
) -> Response:
    """As JPEG, whatever the recording's codec. The header `X-Wibam-Time` says when it is shown, in ns."""
    path = _recording(services, site_id, file_id)
    request = GlimpseRequest(look="frame", path=path, start_ns=round(time_s * 1e9), width_px=width_px)
    answer, jpeg = services.glimpses.look(request)
    headers = {
        "X-Wibam-Time": str(answer["time_ns"]),
        "Cache-Control": _KEPT,
        "X-Content-Type-Options": "nosniff",
    }
    return Response(jpeg, media_type="image/jpeg", headers=headers)


@router.get(
    "/signal",
    summary="What a region shows over time",
    dependencies=[ONLY_KNOWN_PARAMETERS],
    responses=documented(422, 503),
)
def signal(
    site_id: str,
    file_id: str,
    services: ServicesDep,
    region: Annotated[str, Query(description="`x,y,width,height` in px of the recording", examples=["551,180,18,50"])],
    start_s: Seconds = 0.0,
    duration_s: Annotated[float, Query(gt=0, le=180, allow_inf_nan=False)] = 60.0,
) -> SignalStripOut:
    """The changes that synchronisation would see there: a wrong region shows none, or too many."""
    look = GlimpseRequest(
        look="signals",
        path=_recording(services, site_id, file_id),
        start_ns=round(start_s * 1e9),
        duration_ns=round(duration_s * 1e9),
        regions=(SignalRegion(id="region", region=_region(region)),),
    )
    answer, _ = services.glimpses.look(look)
    return SignalStripOut.model_validate(answer)


@calibration_router.post("/solve", summary="Solve one camera", responses=documented(413, 422))
def solve(camera: SiteCamera) -> SolvedCameraOut:
    """From its calibration as a site has it: pose, residuals of each point, what is doubtful. Nothing is kept.

    Points that give no camera, such as four on a line, are answered with a `problem`: whoever sets points one after
    another meets such on the way.
    """
    from wibam_core.calibration.rig import solve_camera
    from wibam_core.config import CalibrateConfig

    try:
        solved = solve_camera(camera, CalibrateConfig())
    except InputError as error:
        return SolvedCameraOut(problem=ErrorOut.model_validate(error.to_dict()))
    return SolvedCameraOut(
        camera=scene_camera(camera.id, solved.camera, None),
        residuals=solved.document(),
        cautions=list(solved.cautions),
    )


@calibration_router.post("/read", summary="Read files of other programs", responses=documented(413, 422, 503))
def read(given: CalibrationFilesIn, services: ServicesDep) -> ReadCalibrationOut:
    """What files of other programs say of one camera, as a site has it. Nothing is kept; `solve` tells how it fits.

    As `wibam calibration` does it: the parts that the files leave out are those that the site had. A process that
    reaches nothing else reads them.
    """
    files = ForeignCalibration.model_validate(given.model_dump(mode="json"))
    answer, _ = services.glimpses.look(GlimpseRequest(look="calibration"), files.model_dump_json().encode())
    return ReadCalibrationOut.model_validate(answer)


def _recording(services: Services, site_id: str, file_id: str) -> Path:
    """Where a site's recording lies.

    Raises:
        NotFound: the site has no such recording any more.
    """
    found: StoredFile | None = next((file for file in services.sites.files(site_id) if file.id == file_id), None)
    if found is None or found.purpose is not Purpose.RECORDING:
        raise NotFound(
            f"site {site_id} has no recording {file_id}",
            hint="It may have been replaced or deleted: GET /v1/sites/{id}/recordings lists what is there.",
        )
    return services.folder.file(found)


def _region(text: str) -> tuple[float, float, float, float]:
    hint = "Give x, y, width, height in pixels of the recording, for example 551,180,18,50."
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"region: {text!r} is not four numbers", hint=hint) from None
    if len(numbers) != 4 or not all(abs(number) < 1e6 for number in numbers) or min(numbers[2:]) <= 0:
        raise InputError(f"region: {text!r} is not x,y,width,height", hint=hint)
    return (numbers[0], numbers[1], numbers[2], numbers[3])
