"""Choosing and loading a 2D detector."""

from __future__ import annotations

from pathlib import Path

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
