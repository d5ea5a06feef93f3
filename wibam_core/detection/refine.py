"""Boxes with sharper edges: each is looked at again against the camera's still background."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime

from wibam_core.detection.background import StillBackground
from wibam_core.detection.boxes import FloatArray, Found, Image, non_maximum_suppression
from wibam_core.detection.crops import blob

#: The refiner that comes with the project; learned from simulated images.
BUNDLED_REFINER = Path(__file__).resolve().parent.parent / "models" / "bundled" / "refiner2d.onnx"

#: An edge is moved by at most this share of its box's side in all; a refiner that wants more has not understood it.
_MOST_MOVED = 0.3
_PASSES = 2


class EdgeRefiner:
    """Runs the bundled refiner (`wibam_core.models.refiner2d`) on one thread."""

    def __init__(self, path: Path = BUNDLED_REFINER) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

    def refine(
        self, image_bgr: Image, background: StillBackground, found: Found, *, nms_iou: float, classify: bool
    ) -> Found:
        """The boxes with better edges, in the order in which they were given; what turns out to be found twice goes.

        Args:
            image_bgr: (H, W, 3) uint8.
            background: of the same camera and size.
            found: in px of the image.
            nms_iou: of two boxes that overlap more, the weaker is left out.
            classify: give the boxes the refiner's classes, too.
        """
        if not len(found.boxes):
            return found
        limits = np.array([image_bgr.shape[1], image_bgr.shape[0]] * 2) - 0.5
        boxes, classes = found.boxes, found.classes
        for _ in range(_PASSES):
            crops, windows = blob(image_bgr, background.image, background.known, boxes)
            edges, logits = self._session.run(["edges", "classes"], {"image": crops})
            seen = np.stack([w.to_px(e) for w, e in zip(windows, edges.astype(np.float64), strict=True)])
            boxes = _moved(found.boxes, np.clip(seen, -0.5, limits))
            if classify:
                classes = logits.argmax(axis=1).astype(np.int64)
        kept = np.sort(non_maximum_suppression(boxes, found.scores, nms_iou))
        return Found(boxes[kept], found.scores[kept], classes[kept])


def _moved(boxes: FloatArray, wanted: FloatArray) -> FloatArray:
    """Boxes (N, 4) with their edges where they are wanted, or as far towards that as they may be moved."""
    most = _MOST_MOVED * np.tile(boxes[:, 2:] - boxes[:, :2], (1, 2))
    moved = np.clip(wanted, boxes - most, boxes + most)
    sound = np.asarray(((moved[:, 2:] - moved[:, :2]) >= 1.0).all(axis=1))
    return np.where(sound[:, None], moved, boxes)
