"""What is known of a calibration before the traffic is looked at."""

from __future__ import annotations

import numpy as np

from wibam_core.config import RefineConfig
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.refinement.cameras import Prior
from wibam_core.scene import CameraRig, FloatArray

#: Points are never believed to fix a camera better than this: about each axis (rad), along each axis (m). Intrinsics
#: that were given with them, and the heights that they are said to have, err as well.
_LEAST_ROTATION_SD_RAD, _LEAST_POSITION_SD_M = float(np.radians(0.05)), 0.02
#: Standard deviations of the logarithm of a focal length and of the first distortion coefficient that were given.
_LOG_FOCAL_SD, _K1_SD = 0.01, 0.01
#: Number of unknowns of a camera for each choice of intrinsics.
_UNKNOWNS = {"none": 6, "focal": 7, "focal_k1": 8}


def prior_of(rig: CameraRig, residuals: CalibrationResiduals, config: RefineConfig) -> Prior:
    """The cameras' covariances: by their points where they were solved from such, else as the options say."""
    return Prior(rig, np.stack([_covariance(residuals, camera_id, config) for camera_id in rig]))


def _covariance(residuals: CalibrationResiduals, camera_id: str, config: RefineConfig) -> FloatArray:
    camera = residuals.cameras.get(camera_id)
    unknowns = _UNKNOWNS[config.intrinsics]
    matrix = np.zeros((unknowns, unknowns))
    if camera is None or camera.covariance is None:
        sd = [np.radians(config.rotation_sd_deg)] * 3 + [config.position_sd_m] * 3
        matrix[:6, :6] = np.diag(np.square(sd))
    else:
        floor = [_LEAST_ROTATION_SD_RAD] * 3 + [_LEAST_POSITION_SD_M] * 3
        matrix[:6, :6] = np.array(camera.covariance)[:6, :6] + np.diag(np.square(floor))
    matrix[np.arange(6, unknowns), np.arange(6, unknowns)] = np.square([_LOG_FOCAL_SD, _K1_SD][: unknowns - 6])
    return matrix
