"""Calibrations refined from the traffic, and taken only where vehicles that they were not found by fit better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wibam_core.association.associate import associate
from wibam_core.config import AssociateConfig, RefineConfig
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.documents.refinement import HeldOut, RefinedCamera, RefinedGround, Refinement
from wibam_core.errors import NoMultiViewVehicles, NoVehicles
from wibam_core.lifting.fit import X, Y
from wibam_core.progress import Progress, part, silent
from wibam_core.refinement.bundle import Adjusted, adjust
from wibam_core.refinement.cameras import K1, LOG_FOCAL, POSITION, ROTATION, Prior, changed
from wibam_core.refinement.mounts import of_what_is_seen
from wibam_core.refinement.prior import ground_of, prior_of, rests_on_points
from wibam_core.refinement.sightings import Sightings, choose
from wibam_core.refinement.unchanged import Refined, unchanged
from wibam_core.scene import AnnotatedInstant, CameraRig, FloatArray

#: Which boxes are of one vehicle follows from the cameras, and these from the vehicles: so often in turn.
_ROUNDS = 2
#: The share of the work after which cameras are found, and judged.
_JUDGED_FROM = 0.6
#: Vehicles are parted by so many; each part is judged by cameras that the others refined.
_PARTS = 3
#: A refined calibration is taken where its gain is at least this many standard deviations, too.
_CERTAIN_SD = 2.0
#: Edges that are off by more than this many standard deviations tell no more of a calibration.
_CLIP_SD = 4.0
#: Vehicles that so many cameras see say where all cameras lie together, if there are at least so many of them.
_SEVERAL_VIEWS, _FEWEST_TOGETHER = 3, 6


def refine(
    instants: Sequence[AnnotatedInstant],
    rig: CameraRig,
    residuals: CalibrationResiduals,
    config: RefineConfig,
    progress: Progress = silent,
) -> Refined:
    """Refine cameras by the road users that several of them see.

    Args:
        instants: in order of time, with detections; their vehicles are ignored.
        rig: the cameras as calibrated.
        residuals: of that calibration; its covariances hold the cameras where the traffic says little.
        config: whether, what, and when the result is taken.
        progress: told now and then.
    """
    if config.method == "none":
        return unchanged(rig, residuals, config, "refine.method is none")
    if rig.views and config.intrinsics != "none":
        return unchanged(rig, residuals, config, "the intrinsics of wide lenses are not refined: refine.intrinsics")
    if len(rig.mounted) < 2:
        return unchanged(rig, residuals, config, "there is one camera alone")
    prior, found = prior_of(rig, residuals, config), None
    poses = of_what_is_seen(rig, dict(zip(rig.mounted, prior.covariance, strict=True)))
    for number in range(_ROUNDS):
        own = part(progress, _JUDGED_FROM * number / _ROUNDS, _JUDGED_FROM * (number + 1) / _ROUNDS)
        current = rig if found is None else found.rig
        try:
            associated = associate(instants, current, AssociateConfig(), part(own, 0.0, 0.4), poses)
        except (NoVehicles, NoMultiViewVehicles) as error:
            return unchanged(rig, residuals, config, error.message)
        sightings = choose(associated, current)
        if sightings.vehicle_count < config.min_vehicles:
            seen = f"{sightings.vehicle_count} moving vehicles were seen by several cameras"
            return unchanged(rig, residuals, config, f"{seen}, fewer than refine.min_vehicles ({config.min_vehicles})")
        own(0.4, f"adjusting cameras to {sightings.vehicle_count} vehicles")
        found = adjust(sightings, prior, found, clock_sd_s=config.clock_sd_s)
        poses = of_what_is_seen(rig, dict(zip(rig.mounted, found.covariance, strict=True)))
    assert found is not None
    judged = _judged(sightings, prior, found, config, progress)
    if judged is None:
        return unchanged(
            rig, residuals, config, "fewer than two vehicles were held out that the cameras could be judged by"
        )
    if not rests_on_points(rig, residuals):
        found = where_they_were(found, sightings, prior, config.clock_sd_s)
    progress(1.0, "refined" if _is_better(judged, config) else "kept as calibrated")
    return _result(prior, found, judged, sightings, config)


def where_they_were(found: Adjusted, sightings: Sightings, prior: Prior, clock_sd_s: float) -> Adjusted:
    """Cameras and vehicles moved together along the road, so that vehicles lie on average where they did before.

    Where all cameras lie together is nothing that the traffic tells, and errors that all boxes share can move it.
    Ready matrices were found by somebody who looked at where cameras see places on the road: of that, the mean over
    several cameras, by which a vehicle is placed, is known best. Where too few vehicles are seen by several, all stays.
    """
    before = adjust(sightings, Prior.fixed(prior.rig), clock_sd_s=clock_sd_s).parameters
    moved = (found.parameters - before)[:, [X, Y]]
    several = sightings.problem.seen.numpy().sum(axis=1) >= _SEVERAL_VIEWS
    numbers = np.unique(sightings.vehicles[several])
    if len(numbers) < _FEWEST_TOGETHER:
        return found
    by_vehicle = [np.median(moved[several & (sightings.vehicles == number)], axis=0) for number in numbers]
    together_m = np.zeros(3)
    together_m[:2] = np.median(by_vehicle, axis=0)
    changes, parameters = found.changes.copy(), found.parameters.copy()
    changes[:, POSITION] -= together_m
    parameters[:, [X, Y]] -= together_m[:2]
    return replace(found, rig=changed(prior.rig, changes), changes=changes, parameters=parameters)


def _judged(
    sightings: Sightings, prior: Prior, found: Adjusted, config: RefineConfig, progress: Progress
) -> HeldOut | None:
    """How well vehicles fit through cameras that others refined; None where fewer than two can be compared.

    Cross-validation: the cameras of each part begin where those of all vehicles came out, which saves steps and leaves
    where they end to the others.
    """
    ratios, errors_px = [], []
    for number in range(_PARTS):
        progress(_JUDGED_FROM + (1 - _JUDGED_FROM) * number / _PARTS, "judging by vehicles held out")
        held_out = np.arange(sightings.vehicle_count) % _PARTS == number
        own = sightings.of_vehicles(held_out)
        others = adjust(sightings.of_vehicles(~held_out), prior, found, clock_sd_s=config.clock_sd_s)
        (before, before_px), (after, after_px) = (_errors(own, rig, config) for rig in (prior.rig, others.rig))
        ratios.append(np.log(after / before))
        errors_px.append((before_px, after_px))
    ratio = np.concatenate(ratios)
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) < 2:
        return None
    before_px, after_px = (np.concatenate(parts) for parts in zip(*errors_px, strict=True))
    return HeldOut(
        vehicles=len(ratio),
        before_px=float(np.nanmedian(before_px)),
        after_px=float(np.nanmedian(after_px)),
        gain=float(-np.expm1(ratio.mean())),
        gain_sd=float(ratio.std(ddof=1) / np.sqrt(len(ratio))),
    )


def _errors(sightings: Sightings, rig: CameraRig, config: RefineConfig) -> tuple[FloatArray, FloatArray]:
    """Of each vehicle (M,) the error of its edges, in their standard deviations; and the errors of all edges, px."""
    residuals_px = np.abs(adjust(sightings, Prior.fixed(rig), clock_sd_s=config.clock_sd_s).residuals_px)
    clipped = np.minimum(residuals_px / sightings.problem.edge_sd.numpy(), _CLIP_SD)
    own = [clipped[sightings.vehicles == k] for k in range(sightings.vehicle_count)]
    errors = [np.sqrt(np.nanmean(np.square(one))) if np.isfinite(one).any() else np.nan for one in own]
    return np.array(errors), residuals_px.ravel()


def _is_better(judged: HeldOut, config: RefineConfig) -> bool:
    return judged.gain >= config.least_gain and judged.gain >= _CERTAIN_SD * judged.gain_sd


def _result(prior: Prior, found: Adjusted, judged: HeldOut, sightings: Sightings, config: RefineConfig) -> Refined:
    rig, taken = prior.rig, _is_better(judged, config)
    height_m, *slopes = ground_of(found.changes, prior)
    cameras, covariances = {}, {}
    late_ms = 1e3 * (found.late_s - found.late_s.mean())
    for number, camera_id in enumerate(rig.mounted):
        change, matrix = found.changes[number], found.covariance[number]
        sd = np.sqrt(np.diagonal(matrix))
        cameras[camera_id] = RefinedCamera(
            turned_deg=float(np.degrees(np.linalg.norm(change[ROTATION]))),
            moved_m=float(np.linalg.norm(change[POSITION])),
            focal_change=float(np.expm1(change[LOG_FOCAL])) if len(change) > LOG_FOCAL else None,
            k1_change=float(change[K1]) if len(change) > K1 else None,
            late_ms=float(late_ms[number]),
            rotation_sd_deg=np.degrees(sd[ROTATION]).tolist(),
            position_sd_m=sd[POSITION].tolist(),
        )
        # a camera that stays although the traffic would have it elsewhere is off by that as well
        off = np.zeros(6) if taken else change[:6]
        covariances[camera_id] = matrix[:6, :6] + np.outer(off, off)
    errors = f"from {judged.before_px:.2f} to {judged.after_px:.2f} px at the median"
    of = f"of {judged.vehicles} vehicles, each held out in turn,"
    change_words = (
        f"the reprojection error {of} went {errors}, by {100 * judged.gain:.0f} ± {100 * judged.gain_sd:.0f} %"
    )
    document = Refinement(
        method=config.method,
        taken=taken,
        reason=change_words if taken else f"{change_words}, too little to change a calibration for",
        vehicles=sightings.vehicle_count,
        sightings=len(sightings),
        held_out=judged,
        ground=RefinedGround(height_m=height_m, slope_x=slopes[0], slope_y=slopes[1]),
        cameras=cameras,
        covariances={name: own.tolist() for name, own in of_what_is_seen(rig, covariances).items()},
    )
    return Refined(found.rig if taken else rig, document)
