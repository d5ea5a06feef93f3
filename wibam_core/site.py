"""What a user says about a site: its cameras, calibration and signal regions. The body of ``POST /v1/sites``
and the ``site.json`` of a site folder are this same model.

A site folder holds ``site.json``, ``recordings/<camera id>.mp4`` (any container; several files of one camera lie in
``recordings/<camera id>/``), and optionally ``labels.parquet``
or ``labels.json`` (hand labels, for evaluation alone), ``detector.onnx`` (a 2D detector of the user's own) and
``network.safetensors`` (a 3D network of the user's own to start fine-tuning from).
"""

from __future__ import annotations

import re
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, FailFast, Field
from pydantic_core import PydanticCustomError

from wibam_core.errors import SiteFileError
from wibam_core.text import NotJson, NotUnicode, decode_text, nfc, read_json

_ID = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"


def _plain_id(given: Any) -> Any:
    if isinstance(given, str) and not re.match(_ID, given):
        raise PydanticCustomError(
            "plain_id",
            "an id begins with a letter from a to z or a digit, has these, - and _ alone, 64 at most: {given}",
            {"given": repr(given[:80])},
        )
    return given


#: Ids become file names inside our own folders, so they are plain.
CameraId = Annotated[str, Field(pattern=_ID), BeforeValidator(_plain_id)]
#: Larger than anything that is measured here: a UTM northing in centimetres has nine digits.
Number = Annotated[float, Field(ge=-1e10, le=1e10)]
Row3 = tuple[Number, Number, Number]
#: Distortion coefficients in OpenCV's order, which has 14 at most.
Distortion = Annotated[tuple[Number, ...], Field(max_length=14), FailFast()]
#: How a lens maps directions to pixels: OpenCV's pinhole with distortion, its fisheye (``cv2.fisheye``), or its
#: omnidirectional one (``cv2.omnidir``).
Lens = Literal["pinhole", "fisheye", "omnidirectional"]

#: A system may be used so far outside of where it is meant to be.
_NEAR_DEG = 5.0
_TO_RVEC = " Of a matrix it is cv2.Rodrigues(R), of a quaternion SciPy's Rotation.from_quat(q).as_rotvec()."
#: What other programs, and people, call fields.
_OTHERWISE = {
    "distortion": "dist",
    "dist_coeffs": "dist",
    "intrinsics": "K",
    "camera_matrix": "K",
    "r": "rvec",
    "rotation": "rvec",
    "t": "tvec",
    "translation": "tvec",
    "lens_model": "lens",
    "points": "correspondences",
    "roi": "region",
    "bbox": "region",
}


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _known_fields(cls, given: Any) -> Any:
        """Name a field that there is not before one that is missing, which it may stand for."""
        unknown = [name for name in given if name not in cls.model_fields] if isinstance(given, dict) else []
        if not unknown:
            return given
        name = str(unknown[0])
        by_letters = {field.lower(): field for field in cls.model_fields}
        near = get_close_matches(name.lower(), by_letters, 1)
        meant = _OTHERWISE.get(name.lower(), by_letters[near[0]] if near else None)
        raise PydanticCustomError(
            "unknown_field",
            "there is no field {name} here{meant}",
            {"name": repr(name[:80]), "meant": f"; is {meant} meant?" if meant in cls.model_fields else ""},
        )


class SignalRegion(_Model):
    """Where a signal head is seen: ``region`` is x, y, width, height in px of the recording.

    Heads that show the same phase carry the same ``id`` in every camera: their changes are matched by it.
    """

    id: str = Field(min_length=1, max_length=64)
    region: tuple[Number, Number, Number, Number]


class Correspondence(_Model):
    """A surveyed point: ``world`` x, y, z in m and ``pixel`` u, v in px of the recording."""

    world: Row3
    pixel: tuple[Number, Number]


#: A list stops at its first entry that is wrong: each of thousands of wrong ones would be told otherwise.
Correspondences = Annotated[tuple[Correspondence, ...], Field(max_length=10_000), FailFast()]


class _Calibration(_Model):
    """``picture_px`` is the width and height of the picture that it was made on; None: as the camera's."""

    picture_px: tuple[int, int] | None = None


class GivenIntrinsics(_Calibration):
    """K and the lens. ``dist`` is in OpenCV's order for this lens, ``xi`` that of an omnidirectional one."""

    K: tuple[Row3, Row3, Row3]
    dist: Distortion = ()
    lens: Lens = "pinhole"
    xi: float = Field(default=0.0, ge=0, le=10)


class MatrixCalibration(GivenIntrinsics):
    """Ready matrices. ``rvec`` and ``tvec`` are OpenCV's (world to camera, m)."""

    kind: Literal["matrices"] = "matrices"
    rvec: Row3
    tvec: Row3


class PnPCalibration(GivenIntrinsics):
    """Known intrinsics; the pose is solved by perspective-n-point."""

    kind: Literal["pnp"] = "pnp"
    correspondences: Correspondences


class _SolvedLens(_Calibration):
    """A lens that is solved from points: its one focal length is that of square pixels.

    ``pixel_aspect`` is the width of a pixel of the recording over its height: 1.333 where 960x720 px are shown as
    1280x720.
    """

    pixel_aspect: float = Field(default=1.0, ge=0.25, le=4.0)


class HomographyCalibration(_SolvedLens):
    """Ground points only (z = 0): focal length and pose follow from the homography (principal point centred)."""

    kind: Literal["homography"] = "homography"
    correspondences: Correspondences


class PointsCalibration(_SolvedLens):
    """Points on the road and above it: focal length, k1 and pose follow from them."""

    kind: Literal["points"] = "points"
    correspondences: Correspondences


Calibration = Annotated[
    MatrixCalibration | PnPCalibration | HomographyCalibration | PointsCalibration, Field(discriminator="kind")
]


class ViewDirection(_Model):
    """A pinhole view to cut from the picture of a wide lens.

    Attributes:
        azimuth_deg: where its middle looks over the ground, about the world's +Z, counter-clockwise from +X.
        down_deg: how far its middle looks below the horizon.
        across_deg, height_deg: the angles that it spans.
    """

    azimuth_deg: float = Field(ge=-360, le=360)
    down_deg: float = Field(default=35.0, ge=-30, le=89)
    across_deg: float = Field(default=90.0, ge=20, le=120)
    height_deg: float = Field(default=70.0, ge=20, le=110)


#: A name that is the last part of a path, on any system.
RecordingName = Annotated[str, Field(max_length=255, pattern=r"^[^/\\\x00-\x1f\x7f]+$"), AfterValidator(nfc)]


class SiteCamera(_Model):
    """One camera. ``width_px`` and ``height_px`` are the size that calibration and regions refer to.

    ``views`` are those to cut from the picture of a wide lens; left out, they are chosen.
    ``recordings`` names the files of a recording of several (chapters, numbered parts), in any order; without it the
    recording is one file, whatever its name.
    """

    id: CameraId
    width_px: int = Field(gt=0, le=16384)
    height_px: int = Field(gt=0, le=16384)
    calibration: Calibration
    signals: Annotated[tuple[SignalRegion, ...], Field(max_length=64), FailFast()] = ()
    recordings: Annotated[tuple[RecordingName, ...], Field(max_length=1000), FailFast()] = ()
    views: Annotated[tuple[ViewDirection, ...], Field(max_length=8), FailFast()] = ()

    @property
    def is_wide(self) -> bool:
        """Whether its lens is no pinhole."""
        return isinstance(self.calibration, GivenIntrinsics) and self.calibration.lens != "pinhole"


class Origin(_Model):
    """Where the world's origin lies on Earth; for exports alone, nothing is computed with it.

    Attributes:
        latitude_deg, longitude_deg: in WGS 84, positive to the north and to the east.
        altitude_m: of the world's z = 0, above the WGS 84 ellipsoid; None where it is not known.
        x_axis_bearing_deg: whither the world's X axis points, clockwise from north; 90 is east, so that Y is north.
        epsg: code of the projected coordinate reference system, in metres, of CSV exports; None is the UTM zone.
    """

    latitude_deg: float = Field(ge=-90, le=90)
    longitude_deg: float = Field(ge=-180, le=180)
    altitude_m: float | None = Field(default=None, ge=-1000, le=10000)
    x_axis_bearing_deg: float = Field(default=90.0, ge=-360, le=360)
    epsg: int | None = Field(default=None, ge=1024, le=32767)


class Site(_Model):
    """A site. The first camera is the reference: its clock is the result's clock."""

    name: str = Field(min_length=1, max_length=200)
    cameras: Annotated[tuple[SiteCamera, ...], Field(min_length=1, max_length=32), FailFast()]
    origin: Origin | None = None

    @pydantic.model_validator(mode="after")
    def _unique_ids(self) -> Site:
        ids = [camera.id for camera in self.cameras]
        if len({i.lower() for i in ids}) != len(ids):
            raise PydanticCustomError(
                "same_id", "camera ids must differ (letter case aside): {ids}", {"ids": ", ".join(ids)}
            )
        return self

    def check(self) -> None:
        """Refuse what no recording can fit; done once, when a description comes in.

        Raises:
            SiteFileError: the name has a control character, a camera has a focal length that is not positive, or a
                signal region is empty or lies outside the image, or the origin's EPSG code is no projected system in
                metres.
        """
        _check_text(self.name, "the name of the site")
        if self.origin is not None and self.origin.epsg is not None:
            _check_epsg(self.origin, self.origin.epsg)
        for camera in self.cameras:
            _check_recordings(camera)
            _check_picture(camera)
            if isinstance(camera.calibration, GivenIntrinsics):
                _check_focal_length(camera.id, camera.calibration.K)
            if camera.views and not camera.is_wide:
                raise SiteFileError(
                    f"camera {camera.id}: views are cut from the pictures of wide lenses, and its lens is a pinhole",
                    hint='Leave views out, or say "lens": "fisheye" in its calibration.',
                    camera=camera.id,
                )
            for signal in camera.signals:
                _check_text(signal.id, f"camera {camera.id}: the id of a signal", camera=camera.id)
                _check_region(camera, signal)

    @property
    def camera_ids(self) -> tuple[str, ...]:
        return tuple(camera.id for camera in self.cameras)

    @classmethod
    def parse(cls, text: str | bytes) -> Site:
        """From JSON text.

        Raises:
            SiteFileError: naming the first field that is wrong, or how the text is encoded.
        """
        try:
            site = cls.model_validate(read_json(decode_text(text) if isinstance(text, bytes) else text))
        except NotUnicode as error:
            raise SiteFileError(f"site description: {error}", hint="Save it as UTF-8.") from error
        except NotJson as error:
            raise SiteFileError(f"site description: {error}", hint="Correct the JSON text there.") from error
        except pydantic.ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "the file"
            raise SiteFileError(
                f"site description: {where}: {first['msg']}",
                hint=f"Correct it; docs/site-format.md describes them all.{_TO_RVEC if 'rvec' in where else ''}",
                errors=[{"field": ".".join(map(str, e["loc"])), "problem": e["msg"]} for e in error.errors()[:20]],
            ) from error
        site.check()
        return site

    @classmethod
    def load(cls, path: Path) -> Site:
        """From a ``site.json``."""
        if not path.is_file():
            raise SiteFileError(f"{path} does not exist", hint="A site folder holds a site.json.")
        return cls.parse(path.read_bytes())


def _check_text(text: str, what: str, **details: str) -> None:
    if any(ord(character) < 32 or ord(character) == 127 for character in text):
        raise SiteFileError(f"{what}, {text!r}, has a control character", hint="Use plain text.", **details)


def _check_picture(camera: SiteCamera) -> None:
    made_on = camera.calibration.picture_px
    if made_on is not None and made_on != (camera.width_px, camera.height_px):
        across, down = camera.width_px / max(made_on[0], 1), camera.height_px / max(made_on[1], 1)
        raise SiteFileError(
            f"camera {camera.id}: its calibration was made on a picture of {made_on[0]}x{made_on[1]} px, its recording "
            f"has {camera.width_px}x{camera.height_px} px",
            hint="Calibrate on a picture of the recording's size; where both show the same section, multiply what is "
            f"in px by {across:.6g} across and {down:.6g} down.",
            camera=camera.id,
        )


def _check_recordings(camera: SiteCamera) -> None:
    names = camera.recordings
    if len(set(names)) != len(names) or any(name in (".", "..") for name in names):
        raise SiteFileError(
            f"camera {camera.id}: the names of its recordings must be file names that differ: {', '.join(names)}",
            hint="List each file of the camera once.",
            camera=camera.id,
        )


def _check_epsg(origin: Origin, epsg: int) -> None:
    from pyproj import CRS  # takes longer to import than all else here, and hardly any site names a system
    from pyproj.exceptions import CRSError

    try:
        crs = CRS.from_epsg(epsg)
        fits = crs.is_projected and not crs.is_compound and all(a.unit_conversion_factor == 1 for a in crs.axis_info)
    except CRSError:
        fits = False
    if not fits:
        raise SiteFileError(
            f"origin.epsg: EPSG:{epsg} is no projected coordinate reference system in metres",
            hint="Name one, e.g. 32632 for UTM zone 32 north, or leave it out.",
            epsg=epsg,
        )
    place = origin.latitude_deg, origin.longitude_deg
    if not _is_used_at(crs.area_of_use, *place):
        exchanged = "Are latitude and longitude exchanged? " if _is_used_at(crs.area_of_use, *reversed(place)) else ""
        raise SiteFileError(
            f"the origin at latitude {place[0]:g}, longitude {place[1]:g} lies far outside of where EPSG:{epsg} "
            f"({crs.name}) is used",
            hint=f"{exchanged}Name the system of the site, or leave epsg out for its UTM zone.",
            epsg=epsg,
        )


def _is_used_at(area: Any, latitude_deg: float, longitude_deg: float) -> bool:
    """Whether a system, by pyproj's area of its use, is used near a place; true where nobody says."""
    if area is None or area.west > area.east:
        return True
    within_lat = area.south - _NEAR_DEG <= latitude_deg <= area.north + _NEAR_DEG
    aside_deg = (longitude_deg - (area.west + area.east) / 2 + 180) % 360 - 180  # across the antimeridian, too
    return within_lat and abs(aside_deg) <= (area.east - area.west) / 2 + _NEAR_DEG


def _check_focal_length(camera_id: str, K: tuple[Row3, Row3, Row3]) -> None:
    fx, fy = K[0][0], K[1][1]
    if fx <= 0 or fy <= 0:
        raise SiteFileError(
            f"camera {camera_id}: the focal lengths in K must be positive, not {fx:g} and {fy:g}",
            hint="K is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels of the recording's size.",
            camera=camera_id,
        )


def _check_region(camera: SiteCamera, signal: SignalRegion) -> None:
    x, y, width, height = signal.region
    shown = f"camera {camera.id}, signal {signal.id}: region {x:g},{y:g},{width:g},{height:g}"
    hint = "Give x, y, width, height in pixels of the recording, around all lamps of one signal head."
    if width <= 0 or height <= 0:
        raise SiteFileError(f"{shown} is empty", hint=hint, camera=camera.id, signal=signal.id)
    if x >= camera.width_px or y >= camera.height_px or x + width <= 0 or y + height <= 0:
        raise SiteFileError(
            f"{shown} lies outside the image of {camera.width_px}x{camera.height_px} px",
            hint=hint,
            camera=camera.id,
            signal=signal.id,
        )
    across = min(round(x + width), camera.width_px) - max(round(x), 0)
    down = min(round(y + height), camera.height_px) - max(round(y), 0)
    if min(across, down) < 2 or max(across, down) < 4:
        shares = max(x + width, y + height) <= 1
        raise SiteFileError(
            f"{shown} has less than 2 x 4 px in the image of {camera.width_px}x{camera.height_px} px",
            hint=f"{hint} Are these shares of its width and height?" if shares else hint,
            camera=camera.id,
            signal=signal.id,
        )
