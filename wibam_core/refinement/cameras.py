"""The unknowns of cameras, and what is known of them before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.geometry.torch_ops import CameraTensors, project_camera_points
from wibam_core.scene import CameraRig, FloatArray

#: The unknowns of a camera: its rotation about its own axes (rad), its position along the world's (m), and on request
#: the logarithm of its focal length and the first coefficient of its distortion.
ROTATION, POSITION = slice(0, 3), slice(3, 6)
LOG_FOCAL, K1 = 6, 7
#: Step of the derivatives by focal length and distortion.
_STEP_LENS = 1e-5


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of C cameras before.

    Attributes:
        rig: the cameras.
        covariance: (C, P, P) of their unknowns: 6, or 7 with the focal length, or 8 with the distortion as well.
    """

    rig: CameraRig
    covariance: FloatArray


def changed(rig: CameraRig, changes: FloatArray) -> CameraRig:
    """The cameras with their unknowns changed by (C, P)."""
    return CameraRig({name: _changed(rig[name], own) for name, own in zip(rig, changes, strict=True)})


def _changed(camera: Camera, change: FloatArray) -> Camera:
    if not len(change):
        return camera
    pose = camera.T_world_cam
    rotation = pose.rotation @ cv2.Rodrigues(change[ROTATION])[0]
    K, dist = camera.K.copy(), camera.dist.copy()
    if len(change) > LOG_FOCAL:
        K[:2, :2] *= np.exp(change[LOG_FOCAL])
    if len(change) > K1:
        dist = dist if dist.size else np.zeros(4)
        dist[0] += change[K1]
    return replace(camera, K=K, dist=dist, T_world_cam=SE3(rotation, pose.translation + change[POSITION]))


def slopes_by_lens(cameras: CameraTensors, points: torch.Tensor, column: int) -> FloatArray:
    """(N, V, 4) derivatives of the edges of boxes by `LOG_FOCAL` or `K1`; points (N, V, 4, 3) make the edges."""
    turned = _with_focal if column == LOG_FOCAL else _with_k1
    ahead, behind = (_coordinates(turned(cameras, sign * _STEP_LENS), points) for sign in (1.0, -1.0))
    return (ahead - behind) / (2 * _STEP_LENS)


def _coordinates(cameras: CameraTensors, points: torch.Tensor) -> FloatArray:
    """The coordinate of each point that is its edge (u, v, u, v): (N, V, 4)."""
    pixels = project_camera_points(cameras, points).numpy()
    return np.asarray(pixels[..., np.arange(4), np.arange(4) % 2])


def _with_focal(cameras: CameraTensors, change: float) -> CameraTensors:
    K = cameras.K.clone()
    K[..., :2, :2] *= 1.0 + change
    return replace(cameras, K=K)


def _with_k1(cameras: CameraTensors, change: float) -> CameraTensors:
    dist = cameras.dist.clone()
    dist[..., 0] += change
    return replace(cameras, dist=dist)
