"""How far a fixed camera was turned, from its still background then and now.

A turn moves the picture of everything, near or far, as K R K⁻¹ does. The two pictures are compared patch by patch, by
phase correlation of their edges, which light and shadows change least; the turn that most patches agree on is found
by random samples and then fitted to all that agree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.formats.usual import Gray
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3

Array = NDArray[np.float64]

#: Side of a patch and how far patches lie apart, px of the still pictures.
_PATCH_PX, _STEP_PX = 96, 48
#: A patch says something if its peak is this high (of 1), and if it has edges (gray values).
_LEAST_RESPONSE, _LEAST_CONTRAST = 0.08, 4.0
#: A patch agrees with a turn if it moved as that says to within this, px.
_AGREES_PX = 1.0
_SAMPLES = 200
_FEWEST_PATCHES = 12


@dataclass(frozen=True)
class Turn:
    """How far a camera was turned.

    Attributes:
        rotation_rad: (3,) rotation vector in the camera's own frame (x right, y down, z forward) from its old to its
            new directions: R_old_new.
        patches: how many patches of the picture said something. agree: the share of them that this turn explains.
        residual_px: root mean square of what remains where they agree, px of the still picture.
    """

    rotation_rad: tuple[float, float, float]
    patches: int
    agree: float
    residual_px: float

    @property
    def angle_deg(self) -> float:
        return float(np.rad2deg(np.linalg.norm(self.rotation_rad)))


def turn_between(before: Gray, after: Gray, camera: Camera) -> Turn | None:
    """How far a camera was turned between two still pictures of one size; None where they do not tell.

    Args:
        before: (H, W).
        after: (H, W).
        camera: with a pinhole's K, of any size with the pictures' aspect ratio, as it was before.
    """
    if before.shape != after.shape:
        return None
    places, moved = _moved_patches(_edges(before), _edges(after))
    if len(places) < _FEWEST_PATCHES:
        return None
    K = camera.resized(before.shape[1], before.shape[0]).K
    rows = _jacobian(places, K)
    rng = np.random.default_rng(0)
    best = np.zeros(len(places), bool)
    for _ in range(_SAMPLES):
        chosen = rng.choice(len(places), 2, replace=False)
        omega, *_ = np.linalg.lstsq(rows[chosen].reshape(-1, 3), moved[chosen].ravel(), rcond=None)
        agree = np.hypot(*(moved - rows @ omega).T) < _AGREES_PX
        if agree.sum() > best.sum():
            best = agree
    if best.sum() < _FEWEST_PATCHES // 2:
        return None
    omega, *_ = np.linalg.lstsq(rows[best].reshape(-1, 3), moved[best].ravel(), rcond=None)
    rest = moved[best] - rows[best] @ omega
    x, y, z = omega.tolist()
    return Turn((x, y, z), len(places), float(best.mean()), float(np.sqrt((rest**2).sum(axis=1).mean())))


def turned(camera: Camera, turn: Turn) -> Camera:
    """The camera as it looks after a turn about its own place."""
    R_old_new = cv2.Rodrigues(np.array(turn.rotation_rad))[0]
    pose = camera.T_world_cam
    return replace(camera, T_world_cam=SE3(pose.rotation @ R_old_new, pose.translation))


def _edges(picture: Gray) -> Array:
    """(H, W) strength of edges, evened out over the picture."""
    smooth = cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32)
    strength = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    usual = cv2.GaussianBlur(strength, (0, 0), 24.0) + 1.0
    return (strength / usual * np.minimum(1.0, usual / _LEAST_CONTRAST)).astype(np.float64)


def _moved_patches(before: Array, after: Array) -> tuple[Array, Array]:
    """Middles (N, 2) of the patches that tell something, px, and how far what they show has moved (N, 2)."""
    window = cv2.createHanningWindow((_PATCH_PX, _PATCH_PX), cv2.CV_64F)
    places, moved = [], []
    for top in range(0, before.shape[0] - _PATCH_PX + 1, _STEP_PX):
        for left in range(0, before.shape[1] - _PATCH_PX + 1, _STEP_PX):
            part = np.s_[top : top + _PATCH_PX, left : left + _PATCH_PX]
            if before[part].std() < 0.2 or after[part].std() < 0.2:
                continue
            (dx, dy), response = cv2.phaseCorrelate(
                np.ascontiguousarray(before[part]), np.ascontiguousarray(after[part]), window
            )
            if response >= _LEAST_RESPONSE and max(abs(dx), abs(dy)) < _PATCH_PX / 3:
                places.append((left + (_PATCH_PX - 1) / 2, top + (_PATCH_PX - 1) / 2))
                moved.append((dx, dy))
    return np.array(places).reshape(-1, 2), np.array(moved).reshape(-1, 2)


def _jacobian(places: Array, K: Array) -> Array:
    """(N, 2, 3) how points of the picture move, in px, with a small rotation vector of the camera (`Turn`)."""
    x = (places[:, 0] - K[0, 2]) / K[0, 0]
    y = (places[:, 1] - K[1, 2]) / K[1, 1]
    # d = R^T d0 ≈ d0 − ω × d0
    du = K[0, 0] * np.stack([x * y, -(1 + x**2), y], axis=1)
    dv = K[1, 1] * np.stack([1 + y**2, -x * y, -x], axis=1)
    return np.stack([du, dv], axis=1)
