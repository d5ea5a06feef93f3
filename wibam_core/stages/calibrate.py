"""Stage ``calibrate``: what the user said about the cameras, to a rig and its residuals."""

from __future__ import annotations

import json

from wibam_core.calibration.rig import calibrate
from wibam_core.config import CalibrateConfig
from wibam_core.formats.rig import write_rig
from wibam_core.stages.base import StageContext, Summary


def run(context: StageContext, config: CalibrateConfig) -> Summary:
    """Write ``rig.json`` and ``residuals.json`` (camera id -> `wibam_core.calibration.residuals.Residuals.document`).

    Raises:
        CalibrationError: naming a camera that cannot be solved.
        NoOverlap: naming a camera that shares no ground with the others.
    """
    rig, residuals = calibrate(context.site, config)
    documents = {camera_id: result.document() for camera_id, result in residuals.items()}
    write_rig(context.output / "rig.json", rig)
    (context.output / "residuals.json").write_text(json.dumps(documents, indent=1), encoding="utf-8")
    context.progress(1.0)
    keys = ("kind", "points", "rejected", "median_px", "max_px", "median_m")
    return {"cameras": {camera_id: {key: document[key] for key in keys} for camera_id, document in documents.items()}}
