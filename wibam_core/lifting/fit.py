"""Batched fits of upright bodies to image boxes, by damped Gauss–Newton (Levenberg–Marquardt) with robust weights.

A vehicle has six unknowns: x, y (m), log length, log width, log height and yaw (rad); it stands on the ground. Its
body's points are projected into every view, and the extreme ones compared with the four edges of that view's box.
All vehicles, starts and views are one tensor program; there is no loop over vehicles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from wibam_core.geometry.gauss_newton import cauchy_weights, newton_steps, normal_equations
from wibam_core.geometry.torch_ops import CameraTensors, giou, project_camera_points
from wibam_core.scene import FloatArray

#: Order of the unknowns.
X, Y, LOG_LENGTH, LOG_WIDTH, LOG_HEIGHT, YAW = range(6)
PLACE, LOG_SIZE = slice(X, LOG_LENGTH), slice(LOG_LENGTH, YAW)

#: Residuals beyond this many standard deviations lose weight (Cauchy).
ROBUST_SD = 1.5
#: The detector only guessed an edge whose standard deviation is more than this share of the box's side. In the overlap
#: by which a fit is judged, a guessed edge counts as met if it is off by at most this many standard deviations.
_GUESSED_SHARE, _NEAR_SD = 0.08, 2.0
#: A view with a body point nearer than this along the optical axis is not compared, m.
_NEAREST_M = 0.5
#: Problems times starts that are solved at once; more would need much memory and be no faster.
_CHUNK = 4096


@dataclass(frozen=True, eq=False)
class FitProblem:
    """B vehicles with V view slots and bodies of P points.

    Attributes:
        cameras: shape (B, V). boxes: (B, V, 4) xyxy, px. edge_sd: (B, V, 4) standard deviations stated, px.
        seen: (B, V) bool. exact: (B, V, 4) bool: compared both ways; other edges only ask for "at least so far".
        cut: (B, V, 2) bool: the image border cuts the box across, down.
        shift: (B, V, 2) displacement of the vehicle on the ground at the view's exposure, m.
        body: (B, P, 3) points in lengths, widths and heights from the centre.
        noise: (B,) how many times worse than stated the edges are.
        prior_mean: (B, 6). prior_weight: (B, 6) inverse variances, 0 for unknown; yaw is compared modulo 2π.
    """

    cameras: CameraTensors
    boxes: Tensor
    edge_sd: Tensor
    seen: Tensor
    exact: Tensor
    cut: Tensor
    shift: Tensor
    body: Tensor
    noise: Tensor
    prior_mean: Tensor
    prior_weight: Tensor

    def __len__(self) -> int:
        return len(self.boxes)

    def sd(self) -> Tensor:
        """(B, V, 4) standard deviations of the boxes' edges, px."""
        return self.edge_sd * self.noise[:, None, None]

    def __getitem__(self, index: Tensor | slice) -> FitProblem:
        return FitProblem(
            self.cameras[index],
            self.boxes[index],
            self.edge_sd[index],
            self.seen[index],
            self.exact[index],
            self.cut[index],
            self.shift[index],
            self.body[index],
            self.noise[index],
            self.prior_mean[index],
            self.prior_weight[index],
        )


@dataclass(frozen=True, eq=False)
class Fit:
    """Solutions of B problems.

    Attributes:
        parameters: (B, 6). cost: (B,) robust cost, prior included.
        information: (B, 6, 6) of the views alone, without the prior.
        view_giou: (B, V) generalised IoU of the fitted and the seen box, 1 in unused slots.
        residuals: (B, V, 4) of edges in their standard deviations; NaN where not compared both ways.
    """

    parameters: Tensor
    cost: Tensor
    information: Tensor
    view_giou: Tensor
    residuals: Tensor

    def __getitem__(self, index: Tensor) -> Fit:
        return Fit(
            self.parameters[index],
            self.cost[index],
            self.information[index],
            self.view_giou[index],
            self.residuals[index],
        )


def fit(problem: FitProblem, starts: Tensor, iterations: int) -> Fit:
    """Solve every problem from every start and keep the cheapest solution.

    Args:
        problem: B vehicles.
        starts: (B, S, 6).
        iterations: most steps per start; it stops where nothing moves any more.
    """
    b, s = starts.shape[:2]
    solved: list[Fit] = []
    size = max(1, _CHUNK // s)
    for begin in range(0, b, size):
        chunk = problem[slice(begin, begin + size)]
        n = len(chunk)
        repeated = chunk[torch.arange(n).repeat_interleave(s)]
        parameters, cost = _descend(repeated, starts[begin : begin + size].reshape(n * s, 6), iterations)
        best = cost.reshape(n, s).argmin(dim=1)
        chosen = parameters.reshape(n, s, 6)[torch.arange(n), best]
        solved.append(evaluate(chunk, chosen))
    return joined(solved)


def joined(fits: Sequence[Fit]) -> Fit:
    """All solutions one after the other."""
    return Fit(*(torch.cat([getattr(f, name) for f in fits]) for name in Fit.__dataclass_fields__))


def evaluate(problem: FitProblem, parameters: Tensor) -> Fit:
    """Cost, information and overlap of given solutions (B, 6)."""
    state = _linearise(problem, parameters)
    compared = state.exact & state.used[..., None]
    residuals = torch.where(compared, (state.predicted - problem.boxes) / problem.sd(), torch.nan)
    return Fit(parameters, state.cost, state.data_hessian, _view_giou(problem, state), residuals)


def _descend(problem: FitProblem, parameters: Tensor, iterations: int) -> tuple[Tensor, Tensor]:
    """Levenberg–Marquardt on each problem by itself; settled ones drop out of the batch."""
    result = parameters.clone()
    costs = torch.full((len(problem),), torch.inf, dtype=parameters.dtype)
    active = torch.arange(len(problem))
    state = _linearise(problem, parameters)
    damping = torch.full((len(problem),), 1e-2, dtype=parameters.dtype)
    for _ in range(iterations):
        step = _solve(state.hessian, state.gradient, damping)
        trial = parameters + step
        tried = _linearise(problem, trial)
        better = tried.cost < state.cost
        gained = state.cost - tried.cost
        parameters = torch.where(better[:, None], trial, parameters)
        settled = (better & (gained < 1e-4 * state.cost.clamp_min(1e-3))) | (~better & (damping > 1e3))
        state = state.updated(tried, better)
        damping = torch.where(better, damping * 0.2, damping * 8.0).clamp(1e-5, 1e5)
        result[active], costs[active] = parameters, state.cost
        moving = ~settled
        if not bool(moving.any()):
            break
        if int(moving.sum()) < 0.7 * len(moving):
            active, parameters, damping = active[moving], parameters[moving], damping[moving]
            problem, state = problem[moving], state[moving]
    return result, costs


def _solve(hessian: Tensor, gradient: Tensor, damping: Tensor) -> Tensor:
    diagonal = hessian.diagonal(dim1=-2, dim2=-1)
    damped = hessian + torch.diag_embed(damping[:, None] * diagonal + 1e-4)
    step = newton_steps(damped, gradient)
    limit = step.new_tensor([2.0, 2.0, 0.2, 0.2, 0.2, 0.4])
    return torch.maximum(torch.minimum(step, limit), -limit)


@dataclass(frozen=True, eq=False)
class _State:
    cost: Tensor  # (B,)
    gradient: Tensor  # (B, 6)
    hessian: Tensor  # (B, 6, 6)
    data_hessian: Tensor  # (B, 6, 6)
    predicted: Tensor  # (B, V, 4)
    exact: Tensor  # (B, V, 4)
    used: Tensor  # (B, V)

    def updated(self, other: _State, take: Tensor) -> _State:
        def pick(name: str) -> Tensor:
            mine: Tensor = getattr(self, name)
            return torch.where(take.reshape(-1, *[1] * (mine.dim() - 1)), getattr(other, name), mine)

        return _State(*(pick(name) for name in self.__dataclass_fields__))

    def __getitem__(self, index: Tensor) -> _State:
        return _State(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def _linearise(problem: FitProblem, parameters: Tensor) -> _State:
    """Robust cost, gradient and Gauss–Newton Hessian at (B, 6)."""
    edges, jacobian, exact, used = predicted_edges(problem, parameters)
    sd = problem.sd()
    residual = (edges - problem.boxes) / sd
    outward = residual.new_tensor([-1.0, -1.0, 1.0, 1.0])
    beyond = residual * outward >= 0
    compared = used[..., None] & (exact | ~beyond)
    residual = torch.where(compared, residual, torch.zeros_like(residual))
    weight = compared * cauchy_weights(residual, ROBUST_SD)
    prior_residual = parameters - problem.prior_mean
    turn = prior_residual[:, YAW]
    prior_residual = torch.cat([prior_residual[:, :YAW], torch.atan2(turn.sin(), turn.cos())[:, None]], dim=1)
    # a view that drops out must not make a fit cheaper
    lost = (problem.seen & ~used).sum(dim=1) * (4 * 9.0)
    cost = (
        0.5 * ROBUST_SD**2 * torch.log1p((residual / ROBUST_SD) ** 2).sum(dim=(1, 2))
        + 0.5 * (problem.prior_weight * prior_residual**2).sum(dim=1)
        + lost
    )
    data_hessian, gradient = normal_equations(
        (jacobian / sd[..., None]).flatten(1, 2), residual.flatten(1), weight.flatten(1)
    )
    gradient = gradient + problem.prior_weight * prior_residual
    hessian = data_hessian + torch.diag_embed(problem.prior_weight)
    return _State(cost, gradient, hessian, data_hessian, edges, exact, used)


@dataclass(frozen=True, eq=False)
class Contacts:
    """Where bodies touch the edges of their image boxes: B vehicles, V views, 4 edges (left, top, right, bottom).

    Attributes:
        edges: (B, V, 4) xyxy, px. exact: (B, V, 4) edges that can be compared both ways. used: (B, V) views that can be
            compared at all.
        derivatives: (B, V, 4, 6) of the edges by the unknowns.
        which: (B, V, 4) number of the body's point that makes each edge. points: (B, V, 4, 3) where it is in the
            camera's frame, m.
        slopes: (B, V, 4, 3) of the edges by these points, px/m.
    """

    edges: Tensor
    exact: Tensor
    used: Tensor
    derivatives: Tensor
    which: Tensor
    points: Tensor
    slopes: Tensor


def predicted_edges(problem: FitProblem, parameters: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Edges (B, V, 4) of the body's image boxes, their derivatives (B, V, 4, 6), which edges can be compared both ways
    (B, V, 4), and which views can be compared at all (B, V)."""
    found = contacts(problem, parameters)
    return found.edges, found.derivatives, found.exact, found.used


def contacts(problem: FitProblem, parameters: Tensor) -> Contacts:
    """The edges of the image boxes of bodies (B, 6), and the points of the bodies that make them."""
    size = parameters[:, LOG_SIZE].exp()
    cos, sin = parameters[:, YAW].cos(), parameters[:, YAW].sin()
    local = problem.body * size[:, None]
    local = torch.cat([local[..., :2], local[..., 2:] + 0.5 * size[:, None, 2:]], dim=-1)
    turned = torch.stack(
        [
            cos[:, None] * local[..., 0] - sin[:, None] * local[..., 1],
            sin[:, None] * local[..., 0] + cos[:, None] * local[..., 1],
            local[..., 2],
        ],
        dim=-1,
    )
    rotation = problem.cameras.rotation
    ground = parameters[:, None, PLACE] + problem.shift
    base = (rotation[..., :2] @ ground[..., None])[..., 0] + problem.cameras.translation
    points = (turned[:, None] @ rotation.transpose(-1, -2)) + base[:, :, None]
    used = problem.seen & (points[..., 2].amin(dim=-1) > _NEAREST_M)
    safe = torch.cat([points[..., :2], points[..., 2:].clamp_min(0.1)], dim=-1)
    pixels = project_camera_points(problem.cameras, safe)
    low, at_low = pixels.min(dim=2)
    high, at_high = pixels.max(dim=2)
    which = torch.cat([at_low, at_high], dim=-1)  # (B, V, 4) body point of each edge
    batch = torch.arange(len(parameters))[:, None, None]
    view = torch.arange(which.shape[1])[None, :, None]
    touching = safe[batch, view, which]  # (B, V, 4, 3)
    slope = _pixel_slopes(problem.cameras, touching)
    # in a view that the border cuts, the point that makes an edge may itself lie out of the image
    across = torch.take_along_dim(pixels, which[..., None], dim=2).flip(-1)
    inside = ((across > -0.5) & (across < problem.cameras.size[:, :, None].flip(-1) - 0.5)) | ~problem.cut[
        :, :, None
    ].flip(-1)
    exact = problem.exact & torch.stack([inside[:, :, k, k % 2] for k in range(4)], dim=-1)
    # derivatives of the world point of each edge: (B, V, 4, 3, 6)
    body = local[batch, which]
    jacobian = _point_jacobian(body, size[:, 2], cos, sin)
    in_camera = (slope[..., None, :] @ rotation[:, :, None])[..., 0, :]
    derivatives = (in_camera[..., None, :] @ jacobian)[..., 0, :]
    return Contacts(torch.cat([low, high], dim=-1), exact, used, derivatives, which, touching, slope)


def _pixel_slopes(cameras: CameraTensors, points: Tensor) -> Tensor:
    """Slope (B, V, 4, 3) of the edge's pixel coordinate (u, v, u, v) along each axis of its point (B, V, 4, 3)."""
    step = 1e-3 * points[..., 2:]
    offsets = torch.eye(3, dtype=points.dtype)
    moved = points[..., None, :] + step[..., None] * offsets
    back = points[..., None, :] - step[..., None] * offsets
    slopes = (project_camera_points(cameras, moved) - project_camera_points(cameras, back)) / (2 * step[..., None])
    return torch.stack([slopes[:, :, 0, :, 0], slopes[:, :, 1, :, 1], slopes[:, :, 2, :, 0], slopes[:, :, 3, :, 1]], 2)


def _point_jacobian(local: Tensor, height: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """(B, V, 4, 3, 6) derivatives of world points by the unknowns; ``local`` (B, V, 4, 3) from the base's centre, m."""
    x, y, z = local.unbind(-1)
    c, s = cos[:, None, None], sin[:, None, None]
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    rows = [
        [one, zero, c * x, -s * y, zero, -s * x - c * y],
        [zero, one, s * x, c * y, zero, c * x - s * y],
        [zero, zero, zero, zero, z, zero],
    ]
    return torch.stack([torch.stack([t.expand_as(x) for t in row], dim=-1) for row in rows], dim=-2)


def _view_giou(problem: FitProblem, state: _State) -> Tensor:
    """(B, V): an edge that is cut or hidden counts as met where the fit reaches beyond it, and one that is only guessed
    where the fit is near."""
    boxes, predicted, used = problem.boxes, state.predicted, state.used
    outward = predicted.new_tensor([-1.0, -1.0, 1.0, 1.0])
    off = predicted - boxes
    met = ~state.exact & (off * outward >= 0)
    near = _NEAR_SD * problem.edge_sd
    guessed = problem.edge_sd > _GUESSED_SHARE * (boxes[..., 2:] - boxes[..., :2]).repeat(1, 1, 2)
    off = torch.where(guessed, off - off.clamp(-near, near), off)
    overlap = giou(torch.where(met, boxes, boxes + off), boxes)
    return torch.where(used, overlap, torch.where(problem.seen, -torch.ones_like(overlap), torch.ones_like(overlap)))


def yaw_starts(parameters: Tensor, turns: int) -> Tensor:
    """(B, turns, 6): ``parameters`` (B, 6) with yaw turned in equal steps over half a turn."""
    steps = torch.arange(turns, dtype=parameters.dtype) * (math.pi / turns)
    starts = parameters[:, None].repeat(1, turns, 1)
    starts[..., YAW] = starts[..., YAW] + steps
    return starts


def with_noise(problem: FitProblem, noise: float) -> FitProblem:
    """The same problem with edges that are ``noise`` times worse than stated."""
    return replace(problem, noise=torch.full_like(problem.noise, noise))


def with_bodies(problem: FitProblem, bodies: FloatArray) -> FitProblem:
    """The same problem with other bodies (B, P, 3)."""
    return replace(problem, body=torch.as_tensor(bodies, dtype=problem.body.dtype))
