"""Choosing and loading a 2D detector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import onnxruntime

from wibam_core.detection.boxes import Found, Image
from wibam_core.detection.centre import CentreDetector, is_centre_model
from wibam_core.detection.yolox import YOLOX_FILES, YoloxDetector, is_yolox_model
from wibam_core.errors import InvalidWeights
from wibam_core.models.onnx_session import open_session
from wibam_core.road_users import RoadUserClass

#: The detector that comes with the project; learned from simulated images.
BUNDLED = Path(__file__).resolve().parent.parent / "models" / "bundled" / "detector2d.onnx"


class Detector(Protocol):
    """Finds road users in an image."""

    @property
    def classes(self) -> tuple[RoadUserClass, ...]:
        """What it looks for; other road users are not found, or taken for one of these."""
        ...

    def detect(self, image_bgr: Image) -> Found:
        """Road users in an image (H, W, 3) uint8, BGR, in its own pixels."""


@dataclass(frozen=True)
class DetectorFamily:
    """ONNX networks that are run alike.

    Attributes:
        is_model: whether a file holds one, by its metadata and the shapes of its inputs and outputs.
        detector: what runs it: of the session, ``min_score`` and ``nms_iou``.
        files: for a person whose file is of no family: what files of this one are; None where nobody brings one along.
    """

    is_model: Callable[[onnxruntime.InferenceSession], bool]
    detector: Callable[..., Detector]
    files: str | None = None


FAMILIES: tuple[DetectorFamily, ...] = (
    DetectorFamily(is_centre_model, CentreDetector),
    DetectorFamily(is_yolox_model, YoloxDetector, YOLOX_FILES),
)

_EXPECTED = f"Give an ONNX file of {', or of '.join(family.files for family in FAMILIES if family.files)}."


def load_detector(path: Path, *, min_score: float, nms_iou: float, threads: int = 1) -> Detector:
    """Load a detector of whichever family the file is of.

    Args:
        path: an ONNX file.
        min_score: weaker boxes are left out.
        nms_iou: of two boxes that overlap more, the weaker is left out.
        threads: CPU threads within one image.

    Raises:
        InvalidWeights: the file is missing, no ONNX file, or a network of another kind.
    """
    session = open_session(path, path.name, threads=threads, hint=_EXPECTED)
    for family in FAMILIES:
        if family.is_model(session):
            return family.detector(session, min_score=min_score, nms_iou=nms_iou)
    inputs = ", ".join(f"{node.name} {node.shape}" for node in session.get_inputs())
    outputs = ", ".join(f"{node.name} {node.shape}" for node in session.get_outputs())
    raise InvalidWeights(
        f"{path.name} takes {inputs} and gives {outputs}: that is no detector that we know", hint=_EXPECTED
    )
