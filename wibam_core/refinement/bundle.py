"""Bundle adjustment of cameras and vehicles.

Unknown are how the cameras are held and where, the size of every vehicle, and its place and heading at each sighting.
They are found together, from the edges of the vehicles' 2D boxes in all views (`wibam_core.lifting.fit`), by damped
Gauss-Newton steps with robust weights (Triggs, McLauchlan, Hartley & Fitzgibbon, "Bundle adjustment: a modern
synthesis", 2000). A sighting's own unknowns are coupled to those of no other sighting but through its vehicle's size,
and sizes only through the cameras: both are eliminated in turn (Schur complement), which leaves a few numbers for each
camera, and is exact. What was known of the cameras before stands beside the edges as a Gaussian prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from wibam_core.lifting.fit import LOG_SIZE, ROBUST_SD, YAW, Contacts, FitProblem, X, Y, contacts
from wibam_core.refinement.cameras import LOG_FOCAL, POSITION, ROTATION, Prior, changed, slopes_by_lens
from wibam_core.refinement.mounts import mounts_of
from wibam_core.refinement.shared import EDGE_BIAS_SD, Shared, outward
from wibam_core.refinement.sightings import Sightings
from wibam_core.scene import CameraRig, FloatArray, IntArray

#: Of a vehicle's unknowns, those that are a sighting's own, and those of all its sightings.
_OWN = np.array([X, Y, YAW])
_SIZE = np.arange(6)[LOG_SIZE]
#: Several sightings of a vehicle tell as much as this many whose errors are independent.
_INDEPENDENT_SIGHTINGS = 4.0
#: Errors that all views of a vehicle share leave no residual: edges are this many times noisier than residuals say.
_HIDDEN_NOISE = 1.5
_NOISE_LIMITS = (0.5, 8.0)
#: Steps are at most so many, and stop when the cost falls by less than this share; fewer and sooner while the noise is
#: not known yet.
_STEPS, _LEAST_GAIN = 60, 3e-5
_FIRST_STEPS, _FIRST_LEAST_GAIN = 12, 1e-3
#: How far a sighting moves in one step at most: m, m, rad; a vehicle's size, as a share.
_STEP_OWN, _STEP_SIZE = np.array([2.0, 2.0, 0.4]), 0.2


@dataclass(frozen=True, eq=False)
class Adjusted:
    """What edges and prior say together.

    Attributes:
        rig: the cameras.
        changes: (C, P) by which their unknowns differ from the prior's.
        covariance: (C, P, P) of the unknowns of each camera.
        parameters: (N, 6) vehicles, in the order of `wibam_core.lifting.fit`.
        noise: how many times worse than stated the edges are.
        residuals_px: (N, V, 4) of the edges that are compared; NaN for others.
        late_s: (C,) by how much each camera's clock runs behind, beside what synchronisation says.
    """

    rig: CameraRig
    changes: FloatArray
    covariance: FloatArray
    parameters: FloatArray
    noise: float
    residuals_px: FloatArray
    late_s: FloatArray


def adjust(sightings: Sightings, prior: Prior, start: Adjusted | None = None, *, clock_sd_s: float) -> Adjusted:
    """Solve for cameras and vehicles.

    Args:
        sightings: of the vehicles.
        prior: of the cameras. With no unknowns of theirs (P = 0) they stay, and vehicles alone are fitted.
        start: where the cameras' steps begin; else at the prior.
        clock_sd_s: standard deviation of what is left of each clock's error. A vehicle that one camera shows late is
            somewhere else, which would turn the camera.
    """
    weights = 1.0 / np.maximum(1.0, np.bincount(sightings.vehicles) / _INDEPENDENT_SIGHTINGS)[sightings.vehicles]
    changes = np.zeros(prior.own.shape[:2]) if start is None else start.changes
    common = Shared.of(sightings, len(prior.rig.mounted), clock_sd_s)
    shared = np.zeros(len(common.sd))
    parameters = sightings.problem.prior_mean.numpy().copy()
    noise = 3.0
    state = _State.at(sightings, prior, common, changes, shared, parameters, noise, weights)
    for _ in range(3):  # the noise follows from residuals, and these from the noise
        state = _descend(state, _FIRST_STEPS, _FIRST_LEAST_GAIN)
        noise = state.noise_of_residuals()
        state = _State.at(sightings, prior, common, state.changes, state.shared, state.parameters, noise, weights)
    state = _descend(state, _STEPS, _LEAST_GAIN)
    return Adjusted(
        state.rig,
        state.changes,
        state.camera_covariance(),
        state.parameters,
        state.noise,
        state.residuals_px(),
        state.shared[common.clocks],
    )


def _descend(state: _State, steps: int, least_gain: float) -> _State:
    damping = 1e-3
    for _ in range(steps):
        tried = state.stepped(damping)
        if tried.cost < state.cost:
            settled = state.cost - tried.cost < least_gain * state.cost
            state, damping = tried, max(damping * 0.2, 1e-7)
            if settled:
                break
        else:
            damping *= 8.0
            if damping > 1e4:
                break
    return state


@dataclass(frozen=True, eq=False)
class _State:
    """One point in the space of unknowns, with the robust cost there."""

    sightings: Sightings
    prior: Prior
    common: Shared
    changes: FloatArray  # (C, P)
    shared: FloatArray  # (G,)
    parameters: FloatArray
    noise: float
    weights: FloatArray
    rig: CameraRig
    problem: FitProblem
    residuals: FloatArray  # (N, V, 4) in standard deviations; 0 where nothing is compared
    compared: FloatArray  # (N, V, 4) 0 or 1
    exact: FloatArray  # (N, V, 4) whether compared both ways
    contacts: Contacts
    cost: float

    @classmethod
    def at(
        cls,
        sightings: Sightings,
        prior: Prior,
        common: Shared,
        changes: FloatArray,
        shared: FloatArray,
        parameters: FloatArray,
        noise: float,
        weights: FloatArray,
    ) -> _State:
        rig = changed(prior.rig, changes)
        problem = sightings.through(rig)
        late_s = shared[common.clocks][mounts_of(rig)[0][sightings.cameras]]
        problem = replace(
            problem,
            body=problem.body + torch.as_tensor(common.bodies(shared)),
            shift=problem.shift + torch.as_tensor(late_s[..., None] * sightings.velocities[:, None]),
        )
        found = contacts(problem, torch.as_tensor(parameters))
        edges = found.edges.numpy() + outward(problem.boxes.numpy()) @ shared[: len(EDGE_BIAS_SD)]
        off = (edges - problem.boxes.numpy()) / (noise * problem.edge_sd.numpy())
        used, exact = found.used.numpy()[..., None], found.exact.numpy()
        compared = used & (exact | ~(off * [-1.0, -1.0, 1.0, 1.0] >= 0))
        residuals = np.where(compared, off, 0.0)
        robust = 0.5 * ROBUST_SD**2 * np.log1p((residuals / ROBUST_SD) ** 2).sum(axis=(1, 2))
        lost = (problem.seen.numpy() & ~found.used.numpy()).sum(axis=1) * 36.0  # a lost view makes nothing cheaper
        turn, weight = _turn(parameters, problem), problem.prior_weight.numpy()
        cost = float((weights * (robust + lost + 0.5 * weight[:, YAW] * turn**2)).sum())
        off_size, size_weight = _size_prior(sightings, parameters, problem, common.sizes(shared))
        cost += float(0.5 * (size_weight * off_size**2).sum())
        cost += float(0.5 * np.square(shared / common.sd).sum())
        if changes.size:
            cost += float(0.5 * changes.ravel() @ prior.information @ changes.ravel())
        return cls(
            sightings,
            prior,
            common,
            changes,
            shared,
            parameters,
            noise,
            weights,
            rig,
            problem,
            residuals,
            compared.astype(np.float64),
            used & exact,
            found,
            cost,
        )

    @cached_property
    def derivatives(self) -> tuple[FloatArray, FloatArray]:
        """See `_derivatives`."""
        return _derivatives(self)

    def residuals_px(self) -> FloatArray:
        px = self.residuals * self.noise * self.problem.edge_sd.numpy()
        return np.where(self.exact, px, np.nan)

    def noise_of_residuals(self) -> float:
        """How many times worse than stated edges are, by the median over residuals."""
        off = np.abs(self.residuals[self.exact]) * self.noise
        unknowns = 3 * len(self.sightings) + 3 * self.sightings.vehicle_count + self.changes.size
        spare = max(1.0 - unknowns / max(off.size, 1), 0.2)
        median = float(np.median(off)) if off.size else 1.0
        return float(np.clip(_HIDDEN_NOISE * 1.4826 * median / np.sqrt(spare), *_NOISE_LIMITS))

    def stepped(self, damping: float) -> _State:
        """After one damped step."""
        reduced = _Reduced.of(self, damping)
        by_camera, by_size, by_own = reduced.solve()
        parameters = self.parameters.copy()
        parameters[:, _SIZE] += np.clip(by_size, -_STEP_SIZE, _STEP_SIZE)[self.sightings.vehicles]
        parameters[:, _OWN] += np.clip(by_own, -_STEP_OWN, _STEP_OWN)
        changes = self.changes + by_camera[: self.changes.size].reshape(self.changes.shape)
        shared = self.shared + by_camera[self.changes.size :]
        return _State.at(self.sightings, self.prior, self.common, changes, shared, parameters, self.noise, self.weights)

    def camera_covariance(self) -> FloatArray:
        """(C, P, P)."""
        count, own = self.changes.shape
        if not own:
            return np.zeros((count, 0, 0))
        whole = np.linalg.inv(_Reduced.of(self, 0.0).cameras)  # that of what is shared is its last part
        return np.stack([whole[k * own : (k + 1) * own, k * own : (k + 1) * own] for k in range(count)])


def _turn(parameters: FloatArray, problem: FitProblem) -> FloatArray:
    turn = parameters[:, YAW] - problem.prior_mean.numpy()[:, YAW]
    return np.arctan2(np.sin(turn), np.cos(turn))


def _size_prior(
    sightings: Sightings, parameters: FloatArray, problem: FitProblem, classes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of each vehicle (M, 3): how far its size is off what is usual for its class, and the inverse variance of that."""
    first = np.unique(sightings.vehicles, return_index=True)[1]
    off = (parameters - problem.prior_mean.numpy())[first][:, _SIZE] - classes[first]
    return off, problem.prior_weight.numpy()[first][:, _SIZE]


@dataclass(frozen=True, eq=False)
class _Reduced:
    """The normal equations, of which sightings and sizes were eliminated.

    Attributes:
        cameras, pull: (CP, CP) and (CP,) of the cameras.
        sizes, size_pull, size_cameras: (M, 3, 3), (M, 3) and (M, 3, CP) of the vehicles' sizes.
        own, own_pull, own_sizes, own_cameras: (N, 3, 3), (N, 3), (N, 3, 3) and (N, 3, CP) of the sightings.
        vehicles: (N,) of the sightings.
    """

    cameras: FloatArray
    pull: FloatArray
    sizes: FloatArray
    size_pull: FloatArray
    size_cameras: FloatArray
    own: FloatArray
    own_pull: FloatArray
    own_sizes: FloatArray
    own_cameras: FloatArray
    vehicles: IntArray

    @classmethod
    def of(cls, state: _State, damping: float) -> _Reduced:
        vehicles, more = state.sightings.vehicles, 1.0 + damping
        by_vehicle, by_camera = state.derivatives
        robust = state.compared / (1.0 + (state.residuals / ROBUST_SD) ** 2) * state.weights[:, None, None]
        weight, residual = robust.reshape(len(vehicles), -1), state.residuals.reshape(len(vehicles), -1)
        weighted = by_vehicle * weight[..., None]
        hessian = np.einsum("nep,neq->npq", weighted, by_vehicle)
        pull = np.einsum("nep,ne->np", weighted, residual)
        cross = np.einsum("nep,nec->npc", weighted, by_camera)
        known = state.weights * state.problem.prior_weight.numpy()[:, YAW]
        hessian[:, YAW, YAW] += known
        pull[:, YAW] += known * _turn(state.parameters, state.problem)

        own = hessian[:, _OWN[:, None], _OWN] * (1.0 + damping * np.eye(3)) + 1e-6 * np.eye(3)
        own_sizes, own_cameras, own_pull = hessian[:, _OWN[:, None], _SIZE], cross[:, _OWN], pull[:, _OWN]
        solved = np.linalg.solve(own, np.concatenate([own_sizes, own_cameras, own_pull[..., None]], axis=2))
        to_sizes, to_cameras, to_pull = solved[:, :, :3], solved[:, :, 3:-1], solved[:, :, -1]

        count = state.sightings.vehicle_count
        sizes, size_pull = np.zeros((count, 3, 3)), np.zeros((count, 3))
        size_cameras = np.zeros((count, 3, cross.shape[2]))
        transposed = own_sizes.transpose(0, 2, 1)
        np.add.at(sizes, vehicles, hessian[:, _SIZE[:, None], _SIZE] - transposed @ to_sizes)
        np.add.at(size_pull, vehicles, pull[:, _SIZE] - np.einsum("nso,no->ns", transposed, to_pull))
        np.add.at(size_cameras, vehicles, cross[:, _SIZE] - transposed @ to_cameras)
        common = state.common
        off_size, size_weight = _size_prior(
            state.sightings, state.parameters, state.problem, common.sizes(state.shared)
        )
        sizes[:, np.arange(3), np.arange(3)] += size_weight
        size_pull += size_weight * off_size
        # a class's mean size pulls at its vehicles' sizes, and they at it
        of_vehicle = common.classes[np.unique(vehicles, return_index=True)[1]]
        at = state.changes.size + common.clocks.stop + of_vehicle * (3 + common.deformations.shape[1])
        mean_weight, mean_pull = np.zeros(cross.shape[2]), np.zeros(cross.shape[2])
        for axis in range(3):
            size_cameras[np.arange(count), axis, at + axis] -= size_weight[:, axis]
            np.add.at(mean_weight, at + axis, size_weight[:, axis])
            np.add.at(mean_pull, at + axis, -size_weight[:, axis] * off_size[:, axis])
        sizes = sizes * (1.0 + damping * np.eye(3))

        edges = by_camera.reshape(weight.size, cross.shape[2])
        flat = edges * weight.reshape(-1, 1)
        cameras = flat.T @ edges - np.einsum("noc,nod->cd", own_cameras, to_cameras)
        camera_pull = flat.T @ residual.reshape(-1) - np.einsum("noc,no->c", own_cameras, to_pull) + mean_pull
        cameras[np.arange(len(cameras)), np.arange(len(cameras))] += mean_weight
        through = np.linalg.solve(sizes, np.concatenate([size_cameras, size_pull[..., None]], axis=2))
        cameras -= np.einsum("msc,msd->cd", size_cameras, through[:, :, :-1])
        camera_pull -= np.einsum("msc,ms->c", size_cameras, through[:, :, -1])
        first = state.changes.size
        if first:
            cameras[:first, :first] += state.prior.information
            camera_pull[:first] += state.prior.information @ state.changes.ravel()
        shared = np.arange(first, len(cameras))
        cameras[shared, shared] += common.sd**-2.0
        camera_pull[shared] += state.shared * common.sd**-2.0
        cameras[np.arange(len(cameras)), np.arange(len(cameras))] *= more
        return cls(
            cameras, camera_pull, sizes, size_pull, size_cameras, own, own_pull, own_sizes, own_cameras, vehicles
        )

    def solve(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Steps of the cameras (CP,), the sizes (M, 3) and the sightings (N, 3)."""
        camera = np.asarray(-np.linalg.solve(self.cameras, self.pull), dtype=np.float64)
        size = -np.linalg.solve(self.sizes, (self.size_pull + self.size_cameras @ camera)[..., None])[..., 0]
        left = self.own_pull + self.own_cameras @ camera
        left = left + np.einsum("nos,ns->no", self.own_sizes, size[self.vehicles])
        own = -np.linalg.solve(self.own, left[..., None])[..., 0]
        return camera, np.asarray(size, dtype=np.float64), np.asarray(own, dtype=np.float64)


def _derivatives(state: _State) -> tuple[FloatArray, FloatArray]:
    """Of the residuals (N, V·4): by the vehicle's unknowns (…, 6), and by those of all cameras (…, CP)."""
    problem, found = state.problem, state.contacts
    sd = (state.noise * problem.edge_sd).numpy()[..., None]
    by_vehicle = found.derivatives.numpy() / sd
    count, unknowns = state.changes.shape
    cameras = state.sightings.cameras
    mounts, turns = mounts_of(state.rig)
    n, slots = state.sightings.cameras.shape
    by_camera = np.zeros((n, slots, 4, count, unknowns))
    if unknowns:
        slopes, points = found.slopes.numpy(), found.points.numpy()
        own = np.zeros((n, slots, 4, unknowns))
        # turning a camera by w moves what it sees by −w × p
        own[..., ROTATION] = np.einsum("nver,nvrw->nvew", np.cross(slopes, points), turns[cameras])
        own[..., POSITION] = -np.einsum("nvec,nvcw->nvew", slopes, problem.cameras.rotation.numpy())
        for column in range(LOG_FOCAL, unknowns):
            own[..., column] = slopes_by_lens(problem.cameras, found.points, column)
        by_camera[np.arange(n)[:, None], np.arange(slots), :, mounts[cameras]] = own / sd
    shape = (n, slots * 4)
    flat = by_camera.reshape(*shape, count * unknowns)
    by_shared = (_by_shared(state, found) / sd).reshape(*shape, len(state.shared))
    return by_vehicle.reshape(*shape, 6), np.concatenate([flat, by_shared], axis=2)


def _by_shared(state: _State, found: Contacts) -> FloatArray:
    """(N, V, 4, G) derivatives of the edges by what all vehicles share."""
    common, problem = state.common, state.problem
    result = np.zeros((*found.edges.shape, len(state.shared)))
    result[..., : len(EDGE_BIAS_SD)] = outward(problem.boxes.numpy())
    modes = common.deformations.shape[1]
    size = np.exp(state.parameters[:, None, None, None, _SIZE])
    at = np.arange(len(size))[:, None, None]
    local = common.deformations[common.classes][at, :, found.which.numpy()] * size  # (N, V, 4, K, 3)
    cos, sin = (f(state.parameters[:, YAW])[:, None, None, None] for f in (np.cos, np.sin))
    x, y, z = np.moveaxis(local, -1, 0)
    moved_m = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
    in_world = np.einsum("nvec,nvcw->nvew", found.slopes.numpy(), problem.cameras.rotation.numpy())
    velocities, cameras = state.sightings.velocities, mounts_of(state.rig)[0][state.sightings.cameras]
    by_time = np.einsum("nvew,nw->nve", in_world[..., :2], velocities)
    result[at[:, 0], np.arange(cameras.shape[1]), :, common.clocks.start + cameras] = by_time
    by_mode = np.einsum("nvew,nvekw->nvek", in_world, moved_m)
    for number in range(len(common.deformations)):
        own = common.classes == number
        first = common.clocks.stop + number * (3 + modes) + 3
        result[own, ..., first : first + modes] = by_mode[own]
    return result
