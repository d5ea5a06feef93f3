"""From associated 2D boxes to 7DoF boxes: single fits first, then one size and a consistent heading per track."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch

from wibam_core.association.rays import rig_centre
from wibam_core.config import LiftConfig
from wibam_core.documents.statistics import FitsByViews, LiftStatistics, ResidualPercentiles
from wibam_core.geometry.box3d import SIZE, XY
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3, normalise_angle
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.lifting.confidence import confidence
from wibam_core.lifting.doubles import doubled
from wibam_core.lifting.edge_offsets import EdgeOffsets, learn_edge_offsets
from wibam_core.lifting.fit import (
    LOG_SIZE,
    PLACE,
    YAW,
    Fit,
    FitProblem,
    X,
    Y,
    fit,
    joined,
    with_bodies,
    with_noise,
    yaw_starts,
)
from wibam_core.lifting.headings import HALF_WINDOW_S, headings, telling
from wibam_core.lifting.noise import noise_of, persistence
from wibam_core.lifting.observations import Observations, observe
from wibam_core.lifting.orientation import standing_headings
from wibam_core.lifting.shapes import Shapes, learn_shapes
from wibam_core.lifting.sizes import size_information, track_sizes
from wibam_core.lifting.trajectory import Motion, Tracks, smooth
from wibam_core.lifting.way_seen import share_seen
from wibam_core.progress import Progress, silent
from wibam_core.road_users import BODIES, LOG_SIZE_MEAN, LOG_SIZE_SD
from wibam_core.scene import AnnotatedInstant, CameraRig, FloatArray, Vehicles3D

#: Standard deviation of the place of a vehicle whose rays form a cluster, and of one that has a single ray, m.
_CLUSTER_SD_M, _RAY_SD_M = 0.7, 3.0
#: Where the cameras that see a vehicle change, its place jumps without a motion: that of a cluster of rays by about
#: this much, and that of a fit, m.
_CLUSTER_JUMP_M, _FIT_JUMP_M = 0.8, 0.4
#: The least standard deviations that a fit is believed to have: of its place in m, and of its size as a share, since no
#: vehicle has quite the body of its class.
_POSITION_FLOOR_M = 0.05
_SIZE_FLOOR = 0.02
#: A fit whose heading is not known from motion begins in this many directions; the best one is kept.
_YAW_STARTS = 4
#: Errors that all views of a vehicle share, or that last, leave no residual: edges are this many times noisier than the
#: residuals say.
_HIDDEN_NOISE = 1.5
#: Number of fits from which the detector's noise is estimated.
_NOISE_SAMPLE = 400


@dataclass(frozen=True, eq=False)
class LiftResult:
    """Fitted vehicles, one entry for every instant given, and figures about all fits (JSON types)."""

    vehicles: list[Vehicles3D]
    statistics: LiftStatistics


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run torch on one thread: its pool costs more than it gains on tensors this small, 20 times on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@_one_thread()
def lift(
    instants: Sequence[AnnotatedInstant],
    rig: CameraRig,
    config: LiftConfig,
    progress: Progress = silent,
) -> LiftResult:
    """Fit every vehicle that enough cameras see, using its whole track.

    Where fewer see it, a vehicle is fitted too if it was seen for long enough and its place is certain.

    Args:
        instants: associated, in order of time. The denser, the better the motion.
        rig: the cameras that the instants name.
        config: fewest views, most steps, largest residual, whether bodies are corrected.
        progress: told now and then.

    Returns:
        Boxes in the world with ``ids`` = track id, ``scores`` = confidence and standard deviations. A standing
        vehicle whose front could not be told from its rear has a yaw s.d. above 1 rad.
    """
    seen = _worth_fitting(observe(instants, rig, 1), config)
    if not len(seen):
        return LiftResult(
            [Vehicles3D.of(i.time_ns, np.empty((0, 7))) for i in instants],
            _statistics(seen, None, None, 1.0, 0.0, Shapes.unlearned(), EdgeOffsets.unknown()),
        )
    # fits are float32, and a world's origin may be far away, as in UTM: they count from the middle of the cameras
    origin = rig_centre(rig)
    seen = replace(seen, positions=seen.positions - origin)
    tracks = Tracks.group(seen.tracks, seen.times_ns)
    shifted = [moved(camera, -origin) for camera in rig.values()]
    cameras = CameraTensors.from_cameras(shifted)

    progress(0.0, "motion of the clusters of rays")
    views = seen.seen.sum(axis=1)
    motion, yaw, yaw_sd = clusters_in_motion(seen, shifted, tracks, config.min_views)
    prior_mean, prior_sd = LOG_SIZE_MEAN[seen.classes], LOG_SIZE_SD[seen.classes]

    progress(0.1, f"fitting {len(seen)} vehicles one by one")
    problem = fit_problem(seen, cameras, tracks, motion, prior_mean, prior_sd, yaw, 2 * yaw_sd, BODIES)
    known = np.isfinite(yaw_sd)
    noise = _estimate_noise(problem, known, views, config.iterations)
    problem = with_noise(problem, noise)
    usable = known & (views >= config.min_views)
    offsets = EdgeOffsets.unknown()
    if config.learn_edge_offsets:
        offsets = learn_edge_offsets(problem, seen.classes, tracks, usable, iterations=config.iterations)
    problem, seen = offsets.taken_off(problem), replace(seen, boxes=seen.boxes - offsets.px)
    shapes = Shapes.unlearned()
    if config.learn_templates:
        shapes = learn_shapes(
            problem, seen.classes, tracks, usable, iterations=config.iterations, min_tracks=config.min_template_tracks
        )
        problem = with_bodies(problem, shapes.bodies[seen.classes])
    first = _first_fit(problem, known, config.iterations)
    parameters, covariance = _solution(first, problem)

    progress(0.5, "combining fits over tracks")
    motion = smooth(tracks, parameters[:, PLACE], covariance[:, PLACE, PLACE])
    yaw, yaw_sd = _headings(seen, shifted, tracks, motion, _FIT_JUMP_M)
    standing = standing_headings(tracks, parameters, covariance, yaw, yaw_sd)
    never = ~np.isfinite(yaw_sd)
    yaw, yaw_sd = np.where(never, standing.yaw_rad, yaw), np.where(never, standing.axis_sd_rad, yaw_sd)
    information = size_information(first.information.numpy().astype(np.float64))
    sizes, size_covariance = track_sizes(
        tracks, parameters[:, LOG_SIZE], information, prior_mean, prior_sd, parameters[:, PLACE]
    )
    own_size = tracks.scatter(np.repeat(sizes[:, None], tracks.valid.shape[1], axis=1), prior_mean.copy())
    size_sd = np.sqrt(np.diagonal(size_covariance, axis1=1, axis2=2))
    own_size_sd = tracks.scatter(np.repeat(size_sd[:, None], tracks.valid.shape[1], axis=1), prior_sd.copy())

    progress(0.6, "fitting again with one size and heading per track")
    tight = np.full_like(own_size_sd, 0.01)
    problem = with_noise(fit_problem(seen, cameras, tracks, motion, own_size, tight, yaw, yaw_sd, shapes.bodies), noise)
    start = np.concatenate([parameters[:, PLACE], own_size, yaw[:, None]], axis=1)
    second = fit(problem, torch.as_tensor(start[:, None], dtype=torch.float32), config.iterations)
    parameters, covariance = _solution(second, problem)

    progress(0.9, "smoothing")
    motion = smooth(tracks, parameters[:, PLACE], covariance[:, PLACE, PLACE])
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)).copy()
    # smoothing averages errors out only as far as they change from one sighting to the next
    lasting = persistence(tracks, seen, first)
    smoothed_sd = np.sqrt(np.diagonal(motion.covariance, axis1=2, axis2=3)[..., :2] * (1 + lasting) / (1 - lasting))
    sd[:, PLACE] = np.minimum(sd[:, PLACE], tracks.scatter(smoothed_sd, sd[:, PLACE].copy()))
    sd[:, LOG_SIZE] = np.hypot(own_size_sd, _SIZE_FLOOR)
    sd[:, YAW] = np.where(never, np.hypot(sd[:, YAW], standing.front_sd_rad), sd[:, YAW])
    residual = _residuals(second, seen)
    boxes = _boxes(parameters)
    boxes[:, XY] = tracks.scatter(motion.position, boxes[:, XY].copy()) + origin
    limit = residual_limit(residual, views, config)
    scores = confidence(residual, views, sd, boxes, limit)
    certain = np.hypot(sd[:, X], sd[:, Y]) <= config.few_views_sd_m
    keep = (residual <= limit) & ((views >= config.min_views) | certain)
    good = np.flatnonzero(keep)
    double = doubled(boxes[good], seen.classes[good], seen.instants[good], seen.tracks[good], scores[good])
    keep[good[double]] = False
    vehicles = _by_instant(instants, seen, keep, boxes, _box_sd(sd, boxes), scores)
    progress(1.0, "lifted")
    statistics = _statistics(seen, residual, keep, noise, lasting, shapes, offsets, limit)
    return LiftResult(vehicles, statistics.model_copy(update={"doubled": int(double.sum())}))


def residual_limit(residual: FloatArray, views: FloatArray, config: LiftConfig) -> float:
    """Largest residual of a fit that is kept.

    It is at least ``config.max_residual``. Where cameras are calibrated less exactly, no fit agrees with all of them,
    and one is odd only beside the others.

    Args:
        residual: (N,) mean 1 − GIoU.
        views: (N,) number of views; fits to several tell what is usual.
        config: the limits.
    """
    several = residual[views >= config.min_views]
    usual = float(np.median(several)) if len(several) else 0.0
    return max(config.max_residual, config.max_usual_residuals * usual)


def moved(camera: Camera, shift_m: FloatArray) -> Camera:
    """The camera, shifted along the world's X and Y by ``shift_m`` (2,)."""
    pose = camera.T_world_cam
    return replace(camera, T_world_cam=SE3(pose.rotation, pose.translation + np.append(shift_m, 0.0)))


def _worth_fitting(seen: Observations, config: LiftConfig) -> Observations:
    """Vehicles in enough views, and those in fewer whose tracks are long enough; all in tracks."""
    linked = seen.tracks >= 0
    count = np.bincount(seen.tracks[linked], minlength=int(seen.tracks.max(initial=-1)) + 1)
    enough = seen.seen.sum(axis=1) >= config.min_views
    return seen.where(linked & (enough | (count[seen.tracks] >= config.few_views_sightings)))


def clusters_in_motion(
    seen: Observations, cameras: Sequence[Camera], tracks: Tracks, min_views: int
) -> tuple[Motion, FloatArray, FloatArray]:
    """Motion by the clusters of rays alone, yaw (N,) along it, rad, and its s.d., infinite for who never moves."""
    cluster_sd = np.where(seen.seen.sum(axis=1) >= min_views, _CLUSTER_SD_M, _RAY_SD_M)
    motion = smooth(tracks, seen.positions, cluster_sd[:, None, None] ** 2 * np.eye(2))
    return (motion, *_headings(seen, cameras, tracks, motion, _CLUSTER_JUMP_M))


def _headings(
    seen: Observations, cameras: Sequence[Camera], tracks: Tracks, motion: Motion, jump_m: float
) -> tuple[FloatArray, FloatArray]:
    """Yaw (N,) by motion and its s.d., infinite where the vehicle never moves."""
    count = len(seen)
    share = share_seen(seen, cameras, tracks, motion, telling(tracks, motion, jump_m), HALF_WINDOW_S)
    found = headings(tracks, seen.classes[tracks.rows[:, 0]], motion, jump_m, share)
    return tracks.scatter(found.yaw_rad, np.zeros(count)), tracks.scatter(found.sd_rad, np.full(count, np.inf))


def fit_problem(
    seen: Observations,
    cameras: CameraTensors,
    tracks: Tracks,
    motion: Motion,
    log_size: FloatArray,
    log_size_sd: FloatArray,
    yaw: FloatArray,
    yaw_sd: FloatArray,
    bodies: FloatArray,
    dtype: torch.dtype = torch.float32,
) -> FitProblem:
    """Observations of N vehicles as a problem to fit.

    The cameras may count from another origin, as the positions then do. Of sizes (N, 3), in logarithms of m, and of
    headings (N,), rad, it is said what is known and how well; bodies are (classes, P, 3) in lengths, widths and
    heights.
    """

    def tensor(values: FloatArray) -> torch.Tensor:
        return torch.as_tensor(values, dtype=dtype)

    velocity = tracks.scatter(motion.velocity, np.zeros((len(seen), 2)))
    none = np.zeros((len(seen), 2))
    return FitProblem(
        cameras=cameras[torch.as_tensor(seen.cameras)],
        boxes=tensor(seen.boxes),
        edge_sd=tensor(seen.edge_sd),
        seen=torch.as_tensor(seen.seen),
        exact=torch.as_tensor(seen.exact),
        cut=torch.as_tensor(seen.cut),
        shift=tensor(velocity[:, None] * seen.lateness_s[..., None]),
        body=tensor(bodies[seen.classes]),
        noise=torch.ones(len(seen), dtype=dtype),
        prior_mean=tensor(np.concatenate([seen.positions, log_size, yaw[:, None]], axis=1)),
        prior_weight=tensor(np.concatenate([none, log_size_sd**-2.0, yaw_sd[:, None] ** -2.0], axis=1)),
    )


def _estimate_noise(problem: FitProblem, known: np.ndarray, views: FloatArray, iterations: int) -> float:
    """How much worse than stated the edges are, by fits of a sample of vehicles in several views."""
    several = np.flatnonzero(views > 1)
    sample = several[:: max(1, len(several) // _NOISE_SAMPLE)]
    if not len(sample):
        return _HIDDEN_NOISE
    rows = torch.as_tensor(sample)
    noise = 1.0
    for _ in range(2):  # a wrong noise makes wrong fits; the second time it is nearly right
        trial = with_noise(problem[rows], noise)
        noise *= noise_of(trial, _first_fit(trial, known[sample], iterations))
    return _HIDDEN_NOISE * noise


def _first_fit(problem: FitProblem, known: np.ndarray, iterations: int) -> Fit:
    """From the heading where motion gives one, else from several directions."""
    base = problem.prior_mean
    groups = [
        (rows, starts)
        for rows, turns in ((np.flatnonzero(known), 1), (np.flatnonzero(~known), _YAW_STARTS))
        if len(rows)
        for starts in (yaw_starts(base[torch.as_tensor(rows)], turns),)
    ]
    parts = [fit(problem[torch.as_tensor(rows)], starts, iterations) for rows, starts in groups]
    order = torch.as_tensor(np.argsort(np.concatenate([rows for rows, _ in groups])))
    return joined(parts)[order]


def _solution(fitted: Fit, problem: FitProblem) -> tuple[FloatArray, FloatArray]:
    """Parameters (N, 6) and covariances (N, 6, 6)."""
    hessian = fitted.information + torch.diag_embed(problem.prior_weight)
    covariance = np.asarray(np.linalg.inv(hessian.numpy().astype(np.float64) + 1e-4 * np.eye(6)), dtype=np.float64)
    covariance[:, [0, 1], [0, 1]] += _POSITION_FLOOR_M**2
    return fitted.parameters.numpy().astype(np.float64), covariance


def _residuals(fitted: Fit, seen: Observations) -> FloatArray:
    """(N,) mean over views of 1 − GIoU."""
    loss = np.where(seen.seen, 1.0 - fitted.view_giou.numpy(), 0.0)
    return np.asarray(loss.sum(axis=1) / seen.seen.sum(axis=1))


def _boxes(parameters: FloatArray) -> FloatArray:
    """(N, 7) boxes of (N, 6) parameters."""
    size = np.exp(parameters[:, LOG_SIZE])
    yaw = normalise_angle(parameters[:, YAW])
    return np.concatenate([parameters[:, PLACE], size[:, 2:] / 2, size, yaw[:, None]], axis=1)


def _box_sd(sd: FloatArray, boxes: FloatArray) -> FloatArray:
    """(N, 7) s.d. of boxes from those of the parameters (N, 6)."""
    size_sd = sd[:, LOG_SIZE] * boxes[:, SIZE]
    return np.concatenate([sd[:, PLACE], size_sd[:, 2:] / 2, size_sd, sd[:, YAW:]], axis=1)


def _by_instant(
    instants: Sequence[AnnotatedInstant],
    seen: Observations,
    keep: np.ndarray,
    boxes: FloatArray,
    sd: FloatArray,
    scores: FloatArray,
) -> list[Vehicles3D]:
    rows_of: list[list[int]] = [[] for _ in instants]
    for row in np.flatnonzero(keep):
        rows_of[seen.instants[row]].append(int(row))
    return [
        Vehicles3D.of(instant.time_ns, boxes[rows], seen.classes[rows], seen.tracks[rows], scores[rows], sd[rows])
        for instant, rows in zip(instants, rows_of, strict=True)
    ]


def _statistics(
    seen: Observations,
    residual: FloatArray | None,
    keep: np.ndarray | None,
    noise: float,
    lasting: float,
    shapes: Shapes,
    offsets: EdgeOffsets,
    limit: float | None = None,
) -> LiftStatistics:
    if residual is None or keep is None:
        return LiftStatistics(fits=0, kept=0, tracks=0)
    views = seen.seen.sum(axis=1)
    return LiftStatistics(
        fits=len(seen),
        kept=int(keep.sum()),
        tracks=len(np.unique(seen.tracks)),
        kept_share=float(keep.mean()),
        residual_limit=limit,
        edge_noise=noise,
        edge_offsets_px=offsets.px.tolist() if offsets.tracks else None,
        edge_persistence=lasting,
        bodies=shapes.statistics(),
        residual=ResidualPercentiles(**{f"p{p}": float(np.percentile(residual, p)) for p in (10, 50, 90)}),
        by_views={
            str(n): FitsByViews(fits=int((views == n).sum()), residual=float(np.median(residual[views == n])))
            for n in np.unique(views).tolist()
        },
    )
