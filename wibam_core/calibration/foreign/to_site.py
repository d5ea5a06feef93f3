"""From what files of other programs say to a camera of a site description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wibam_core.calibration.foreign.base import FoundCamera, Intrinsics, SurveyedPoints, short_crs, unknown_crs
from wibam_core.errors import InputError
from wibam_core.exchange.earth import Earth
from wibam_core.geometry.pixels import resized_intrinsics, scale_of
from wibam_core.site import (
    Calibration,
    GivenIntrinsics,
    HomographyCalibration,
    MatrixCalibration,
    Origin,
    PnPCalibration,
    PointsCalibration,
    SiteCamera,
)

if TYPE_CHECKING:
    from pyproj import CRS

Array = NDArray[np.float64]
Size = tuple[int, int]

#: Pictures whose sides differ by this share more than by one factor are no resized ones of each other.
_ASPECT = 0.01


@dataclass(frozen=True)
class Described:
    """A camera as `site.json` says it, the origin that its world then has, and what a person should know."""

    camera: SiteCamera
    origin: Origin | None
    notes: tuple[str, ...]


def chosen(found: Sequence[FoundCamera], names: Sequence[str], file: str) -> FoundCamera:
    """The camera of a file that is meant: the only one, or that with one of the names.

    Raises:
        InputError: there is none, or several.
    """
    if len(found) == 1:
        return found[0]
    meant = [camera for camera in found if camera.name in names]
    if len(meant) != 1:
        there = ", ".join(camera.name for camera in found) or "none"
        raise InputError(f"{file} has several cameras: {there}", hint="Say which one is meant with --name.")
    return meant[0]


def describe(
    camera_id: str,
    found: Sequence[FoundCamera],
    size_px: Size,
    before: SiteCamera | None = None,
    origin: Origin | None = None,
) -> Described:
    """A camera of what its files say.

    Points and a lens make a ``pnp``, a pose and a lens ``matrices``, points alone a ``homography`` or, where some of
    them are above the road, ``points``. What the files leave out is taken from what the site said of the camera before.

    Args:
        camera_id: its name at the site.
        found: what each file says of it.
        size_px: of its recording.
        before: how the site describes it so far.
        origin: of the site's world, which points on Earth are counted from; None: these points get one.

    Raises:
        InputError: lens, pose and points do not make a calibration, or are of another picture.
    """
    notes = [note for one in found for note in one.notes]
    lens = next((one.intrinsics for one in found if one.intrinsics is not None), None)
    points = next((one.points for one in found if one.points is not None), None)
    posed = next((one for one in found if one.rvec is not None and one.tvec is not None), None)
    old = None if before is None else before.calibration
    if lens is None and isinstance(old, GivenIntrinsics):
        lens = Intrinsics(np.array(old.K), np.array(old.dist), old.lens, old.xi)
        notes.append("K and the lens are those that the site had.")
    correspondences: list[dict[str, Any]] = []
    if points is not None:
        world, origin, said = _world(points, origin, raised=lens is not None)
        notes += said
        correspondences = [
            {"world": w.tolist(), "pixel": p.tolist()} for w, p in zip(world, points.pixels, strict=True)
        ]
    elif isinstance(old, PnPCalibration | HomographyCalibration | PointsCalibration) and posed is None:
        correspondences = [one.model_dump(mode="json") for one in old.correspondences]
    intrinsics: dict[str, Any] = {}
    if lens is not None:
        lens, said = _of_size(lens, size_px)
        notes += said
        intrinsics = {"K": lens.K.tolist(), "dist": lens.dist.tolist(), "lens": lens.lens, "xi": lens.xi}
    calibration: dict[str, Any]
    if correspondences:
        kind = "pnp" if intrinsics else "points" if _solves_lens(old, correspondences) else "homography"
        calibration = {"kind": kind, **intrinsics, "correspondences": correspondences}
        same_size = before is not None and size_px == (before.width_px, before.height_px)
        if not intrinsics and same_size and isinstance(old, HomographyCalibration | PointsCalibration):
            calibration["pixel_aspect"] = old.pixel_aspect
        if posed is not None:
            notes.append("The pose in the files is left out: it follows from the points.")
    elif posed is not None and posed.rvec is not None and posed.tvec is not None and intrinsics:
        pose = {"rvec": posed.rvec.tolist(), "tvec": posed.tvec.tolist()}
        calibration = {"kind": MatrixCalibration.model_fields["kind"].default, **intrinsics, **pose}
    else:
        missing = "lens" if not intrinsics else "pose, and no surveyed points"
        raise InputError(
            f"the files say nothing of the {missing} of camera {camera_id}",
            hint="Name a file with points, too (GeoJSON or QGIS), or one with the pose or the lens.",
        )
    kept: Mapping[str, Any] = {} if before is None else before.model_dump(mode="json", include={"signals", "views"})
    width, height = size_px
    entry = {"id": camera_id, "width_px": width, "height_px": height, "calibration": calibration, **kept}
    return Described(SiteCamera.model_validate(entry), origin, tuple(dict.fromkeys(notes)))


def _solves_lens(old: Calibration | None, correspondences: Sequence[Mapping[str, Any]]) -> bool:
    """Whether points without a lens are to tell it: some are above the road, or the site had it so."""
    return isinstance(old, PointsCalibration) or any(one["world"][2] for one in correspondences)


def _of_size(lens: Intrinsics, size_px: Size) -> tuple[Intrinsics, list[str]]:
    """The lens for pictures of another size, if they show the same.

    Raises:
        InputError: they do not.
    """
    if lens.size_px is None or lens.size_px == size_px:
        return lens, []
    scale = scale_of(lens.size_px, size_px)
    named = f"{lens.size_px[0]}x{lens.size_px[1]} px, and the recording has {size_px[0]}x{size_px[1]} px"
    if abs(scale[0] / scale[1] - 1) > _ASPECT:
        raise InputError(
            f"the lens was calibrated at {named}",
            hint="These are different crops: calibrate with pictures of the recording's size.",
        )
    return replace(lens, K=resized_intrinsics(lens.K, scale), size_px=size_px), [
        f"K was scaled: the lens was calibrated at {named}."
    ]


def _world(points: SurveyedPoints, origin: Origin | None, *, raised: bool) -> tuple[Array, Origin | None, list[str]]:
    """Points (N, 3) in the site's world, its origin, and how they came there.

    Args:
        points: surveyed.
        origin: that the site has.
        raised: whether altitudes count; else points without a height are on the road.
    """
    heights = np.nan_to_num(points.coordinates[:, 2])
    if points.crs is None:
        where = "The file names no coordinate system: coordinates are taken as metres of the site's world."
        return np.column_stack([points.coordinates[:, :2], heights]), origin, [where]
    longitude, latitude = _geographic(points)
    notes = []
    if origin is None:
        known = points.altitudes_m[np.isfinite(points.altitudes_m)]
        origin = Origin(
            latitude_deg=round(float(np.median(latitude)), 7),
            longitude_deg=round(float(np.median(longitude)), 7),
            altitude_m=round(float(np.median(known)), 3) if len(known) else None,
        )
        notes.append("The site had no origin: it is amid these points now, with X to the east and Y to the north.")
    placed = Earth(origin).world(longitude, latitude, points.altitudes_m)
    notes.append(
        f"World coordinates are metres from {origin.latitude_deg:.7f}, {origin.longitude_deg:.7f} (WGS 84), "
        f"X at bearing {origin.x_axis_bearing_deg:g}°; the points came in {short_crs(points.crs)}."
    )
    if raised and origin.altitude_m is not None:
        above = np.where(np.isnan(points.altitudes_m), 0.0, placed[:, 2])
        heights = np.where(np.isnan(points.coordinates[:, 2]), above, heights)
    return np.column_stack([placed[:, :2], heights]), origin, notes


#: Projected systems are used a little beyond their area, as a zone's for a whole town, degrees.
_BESIDE_DEG = 5.0
_TURN_DEG = 360.0


def _geographic(points: SurveyedPoints) -> tuple[Array, Array]:
    """Longitude and latitude (N,) in WGS 84.

    Raises:
        InputError: the coordinate reference system is not known, or places nothing.
    """
    from pyproj import CRS, Transformer  # takes longer to import than all else here
    from pyproj.exceptions import CRSError, ProjError
    from pyproj.network import set_network_enabled  # type: ignore[attr-defined]  # its stub does not list it

    set_network_enabled(active=False)
    try:
        crs = CRS.from_user_input(points.crs)
        transformer = Transformer.from_crs(crs, 4326, always_xy=True)
        longitude, latitude = transformer.transform(*points.coordinates[:, :2].T)
    except (CRSError, ProjError) as error:
        raise unknown_crs(points.crs or "") from error
    if not (np.isfinite(longitude).all() and np.isfinite(latitude).all()):
        raise InputError(
            "some points lie nowhere on Earth", hint=f"Are they in {short_crs(points.crs or '')}, easting first?"
        )
    if (np.abs(longitude) > _TURN_DEG).any() or (np.abs(latitude) > _TURN_DEG / 4).any():
        raise InputError(
            f"longitude {longitude[0]:.10g} and latitude {latitude[0]:.10g} are no degrees",
            hint="Say which system they are in, as EPSG:25832, where they are easting and northing. In GeoJSON, "
            "longitude comes first.",
        )
    _check_within(crs, points.crs or "", float(np.median(longitude)), float(np.median(latitude)))
    return np.asarray(longitude), np.asarray(latitude)


def _check_within(crs: CRS, said: str, longitude: float, latitude: float) -> None:
    """Raises:
    InputError: a place lies far outside of where a projected system is used, and where its metres are none any more.
    """
    area = crs.area_of_use if crs.is_projected else None
    if area is None or area.west > area.east:
        return
    beside = max(area.west - longitude, longitude - area.east, area.south - latitude, latitude - area.north)
    if beside > _BESIDE_DEG:
        raise InputError(
            f"the points would lie at latitude {latitude:.4f}, longitude {longitude:.4f}, {beside:.0f}° outside of "
            f"where {short_crs(said)} is used ({area.name})",
            hint="Is it another system, or another zone? Are easting and northing swapped, or in feet for metres?",
        )
