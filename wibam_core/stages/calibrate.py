"""What the user said about the cameras, to a rig and its residuals."""

from __future__ import annotations

from wibam_core.artifacts.catalogue import CALIBRATED_RIG, RESIDUALS
from wibam_core.calibration.overlap import overlap_cautions, overlap_of
from wibam_core.calibration.rig import calibrate
from wibam_core.config import CalibrateConfig
from wibam_core.documents.calibration import CalibrationResiduals
from wibam_core.stages.base import StageContext, Summary

_SUMMARISED = {
    "kind", "points", "rejected", "median_px", "max_px", "median_m", "position_sd_m", "ground_sd_m",
}  # fmt: skip


def run(context: StageContext, config: CalibrateConfig) -> Summary:
    """Write `CALIBRATED_RIG` and `RESIDUALS`.

    Raises:
        CalibrationError: naming a camera that cannot be solved.
        NoOverlap: naming a camera that shares no ground with the others.
    """
    rig, residuals = calibrate(context.site, config)
    overlap = overlap_of(rig.mounted)
    document = CalibrationResiduals(
        cameras={camera_id: result.document() for camera_id, result in residuals.items()}, overlap=overlap
    )
    for camera_id, result in residuals.items():
        context.warn(*(caution.of_camera(camera_id) for caution in result.cautions))
    context.warn(*overlap_cautions(overlap))
    context.write(CALIBRATED_RIG, rig)
    context.write(RESIDUALS, document)
    context.progress(1.0)
    return {
        "cameras": {id_: camera.model_dump(include=_SUMMARISED) for id_, camera in document.cameras.items()},
        "shared_m2": {" and ".join(pair.cameras): pair.area_m2 for pair in overlap.pairs},
        "seen_by_m2": overlap.seen_by_m2,
    }
