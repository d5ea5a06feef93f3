from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from wibam_core.geometry.gauss_newton import cauchy_weights, newton_steps, normal_equations


def test_steps_lead_to_what_scipy_finds_with_cauchys_loss() -> None:
    """Eight curves a·exp(b·t) at once, each with points that lie far off."""
    rng = np.random.default_rng(0)
    true = np.stack([rng.uniform(1, 3, 8), rng.uniform(-0.8, 0.8, 8)], axis=1)
    t = np.linspace(0, 2, 40)
    seen = true[:, :1] * np.exp(true[:, 1:] * t) + rng.normal(0, 0.05, (8, 40))
    seen[:, ::9] += rng.uniform(0.5, 1.0, (8, 5))
    robust_sd, sd = 2.0, 0.05
    unknowns = torch.from_numpy(true)
    times, values = torch.from_numpy(t), torch.from_numpy(seen)
    for _ in range(40):
        growth = torch.exp(unknowns[:, 1:] * times)
        residuals = (unknowns[:, :1] * growth - values) / sd
        jacobian = torch.stack([growth, unknowns[:, :1] * times * growth], dim=-1) / sd
        information, gradient = normal_equations(jacobian, residuals, cauchy_weights(residuals, robust_sd))
        unknowns = unknowns + newton_steps(information, gradient)
    for k in range(8):
        found = least_squares(
            lambda x, k=k: (x[0] * np.exp(x[1] * t) - seen[k]) / sd, true[k], loss="cauchy", f_scale=robust_sd
        )
        assert unknowns[k].numpy() == pytest.approx(found.x, abs=1e-5)
        assert np.abs(found.x - true[k]).max() < 0.1


def test_problems_that_fix_nothing_stay_where_they_are() -> None:
    information = torch.stack([torch.eye(2), torch.zeros(2, 2), torch.full((2, 2), torch.nan)])
    steps = newton_steps(information, torch.ones(3, 2))
    assert steps.tolist() == [[-1.0, -1.0], [0.0, 0.0], [0.0, 0.0]]
