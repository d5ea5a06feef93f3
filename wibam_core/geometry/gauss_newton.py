"""Gauss–Newton for many small problems of least squares at once, each with unknowns of its own.

Residuals count in standard deviations, and less and less beyond some of them (Cauchy's loss by reweighting), so that
what is plainly wrong pulls at nothing. Whoever fits says how residuals follow from the unknowns, and how often a step
is taken: vehicles are fitted to several views with damping until they settle (`wibam_core.lifting.fit`), single
detections, which start close to where they end, with a few plain steps (`wibam_core.models.reconcile`). SciPy solves
one problem at a time and would take minutes for either.
"""

from __future__ import annotations

import torch
from torch import Tensor


def cauchy_weights(residuals: Tensor, robust_sd: float) -> Tensor:
    """Weights (...) in (0, 1] of residuals (...) in standard deviations: ½ at ``robust_sd``."""
    return 1 / (1 + (residuals / robust_sd) ** 2)


def normal_equations(jacobian: Tensor, residuals: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Information and gradient of ½ Σ w r².

    Args:
        jacobian: (..., R, P) derivatives of the residuals by the unknowns.
        residuals: (..., R).
        weights: (..., R).

    Returns:
        (..., P, P) Jᵀ W J, whose inverse is the covariance of the unknowns, and (..., P) Jᵀ W r.
    """
    weighted = jacobian * weights[..., None]
    return weighted.transpose(-1, -2) @ jacobian, (weighted * residuals[..., None]).sum(dim=-2)


def newton_steps(information: Tensor, gradient: Tensor) -> Tensor:
    """Steps (..., P) to where the gradient (..., P) vanishes; none where the information is not positive definite."""
    factor, failed = torch.linalg.cholesky_ex(information)
    step = -torch.cholesky_solve(gradient[..., None], factor)[..., 0]
    return torch.where((failed > 0)[..., None] | ~step.isfinite(), torch.zeros_like(step), step)
