"""Bodies that correct themselves: a few deformations of each class's template, learned from all its tracks at a site.

A template that is wrong makes every vehicle of its class wrong in the same way. Each mode moves some of the template's
points inside the vehicle's extent, so that it is told apart from a size. All tracks of a class share the modes; the
place, heading and size of each vehicle are free, and marginalised.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from wibam_core.documents.statistics import LearnedBody
from wibam_core.geometry.gauss_newton import cauchy_weights, normal_equations
from wibam_core.lifting.fit import (
    LOG_HEIGHT,
    LOG_LENGTH,
    LOG_SIZE,
    ROBUST_SD,
    YAW,
    Fit,
    FitProblem,
    X,
    Y,
    fit,
    predicted_edges,
    with_bodies,
)
from wibam_core.lifting.trajectory import Tracks
from wibam_core.road_users import BODIES, CLASSES, LOG_SIZE_MEAN, LOG_SIZE_SD
from wibam_core.scene import FloatArray, IntArray

#: What a mode of 1 changes: the roof's length, its place along the vehicle (forwards), its width, how much narrower the
#: ends and shorter the sides of the body are than its extent, and the height of the body's upper edge.
MODES = ("roof_length", "roof_shift", "roof_width", "corner_cut", "waist_height")
#: Standard deviation of each mode before looking, in lengths, widths or heights of the vehicle: that of a class's mean
#: about its template, and also that of one vehicle about its class's mean.
MODE_SD: FloatArray = np.array([0.06, 0.05, 0.06, 0.06, 0.06])
MODE_SD.setflags(write=False)
#: Where the offsets of edges begin among what tracks share: after log sizes and modes.
OFFSETS = 3 + len(MODES)

#: So many sightings of a track are looked at.
_SIGHTINGS = 8
#: They count as this many independent ones, since the errors of one vehicle are alike.
_INDEPENDENT_SIGHTINGS = 4.0
#: Vehicles are fitted to the bodies, and bodies to the vehicles, this many times in turn.
_ROUNDS = 2
#: A corrected body is kept if it lowers the cost of the fits by at least this share; less may be errors of the
#: detector.
_LEAST_GAIN = 0.02
#: Derivatives by the modes are differences over this many of their standard deviations each way.
_STEP_SD = 0.5
#: Tracks whose modes lie farther than this many standard deviations from their class's count less.
_ROBUST_TRACK_SD = 2.0
_PASSES = 4


def _modes(template: FloatArray) -> FloatArray:
    """(K, P, 3) displacements of a template's points (P, 3) per unit of a mode, in lengths, widths and heights."""
    side, end = np.sign(template[:, 1]), np.sign(template[:, 0])
    z = template[:, 2]
    roof, wheels = z > 0.49, z < -0.49
    ring = ~roof & ~wheels
    ends = ring & (np.abs(template[:, 1]) < 0.46)
    modes = np.zeros((len(MODES), *template.shape))
    ahead = np.sign(template[:, 0] - template[roof, 0].mean())
    modes[0, roof, 0] = ahead[roof] / 2
    modes[1, roof, 0] = 1.0
    modes[2, roof, 1] = side[roof] / 2
    modes[3, ends, 1] = -side[ends] / 2
    modes[3, ring & ~ends, 0] = -end[ring & ~ends] / 2
    modes[4, ring & (z > -0.15), 2] = 1.0
    return modes


#: (classes, K, P, 3) in the order of `CLASSES` and `MODES`.
DEFORMATIONS: FloatArray = np.array([_modes(template) for template in BODIES])
DEFORMATIONS.setflags(write=False)


def deformed(templates: FloatArray, modes: FloatArray) -> FloatArray:
    """(classes, P, 3) templates with ``modes`` (classes, K) applied; no point leaves the vehicle's extent."""
    return np.asarray(np.clip(templates + np.einsum("ck,ckpi->cpi", modes, DEFORMATIONS), -0.5, 0.5))


@dataclass(frozen=True, eq=False)
class Shapes:
    """What was learned of the classes' bodies.

    Attributes:
        templates: (classes, P, 3) as they were before. modes: (classes, K). sd: (classes, K) standard deviations.
        tracks: (classes,) from how many tracks; 0 where there were too few, or where no other body fits better.
    """

    templates: FloatArray
    modes: FloatArray
    sd: FloatArray
    tracks: IntArray

    @classmethod
    def unlearned(cls, templates: FloatArray = BODIES) -> Shapes:
        """The templates as they are."""
        c = len(templates)
        return cls(templates, np.zeros((c, len(MODES))), np.tile(MODE_SD, (c, 1)), np.zeros(c, dtype=np.int64))

    @property
    def bodies(self) -> FloatArray:
        """(classes, P, 3) corrected templates."""
        return deformed(self.templates, self.modes)

    def updated(self, other: Shapes, take: np.ndarray) -> Shapes:
        """The classes ``take`` (classes,) as in the other."""
        return Shapes(
            self.templates,
            np.where(take[:, None], other.modes, self.modes),
            np.where(take[:, None], other.sd, self.sd),
            np.where(take, other.tracks, self.tracks),
        )

    def statistics(self) -> dict[str, LearnedBody]:
        """Modes and standard deviations of the classes whose bodies were corrected."""
        return {
            str(CLASSES[c]): LearnedBody(
                tracks=int(self.tracks[c]),
                modes=dict(zip(MODES, self.modes[c].tolist(), strict=True)),
                sd=dict(zip(MODES, self.sd[c].tolist(), strict=True)),
            )
            for c in np.flatnonzero(self.tracks)
        }


def learn_shapes(
    problem: FitProblem,
    classes: IntArray,
    tracks: Tracks,
    usable: np.ndarray,
    *,
    iterations: int,
    min_tracks: int,
    templates: FloatArray = BODIES,
) -> Shapes:
    """Estimate the modes of every class that has enough tracks.

    Args:
        problem: N vehicles at instants; their bodies are not read.
        classes: (N,) class indices, equal within a track.
        tracks: how the vehicles form tracks.
        usable: (N,) bool: seen by several cameras, and with a heading that is known.
        iterations: most steps of a fit.
        min_tracks: classes with fewer keep their template.
        templates: (classes, P, 3).
    """
    shapes = Shapes.unlearned(templates)
    rows, track = sample_sightings(tracks, usable, classes, min_tracks)
    if not len(rows):
        return shapes
    own = classes[rows]
    chosen = with_bodies(problem[torch.as_tensor(rows)], shapes.bodies[own])
    fitted = fit(chosen, chosen.prior_mean[:, None], iterations)
    best, unlearned = shapes, _costs(shapes, fitted, own)
    lowest = unlearned
    for _ in range(_ROUNDS):
        shapes = _improved(shapes, chosen, fitted, own, track)
        chosen = with_bodies(chosen, shapes.bodies[own])
        fitted = fit(chosen, fitted.parameters[:, None], iterations)
        cost = _costs(shapes, fitted, own)
        best, lowest = best.updated(shapes, cost < lowest), np.minimum(cost, lowest)
    return Shapes.unlearned(templates).updated(best, lowest < (1.0 - _LEAST_GAIN) * unlearned)


def _costs(shapes: Shapes, fitted: Fit, classes: IntArray) -> FloatArray:
    """(classes,) what fits of vehicles and modes together leave unexplained."""
    own = np.bincount(classes, fitted.cost.numpy(), len(shapes.modes))
    return np.asarray(own + 0.5 * ((shapes.modes / MODE_SD) ** 2).sum(axis=1))


def sample_sightings(
    tracks: Tracks, usable: np.ndarray, classes: IntArray, min_tracks: int
) -> tuple[IntArray, IntArray]:
    """Rows of up to `_SIGHTINGS` usable sightings of every track, spread over it, and the number of the track of each.

    Classes with fewer than ``min_tracks`` tracks are left out.
    """
    picked = []
    for rows, valid in zip(tracks.rows, tracks.valid, strict=True):
        own = rows[valid]
        own = own[usable[own]]
        if len(own):
            picked.append(own[np.unique(np.linspace(0, len(own) - 1, _SIGHTINGS).round().astype(np.int64))])
    count = np.bincount([classes[own[0]] for own in picked], minlength=len(CLASSES))
    picked = [own for own in picked if count[classes[own[0]]] >= min_tracks]
    if not picked:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    return np.concatenate(picked), np.repeat(np.arange(len(picked)), [len(own) for own in picked])


def _improved(shapes: Shapes, problem: FitProblem, fitted: Fit, classes: IntArray, track: IntArray) -> Shapes:
    """One Gauss–Newton step of the modes at fits with the current bodies."""
    information, score, own_class = of_tracks(shapes, problem, fitted, classes, track)
    modes, sd, count = shapes.modes.copy(), shapes.sd.copy(), shapes.tracks.copy()
    for c in np.unique(own_class):
        own = own_class == c
        modes[c], sd[c] = _of_class(information[own][:, :OFFSETS, :OFFSETS], score[own][:, :OFFSETS], c)
        count[c] = own.sum()
    return replace(shapes, modes=modes, sd=sd, tracks=count)


def of_tracks(
    shapes: Shapes, problem: FitProblem, fitted: Fit, classes: IntArray, track: IntArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """What tracks say of what they share: log sizes (from the class's usual ones), modes, and offsets of edges (px).

    Args:
        shapes: the bodies that the vehicles were fitted with.
        problem: N sightings.
        fitted: how they were fitted.
        classes: (N,) of them, indices into `CLASSES`.
        track: (N,) number of the track of each, in order.

    Returns:
        Information (M, S, S) of M tracks on the S = 3 + K + 4 shared unknowns, the score (M, S) where all of them are
        0, and the class (M,) of each.
    """
    information, score = _of_sightings(shapes, problem, fitted, classes)
    _, first, sightings = np.unique(track, return_index=True, return_counts=True)
    share = np.minimum(1.0, _INDEPENDENT_SIGHTINGS / sightings)
    of = share[:, None, None] * np.add.reduceat(information, first)
    return of, share[:, None] * np.add.reduceat(score, first), classes[first]


def _of_sightings(shapes: Shapes, problem: FitProblem, fitted: Fit, classes: IntArray) -> tuple[FloatArray, FloatArray]:
    """Information (N, S, S) and score (N, S) of single sightings, as in `of_tracks`; place and yaw are marginalised."""
    edges, jacobian, exact, used = predicted_edges(problem, fitted.parameters)
    sd = problem.sd()
    compared = (exact & used[..., None]).numpy()
    residual = np.where(compared, ((edges - problem.boxes) / sd).numpy(), 0.0).astype(np.float64)
    weight = compared * cauchy_weights(torch.from_numpy(residual), ROBUST_SD).numpy()
    n = len(residual)
    # edges are seen where the body's are, and an offset farther right or down
    offsets = np.broadcast_to(np.eye(4), (*residual.shape, 4))
    by_modes = _by_modes(shapes, problem, fitted.parameters, classes)
    slopes = np.concatenate([jacobian.numpy(), by_modes, offsets], axis=-1)
    flat = (slopes / sd.numpy()[..., None]).reshape(n, residual[0].size, -1)
    residual, weight = residual.reshape(n, -1), weight.reshape(n, -1)
    pose = [X, Y, YAW]
    shared = [*range(LOG_LENGTH, LOG_HEIGHT + 1), *range(6, flat.shape[-1])]
    parameters = fitted.parameters.numpy().astype(np.float64)
    usual = parameters[:, LOG_SIZE] - LOG_SIZE_MEAN[classes]
    at = np.concatenate([usual, shapes.modes[classes], np.zeros((n, 4))], axis=1)
    # residuals of vehicles of usual size with the template as it was
    residual = residual - np.einsum("nej,nj->ne", flat[..., shared], at)
    hessian, gradient = (of.numpy() for of in normal_equations(*map(torch.from_numpy, (flat, residual, weight))))
    prior = problem.prior_weight.numpy().astype(np.float64)[:, pose]
    off = (parameters - problem.prior_mean.numpy())[:, pose]
    off[:, 2] = np.arctan2(np.sin(off[:, 2]), np.cos(off[:, 2]))
    free = hessian[:, pose][:, :, pose] + (prior + 1e-6)[:, :, None] * np.eye(3)
    pull = gradient[:, pose] + prior * off
    return marginal(hessian[:, shared][:, :, shared], gradient[:, shared], hessian[:, shared][:, :, pose], free, pull)


def _by_modes(shapes: Shapes, problem: FitProblem, parameters: Tensor, classes: IntArray) -> FloatArray:
    """(N, V, 4, K) derivatives of edges by the modes, px per unit: differences over as much as a mode may change, since
    the points of a body take turns in making its edges."""
    columns = []
    for mode, step in enumerate(MODE_SD * _STEP_SD):
        ahead, back = (
            predicted_edges(with_bodies(problem, deformed(shapes.templates, modes)[classes]), parameters)[0].numpy()
            for modes in (
                shapes.modes + step * np.eye(len(MODES))[mode],
                shapes.modes - step * np.eye(len(MODES))[mode],
            )
        )
        columns.append((ahead.astype(np.float64) - back) / (2 * step))
    return np.stack(columns, axis=-1)


def marginal(
    a: FloatArray, eta_a: FloatArray, cross: FloatArray, b: FloatArray, eta_b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Information ``a`` (N, i, i) and score (N, i) without the unknowns of ``b`` (N, j, j): the Schur complement."""
    solved = np.linalg.solve(b, np.concatenate([cross.transpose(0, 2, 1), eta_b[..., None]], axis=2))
    return a - cross @ solved[..., :-1], eta_a - (cross @ solved[..., -1:])[..., 0]


def _of_class(information: FloatArray, score: FloatArray, number: int) -> tuple[FloatArray, FloatArray]:
    """Modes (K,) and their s.d. (K,) of the information (M, 3 + K, 3 + K) of tracks and its score (M, 3 + K)."""
    spread = np.diag(np.concatenate([LOG_SIZE_SD[number], MODE_SD]) ** 2)
    prior = np.linalg.inv(spread)
    information, score = about_their_mean(information, score, spread, prior)
    covariance = np.linalg.inv(prior + information.sum(axis=0))
    mean = covariance @ score.sum(axis=0)
    return mean[3:], np.sqrt(np.diagonal(covariance))[3:]


def about_their_mean(
    information: FloatArray, score: FloatArray, spread: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What vehicles that differ say of the mean of all.

    The sizes of a site's vehicles spread about their own mean, which is known no better than a single vehicle's size.

    Args:
        information: (M, S, S) of single vehicles.
        score: (M, S) of them.
        spread: (S, S) covariance of one vehicle about the mean of all.
        prior: (S, S) information on that mean before looking.

    Returns:
        Information (M, S, S) and score (M, S) on the mean; vehicles that differ too much count less.
    """
    s = len(spread)
    # one vehicle's own size and shape about the class's: (Λ⁻¹ + S)⁻¹ = (1 + Λ S)⁻¹ Λ
    own = np.linalg.inv(np.eye(s) + information @ spread)
    information, score = own @ information, -(own @ score[..., None])[..., 0]
    weight, inverse = np.ones(len(information)), np.linalg.pinv(information)
    for _ in range(_PASSES):
        covariance = np.linalg.inv(prior + np.einsum("m,mij->ij", weight, information))
        mean = covariance @ np.einsum("m,mi->i", weight, score)
        off = score - information @ mean
        squared = np.einsum("mi,mij,mj->m", off, inverse, off) / s
        weight = 1 / (1 + squared / _ROBUST_TRACK_SD**2)
    return weight[:, None, None] * information, weight[:, None] * score
