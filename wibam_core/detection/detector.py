"""Choosing and loading a 2D detector."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wibam_core.detection.centre import CENTRE
from wibam_core.detection.family import Detector, DetectorFamily
from wibam_core.detection.yolox import YOLOX
from wibam_core.errors import InvalidWeights
from wibam_core.models.onnx_session import open_session

#: The detector that comes with the project; learned from simulated images.
BUNDLED = Path(__file__).resolve().parent.parent / "models" / "bundled" / "detector2d.onnx"


#: A file is of the first that it fits.
FAMILIES: tuple[DetectorFamily, ...] = (
    CENTRE,
    YOLOX,
)

_EXPECTED = f"Give an ONNX file of {', or of '.join(family.card.files for family in FAMILIES if family.card.files)}."


def check_detector(path: Path) -> None:
    """Let a detector look at one grey image: many defects show only when a network runs.

    Args:
        path: an ONNX file.

    Raises:
        InvalidWeights: it cannot be loaded (see `load_detector`), or cannot look at an image.
    """
    detector = load_detector(path, min_score=0.5, nms_iou=0.5)
    try:
        detector.detect(np.full((180, 320, 3), 114, np.uint8))
    except Exception as error:  # each kind of defect has its own class in onnxruntime, all directly below Exception
        said = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise InvalidWeights(f"{path.name} cannot look at an image: {said}", hint=_EXPECTED) from error


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
