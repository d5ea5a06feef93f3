"""Boxes with sharper edges: each is looked at again against the camera's still background."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime

from wibam_core.detection.background import StillBackground
from wibam_core.detection.boxes import FloatArray, Found, Image
from wibam_core.detection.crops import blob

#: The refiner that comes with the project; learned from simulated images.
BUNDLED_REFINER = Path(__file__).resolve().parent.parent / "models" / "bundled" / "refiner2d.onnx"

#: An edge is moved by at most this share of its box's side; a refiner that wants more has not understood the crop.
_MOST_MOVED = 0.3
_PASSES = 2


class EdgeRefiner:
    """Runs the bundled refiner (`wibam_core.models.refiner2d`) on one thread."""

    def __init__(self, path: Path = BUNDLED_REFINER) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

    def refine(self, image_bgr: Image, background: StillBackground, found: Found) -> Found:
        """The same boxes in the same order, with better edges and classes.

        Args:
            image_bgr: (H, W, 3) uint8.
            background: of the same camera and size.
            found: in px of the image.
        """
        if not len(found.boxes):
            return found
        limits = np.array([image_bgr.shape[1], image_bgr.shape[0]] * 2) - 0.5
        boxes, classes = found.boxes, found.classes
        for _ in range(_PASSES):
            crops, windows = blob(image_bgr, background.image, background.known, boxes)
            edges, logits = self._session.run(["edges", "classes"], {"image": crops})
            seen = np.stack([w.to_px(e) for w, e in zip(windows, edges.astype(np.float64), strict=True)])
            boxes = _moved(boxes, np.clip(seen, -0.5, limits))
            classes = logits.argmax(axis=1).astype(np.int64)
        return Found(boxes, found.scores, classes)


def _moved(boxes: FloatArray, wanted: FloatArray) -> FloatArray:
    sides = np.tile(boxes[:, 2:] - boxes[:, :2], (1, 2))
    moved = boxes + np.clip(wanted - boxes, -_MOST_MOVED * sides, _MOST_MOVED * sides)
    sound = np.asarray(((moved[:, 2:] - moved[:, :2]) >= 1.0).all(axis=1))
    return np.where(sound[:, None], moved, boxes)
