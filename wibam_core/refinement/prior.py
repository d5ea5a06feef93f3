"""What is known of a calibration before the traffic is looked at."""

from __future__ import annotations

import numpy as np

from wibam_core.calibration.covariance import ground_moves
from wibam_core.calibration.view import visible_ground
from wibam_core.config import RefineConfig
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.geometry.camera import Camera
from wibam_core.refinement.cameras import Prior, against_the_road
from wibam_core.scene import CameraRig, FloatArray

#: Points are never believed to fix a camera better than this: about each axis (rad), along each axis (m). Intrinsics
#: that were given with them, and the heights that they are said to have, err as well.
_LEAST_ROTATION_SD_RAD, _LEAST_POSITION_SD_M = float(np.radians(0.05)), 0.02
#: Standard deviations of the logarithm of a focal length and of the first distortion coefficient that were given.
_LOG_FOCAL_SD, _K1_SD = 0.01, 0.01
#: The road's plane may tilt by as much as lifts it by its standard deviation this far from the middle, m.
TILT_REACH_M = 40.0
#: So well is the road known where cameras were solved from points, some of which lie on it, m.
_POINTS_HEIGHT_SD_M = 0.1
#: Ready matrices are as good as this many places on the road, spread over what the camera sees within this distance.
_ANCHORS, _ANCHOR_REACH_M = 2.0, 50.0
#: Number of unknowns of a camera for each choice of intrinsics.
_UNKNOWNS = {"none": 6, "focal": 7, "focal_k1": 8}


def prior_of(rig: CameraRig, residuals: CalibrationResiduals, config: RefineConfig) -> Prior:
    """The cameras' covariances: by their points where they were solved from such, else as the options say."""
    own = np.stack([_covariance(rig, residuals, camera_id, config) for camera_id in rig.mounted])
    height_sd_m = _height_sd_m(rig, residuals, config)
    return Prior(rig, own, against_the_road(rig, own.shape[1], height_sd_m, height_sd_m / TILT_REACH_M))


def ground_of(changes: FloatArray, prior: Prior) -> tuple[float, float, float]:
    """How the road's plane lies in the world before, by what cameras moved together: its height where the cameras have
    their middle, m, and its slopes along X and Y. It is the mean of what changes (C, P) of the cameras leave open."""
    whole = prior.common.reshape(changes.size, -1)
    rise, about_x, about_y = whole.T @ prior.information @ changes.ravel()
    height_sd_m = float(np.abs(prior.common[0, :, 0]).max())
    tilt_sd_rad = height_sd_m / TILT_REACH_M
    # cameras that rise see a road that lies lower; turned about X they rise where y is large
    return -height_sd_m * float(rise), tilt_sd_rad * float(about_y), -tilt_sd_rad * float(about_x)


def rests_on_points(rig: CameraRig, residuals: CalibrationResiduals) -> bool:
    """Whether every camera was solved from points, whose covariance says where in the world it is."""
    known = (residuals.cameras.get(name) for name in rig.mounted)
    return all(camera is not None and camera.covariance is not None for camera in known)


def _height_sd_m(rig: CameraRig, residuals: CalibrationResiduals, config: RefineConfig) -> float:
    """Of the road: as the options say, but for cameras that all rest on points, which lie on it."""
    on_points = rests_on_points(rig, residuals)
    return min(config.ground_sd_m, _POINTS_HEIGHT_SD_M) if on_points else config.ground_sd_m


def _covariance(rig: CameraRig, residuals: CalibrationResiduals, camera_id: str, config: RefineConfig) -> FloatArray:
    camera = residuals.cameras.get(camera_id)
    unknowns = _UNKNOWNS[config.intrinsics]
    matrix = np.zeros((unknowns, unknowns))
    if camera is None or camera.covariance is None:
        matrix[:6, :6] = _of_ready_matrices(rig.mounted[camera_id], config)
    else:
        floor = [_LEAST_ROTATION_SD_RAD] * 3 + [_LEAST_POSITION_SD_M] * 3
        matrix[:6, :6] = np.array(camera.covariance)[:6, :6] + np.diag(np.square(floor))
    matrix[np.arange(6, unknowns), np.arange(6, unknowns)] = np.square([_LOG_FOCAL_SD, _K1_SD][: unknowns - 6])
    return matrix


def _of_ready_matrices(camera: Camera, config: RefineConfig) -> FloatArray:
    """(6, 6) covariance of the pose of a camera of which nothing but matrices is known.

    Whoever made them looked at where the camera sees places on the road. They are taken to be right to
    `refine.rotation_sd_deg` of their distance, along the line of sight as well as across it: by rotations alone, places
    would be known several times worse along it, since rays graze the road.
    """
    sd = [np.radians(config.rotation_sd_deg)] * 3 + [config.position_sd_m] * 3
    information = np.diag(np.square(sd) ** -1.0)
    ground = visible_ground(camera)
    away = np.linalg.norm(ground - camera.centre_m, axis=1)
    ground, away = ground[away <= _ANCHOR_REACH_M], away[away <= _ANCHOR_REACH_M]
    if len(ground):
        moves = ground_moves(camera, ground) / (np.radians(config.rotation_sd_deg) * away)[:, None, None]
        information += _ANCHORS / len(ground) * np.einsum("npi,npj->ij", moves, moves)
    return np.asarray(np.linalg.inv(information))
