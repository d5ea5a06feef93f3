"""The calibration files of the TUMTraf (A9) data sets: lens and pose of one camera."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from wibam_core.calibration.foreign.base import FoundCamera, Intrinsics, Reader, json_object, matrix, vector

_NEEDED = {"intrinsic_camera_matrix", "rotation_matrix", "translation_matrix"}


def _recognises(name: str, text: str) -> bool:
    content = json_object(text) if name.endswith(".json") else None
    return content is not None and content.keys() >= _NEEDED


def _read(text: str) -> Sequence[FoundCamera]:
    content = json_object(text)
    assert content is not None
    K = matrix(content["intrinsic_camera_matrix"], 3, 3, "intrinsic_camera_matrix")
    width, height = content.get("image_width"), content.get("image_height")
    rotation = matrix(content["rotation_matrix"], 3, 3, "rotation_matrix")
    intrinsics = Intrinsics(
        K,
        vector(content.get("dist_coefficients"), "dist_coefficients"),
        size_px=None if width is None or height is None else (int(width), int(height)),
    )
    tvec = matrix(content["translation_matrix"], 3, 1, "translation_matrix").ravel()
    note = (
        "The distortion is that of the camera: leave dist out of site.json for pictures that are undistorted already."
    )
    rvec = np.asarray(cv2.Rodrigues(rotation)[0], dtype=np.float64).ravel()
    return [FoundCamera("", intrinsics, rvec, tvec, notes=(note,))]


TUMTRAF = Reader("TUMTraf calibration", _recognises, _read)
