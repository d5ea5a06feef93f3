"""Cameras that stay as they were calibrated. Nothing here needs torch, which takes seconds to import."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wibam_core.config import RefineConfig
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.documents.refinement import Refinement
from wibam_core.refinement.mounts import of_what_is_seen
from wibam_core.scene import CameraRig, FloatArray


@dataclass(frozen=True, eq=False)
class Refined:
    """The cameras to go on with, and what was found."""

    rig: CameraRig
    document: Refinement

    @property
    def covariances(self) -> dict[str, FloatArray]:
        """Covariances as of `of_what_is_seen`, where anything is known of them."""
        return {name: np.array(matrix) for name, matrix in self.document.covariances.items()}


def known_covariances(rig: CameraRig, residuals: CalibrationResiduals) -> dict[str, FloatArray]:
    """Covariances as of `of_what_is_seen`, of the cameras that were solved from enough points."""
    found = {name: residuals.cameras[name].covariance for name in rig.mounted if name in residuals.cameras}
    return of_what_is_seen(rig, {name: np.array(matrix) for name, matrix in found.items() if matrix is not None})


def unchanged(rig: CameraRig, residuals: CalibrationResiduals, config: RefineConfig, reason: str) -> Refined:
    """The cameras as they are, and why."""
    covariances = {camera_id: matrix.tolist() for camera_id, matrix in known_covariances(rig, residuals).items()}
    return Refined(rig, Refinement(method=config.method, taken=False, reason=reason, covariances=covariances))
