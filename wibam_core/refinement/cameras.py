"""The unknowns of cameras, and what is known of them before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

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
    """What is known of C cameras, as they hang at the site, before.

    The world's plane Z = 0 is where the road is said to be. Where the road truly lies is not known as well as where
    cameras are against each other, so that all of them may move together against it: up and down, and tilting.

    Attributes:
        rig: the cameras.
        own: (C, P, P) covariance of each camera's unknowns: 6, or 7 with the focal length, or 8 with the distortion as
            well.
        common: (C, P, G) by how much these change with each of G motions of all cameras together, in standard
            deviations of these motions; see `against_the_road`.
    """

    rig: CameraRig
    own: FloatArray
    common: FloatArray

    @classmethod
    def fixed(cls, rig: CameraRig) -> Prior:
        """Cameras that stay where they are."""
        none = np.zeros((len(rig.mounted), 0, 0))
        return cls(rig, none, none)

    @property
    def covariance(self) -> FloatArray:
        """(C, P, P) of each camera by itself."""
        return self.own + self.common @ self.common.transpose(0, 2, 1)

    @cached_property
    def information(self) -> FloatArray:
        """(CP, CP) inverse covariance of all unknowns, camera by camera."""
        count, unknowns = self.own.shape[:2]
        joint = np.zeros((count, unknowns, count, unknowns))
        joint[np.arange(count), :, np.arange(count)] = self.own
        flat = self.common.reshape(count * unknowns, -1)
        return np.asarray(np.linalg.inv(joint.reshape(len(flat), -1) + flat @ flat.T))


def against_the_road(rig: CameraRig, unknowns: int, height_sd_m: float, tilt_sd_rad: float) -> FloatArray:
    """(C, unknowns, 3) what `Prior.common` is where cameras rise together above the road and tilt about the world's X
    and Y axes through their middle."""
    middle = np.mean([camera.centre_m for camera in rig.mounted.values()], axis=0)
    found = np.zeros((len(rig.mounted), unknowns, 3))
    for own, camera in zip(found, rig.mounted.values(), strict=True):
        own[POSITION, 0] = [0.0, 0.0, height_sd_m]
        for column, axis in ((1, np.array([1.0, 0.0, 0.0])), (2, np.array([0.0, 1.0, 0.0]))):
            own[ROTATION, column] = tilt_sd_rad * camera.T_world_cam.rotation.T @ axis
            own[POSITION, column] = tilt_sd_rad * np.cross(axis, camera.centre_m - middle)
    return found


def changed(rig: CameraRig, changes: FloatArray) -> CameraRig:
    """The cameras with their unknowns changed by (C, P); views turn and move with the camera that they are cut from."""
    mounted = zip(rig.mounted.items(), changes, strict=True)
    return CameraRig({name: _changed(camera, own) for (name, camera), own in mounted}, rig.views)


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
