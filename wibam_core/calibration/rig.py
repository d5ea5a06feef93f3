"""A site's calibration as the user gave it, to calibrated cameras."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.calibration.matrices import camera_from_matrices, intrinsics_cautions
from wibam_core.calibration.points import (
    MIN_POINTS,
    check_on_ground,
    check_points,
    level_cautions,
    repeated_point_cautions,
)
from wibam_core.calibration.poses import meant_by, repeated_cautions
from wibam_core.calibration.readings import Reading, Sighting, better_reading, turned_world
from wibam_core.calibration.residuals import Residuals, fit_cautions, misfit_problem
from wibam_core.calibration.unknown_lens import check_told
from wibam_core.calibration.view import GROUND_RANGE_M, check_view, is_plausible, view_cautions, visible_ground
from wibam_core.calibration.views import views_of_site
from wibam_core.config import CalibrateConfig
from wibam_core.documents.warnings import Caution
from wibam_core.errors import CalibrationError, NoOverlap
from wibam_core.geometry.camera import Camera
from wibam_core.scene import CameraRig
from wibam_core.site import Correspondence, MatrixCalibration, PnPCalibration, PointsCalibration, Site, SiteCamera

Array = NDArray[np.float64]

#: World points of a homography must lie this close to the ground.
_GROUND_TOLERANCE_M = 0.01
#: Clicks this close to the image, as a share of its longer side, are at its border.
_BESIDE = 0.01
#: Smaller pictures may be 100 px large.
_LEAST_SIDE_PX = 200
#: Mean misfits that clicks explain, and that they do not; between them, another reading of the numbers is a warning.
_GOOD_PX = 1.0
_BAD_PX = 5.0
_PAIRS_HINT = (
    "Check that each pixel belongs to its world point, that the world has Z up and the road at Z = 0, and that pixels "
    "are those of the recording's size."
)


def calibrate(site: Site, config: CalibrateConfig) -> tuple[CameraRig, dict[str, Residuals]]:
    """Solve every camera of a site.

    Returns:
        the rig, with the views that are cut from the pictures of wide lenses, and per camera the residuals of its
        calibration with what is doubtful about it.

    Raises:
        CalibrationError: naming the camera that cannot be solved, or whose median error exceeds the limit.
        NoOverlap: naming a camera that shares no ground with the others.
    """
    residuals: dict[str, Residuals] = {}
    for camera in site.cameras:
        try:
            residuals[camera.id] = solve_camera(camera, config)
        except CalibrationError as error:
            details = {"camera": camera.id, **error.details}
            raise CalibrationError(f"camera {camera.id}: {error.message}", hint=error.hint, **details) from error
    rig = CameraRig({camera_id: result.camera for camera_id, result in residuals.items()})
    try:
        check_overlap(rig)
    except NoOverlap as error:
        raise _meant_together(site, rig, error) from error
    for camera_id, caution in repeated_cautions(rig.mounted).items():
        solved = residuals[camera_id]
        residuals[camera_id] = replace(solved, cautions=(*solved.cautions, caution))
    return CameraRig(rig.mounted, views_of_site(site, rig.mounted)), residuals


def _meant_together(site: Site, rig: CameraRig, problem: NoOverlap) -> NoOverlap:
    """That cameras share no ground, with the convention by which poses given as matrices would, if there is one."""
    if not all(isinstance(camera.calibration, MatrixCalibration) for camera in site.cameras):
        return problem
    sentences = []
    for sentence, cameras in meant_by(rig.mounted):
        with suppress(NoOverlap):
            check_overlap(CameraRig(cameras))
            sentences.append(sentence)
    hint = " Or: ".join([*sentences, problem.hint])
    return NoOverlap(problem.message, hint=hint, **problem.details)


def solve_camera(camera: SiteCamera, config: CalibrateConfig) -> Residuals:
    """Solve one camera.

    Raises:
        CalibrationError: if it cannot be solved, or is none that looks at a road from above.
    """
    given = camera.calibration
    width_px, height_px = camera.width_px, camera.height_px
    if isinstance(given, MatrixCalibration):
        pose = given.rvec, given.tvec
        solved = camera_from_matrices(given.K, given.dist, *pose, width_px, height_px, given.lens, given.xi)
        cautions = [*intrinsics_cautions(solved), *view_cautions(solved)]
        return Residuals.of(given.kind, solved, np.zeros((0, 3)), np.zeros((0, 2)), cautions=cautions)
    world, pixels = _arrays(given.correspondences)
    if isinstance(given, PnPCalibration):
        lens = np.array(given.K), np.array(given.dist), given.lens, given.xi
        sighting = Sighting(world, pixels, width_px, height_px, *lens)
    else:
        sighting = Sighting(
            world,
            pixels,
            width_px,
            height_px,
            None,
            np.zeros(0),
            solves_lens=isinstance(given, PointsCalibration),
            pixel_aspect=given.pixel_aspect,
        )
    beside = [*_check_pixels(sighting), *repeated_point_cautions(world, pixels)]
    if given.kind == "homography":
        check_on_ground(world, _GROUND_TOLERANCE_M)
    result = _solved(given.kind, sighting, config.max_error_px)
    return replace(result, cautions=(*beside, *result.cautions))


def _solved(kind: str, sighting: Sighting, max_error_px: float) -> Residuals:
    """A camera from points.

    Raises:
        CalibrationError: there is none, or a doubtful one; with what the numbers more likely mean, where that is clear.
    """
    check_points(sighting.world, sighting.pixels)  # what this and the lens say is plain; other readings are not sought
    if sighting.K is not None:
        _check_shown(sighting.lens(sighting.K), sighting.pixels)
    try:
        camera, used = sighting.solve()
    except CalibrationError as error:
        raise _meant(better_reading(sighting), error) from error
    covariance = sighting.covariance(camera, used)
    if sighting.solves_lens:
        check_told(float(camera.K[0, 0]), None if covariance is None else covariance.focal_sd_px)
    levels = level_cautions(sighting.world, float(camera.centre_m[2]))
    try:
        check_view(camera)
    except CalibrationError as error:
        if camera.centre_m[2] > 0:
            raise
        # as good a fit as the view from above, where all points are on the ground
        below = CalibrationError(error.message, hint=_PAIRS_HINT, **error.details)
        raise _meant(better_reading(sighting), below) from error
    residuals = Residuals.of(kind, camera, sighting.world, sighting.pixels, used, covariance)
    misfit_px = sighting.misfit_px(camera)
    sideways = turned_world(camera, sighting.world) if misfit_px < _BAD_PX and not is_plausible(camera) else None
    if sideways is not None:
        raise CalibrationError(sideways.meaning, hint=sideways.hint)
    reading = better_reading(sighting, misfit_px) if misfit_px > _GOOD_PX else None
    problem = misfit_problem(residuals, max_error_px)
    if problem is not None:
        raise _meant(reading, problem)
    if reading is not None and misfit_px > _BAD_PX:
        raise CalibrationError(reading.meaning, hint=reading.hint, misfit_px=misfit_px)
    cautions = [*levels, *view_cautions(camera), *fit_cautions(residuals)]
    cautions += intrinsics_cautions(camera, solved=sighting.K is None)
    if reading is not None:
        details = {"misfit_px": misfit_px}
        cautions.append(Caution(code="other_reading", message=reading.meaning, hint=reading.hint, details=details))
    return replace(residuals, cautions=tuple(cautions))


def _meant(reading: Reading | None, problem: CalibrationError) -> CalibrationError:
    """A problem with its likely cause, where that is known."""
    if reading is None:
        return problem
    return CalibrationError(f"{reading.meaning} ({problem.message})", hint=reading.hint, **problem.details)


def _arrays(correspondences: tuple[Correspondence, ...]) -> tuple[Array, Array]:
    world = np.array([c.world for c in correspondences], dtype=np.float64).reshape(-1, 3)
    pixels = np.array([c.pixel for c in correspondences], dtype=np.float64).reshape(-1, 2)
    return world, pixels


def _check_pixels(sighting: Sighting) -> list[Caution]:
    """What is doubtful about clicked pixels.

    Raises:
        CalibrationError: some lie outside the image, or all in its corner.
    """
    pixels, size = sighting.pixels, np.array([sighting.width_px, sighting.height_px])
    shown = f"{sighting.width_px}x{sighting.height_px} px"
    if len(pixels) and pixels.min() >= 0 and pixels.max() <= 1:
        raise CalibrationError(
            f"all pixels lie between 0 and 1: they look like shares of the picture's width and height, {shown}",
            hint=f"Multiply u by {size[0]} and v by {size[1]}, and take half a pixel off both.",
        )
    if len(pixels) and pixels.min() >= 0 and pixels.max() <= 100 and size.min() >= _LEAST_SIDE_PX:
        raise CalibrationError(
            f"all pixels lie between 0 and 100: they look like per cent of the picture's width and height, {shown}",
            hint=f"Multiply u by {size[0] / 100:g} and v by {size[1] / 100:g}, and take half a pixel off both.",
        )
    beyond = np.maximum(-0.5 - pixels, pixels - (size - 0.5)).max(axis=1, initial=-np.inf)
    outside = beyond > 0
    if not outside.any():
        return _in_corner(pixels, size)
    u, v = pixels[int(beyond.argmax())]
    message = f"{int(outside.sum())} of {len(pixels)} pixels lie outside the image of {shown}, e.g. ({u:.0f}, {v:.0f})"
    hint = (
        "Pixels are u (to the right), v (down) in the recording's size; scale them if they were clicked in a "
        "resized picture."
    )
    if beyond.max() > _BESIDE * size.max():
        problem = CalibrationError(message, hint=hint)
        if (pixels.min(axis=0) < 0).all() and (np.abs(pixels) <= size / 2).all():
            raise CalibrationError(message, hint=_from_middle(sighting))
        raise _meant(better_reading(sighting), problem)
    return [Caution(code="pixels_outside", message=message, hint=hint, details={"pixels": int(outside.sum())})]


def _in_corner(pixels: Array, size: Array) -> list[Caution]:
    """Whether pixels (N, 2) lie as those of a picture of half the size would."""
    if len(pixels) < MIN_POINTS or (pixels.max(axis=0) > size / 2).any():
        return []
    return [
        Caution(
            code="pixels_in_corner",
            message=f"all {len(pixels)} pixels lie in the upper left quarter of {size[0]}x{size[1]} px",
            hint="Were they clicked in a smaller picture? Scale them to the recording's size; if the road is there "
            "alone, all is well.",
        )
    ]


def _from_middle(sighting: Sighting) -> str:
    """What to do with pixels that are counted from the middle of the picture, rightwards, and downwards or upwards."""
    middle = np.array([sighting.width_px - 1, sighting.height_px - 1]) / 2
    misfits_px = []
    for sign in (1.0, -1.0):
        read = replace(sighting, pixels=sighting.pixels * [1.0, sign] + middle)
        try:
            camera, _ = read.solve(search=False)
            misfits_px.append(read.misfit_px(camera) if is_plausible(camera) else np.inf)
        except CalibrationError:
            misfits_px.append(np.inf)
    if misfits_px[1] < misfits_px[0]:
        return f"They look counted from the middle, and upwards: add {middle[0]:g} to u, and take v from {middle[1]:g}."
    return f"They look counted from the middle: add {middle[0]:g} to u and {middle[1]:g} to v."


def _check_shown(lens: Camera, pixels: Array) -> None:
    """Raises:
    CalibrationError: a wide lens shows nothing at some of the pixels (N, 2).
    """
    if not lens.is_wide:
        return
    dark = ~np.isfinite(lens.rays(pixels)).all(axis=1)
    if dark.any():
        u, v = pixels[dark][0]
        raise CalibrationError(
            f"the lens shows nothing at {int(dark.sum())} of {len(pixels)} pixels, e.g. ({u:.0f}, {v:.0f}): its model "
            f"ends {np.degrees(lens.wide_lens.limit_rad):.0f}° from its axis",
            hint="Check these pixels, and that K, dist and lens belong together.",
        )


def check_overlap(rig: CameraRig) -> None:
    """Refuse a rig whose views do not hang together on the ground. One camera alone is fine.

    Raises:
        NoOverlap: naming the first camera that no chain of overlapping views joins to the reference camera.
    """
    ground = {camera_id: visible_ground(camera) for camera_id, camera in rig.items()}
    joined, waiting = [rig.reference_id], [camera_id for camera_id in rig if camera_id != rig.reference_id]
    while waiting:
        found = next((c for c in waiting if any(_share_ground(rig, ground, c, other) for other in joined)), None)
        if found is None:
            raise NoOverlap(
                f"camera {waiting[0]} sees no ground that another camera sees; it stands "
                f"{_apart_m(rig, waiting[0]):.0f} m from the nearest of them",
                hint="At least two cameras must see the same ground; check that all calibrations use one world frame."
                + _doubtful_intrinsics(rig),
                camera=waiting[0],
            )
        waiting.remove(found)
        joined.append(found)


def _doubtful_intrinsics(rig: CameraRig) -> str:
    """What is unusual about intrinsics, of which cameras, in a sentence with a blank before; "" without."""
    found = {camera_id: intrinsics_cautions(camera) for camera_id, camera in rig.mounted.items()}
    doubtful = {camera_id: cautions[0] for camera_id, cautions in found.items() if cautions}
    if not doubtful:
        return ""
    first = next(iter(doubtful.values()))
    return f" Or is it K? Of {', '.join(doubtful)} {first.message}. {first.hint}"


def _apart_m(rig: CameraRig, camera_id: str) -> float:
    own = rig[camera_id].centre_m
    return min(float(np.linalg.norm(rig[other].centre_m - own)) for other in rig if other != camera_id)


def _share_ground(rig: CameraRig, ground: Mapping[str, Array], one: str, other: str) -> bool:
    return _sees_any(rig[other], ground[one]) or _sees_any(rig[one], ground[other])


def _sees_any(camera: Camera, ground: Array) -> bool:
    pixels, _ = camera.project(ground)
    near = np.linalg.norm(ground - camera.centre_m, axis=1) <= GROUND_RANGE_M
    return bool((camera.contains(pixels) & near).any())
