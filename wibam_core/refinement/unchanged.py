"""Cameras that stay as they were calibrated. Nothing here needs torch, which takes seconds to import."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wibam_core.config import RefineConfig
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.documents.refinement import Refinement
from wibam_core.documents.warnings import Caution
from wibam_core.scene import CameraRig, FloatArray


@dataclass(frozen=True, eq=False)
class Refined:
    """The cameras to go on with, what was found, and what a person should know of it."""

    rig: CameraRig
    document: Refinement
    cautions: tuple[Caution, ...] = ()


def known_covariances(rig: CameraRig, residuals: CalibrationResiduals) -> dict[str, FloatArray]:
    """Camera id -> (6, 6) covariance of rotation and position, of the cameras that were solved from enough points."""
    found = {camera_id: residuals.cameras[camera_id].covariance for camera_id in rig if camera_id in residuals.cameras}
    return {camera_id: np.array(matrix)[:6, :6] for camera_id, matrix in found.items() if matrix is not None}


def unchanged(rig: CameraRig, residuals: CalibrationResiduals, config: RefineConfig, reason: str) -> Refined:
    """The cameras as they are, and why."""
    covariances = {camera_id: matrix.tolist() for camera_id, matrix in known_covariances(rig, residuals).items()}
    return Refined(rig, Refinement(method=config.method, taken=False, reason=reason, covariances=covariances))
