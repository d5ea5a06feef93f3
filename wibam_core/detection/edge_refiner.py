"""Boxes with sharper edges: each is looked at again against the camera's still background."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wibam_core.detection.background import StillBackground
from wibam_core.detection.boxes import FloatArray, Found, Image, IntArray
from wibam_core.detection.crops import blob
from wibam_core.detection.metadata import network_classes
from wibam_core.geometry.boxes2d import clipped_to_image, non_maximum_suppression, sides_px
from wibam_core.models.onnx_session import open_session
from wibam_core.scene import Boxes2D

#: The refiner that comes with the project; learned from simulated images.
BUNDLED_EDGE_REFINER = Path(__file__).resolve().parent.parent / "models" / "bundled" / "edge_refiner.onnx"

#: An edge is moved by at most this share of its box's side in all; a refiner that wants more has not understood it.
_MOST_MOVED = 0.3
_PASSES = 2
_OUTPUTS = ("edges", "reach", "log_scale", "classes")
_OUTWARD = np.array([-1.0, -1.0, 1.0, 1.0])
#: Standard deviation of a normal error in mean absolute ones.
_SD_OF_ABSOLUTE_ERROR = 1.25


class EdgeRefiner:
    """Runs the bundled refiner (`wibam_core.models.edge_refiner`) on one thread.

    Attributes:
        classes: what it has learned the edges of. Boxes of other classes stay as they are.
    """

    def __init__(self, path: Path = BUNDLED_EDGE_REFINER) -> None:
        self._session = open_session(path, path.name, threads=1, hint="Use the edge refiner as it was exported.")
        self.classes = network_classes(self._session, "the edge refiner")
        self._numbers = np.array([c.number for c in self.classes], dtype=np.int64)

    def refine(
        self,
        image_bgr: Image,
        background: StillBackground,
        found: Found,
        *,
        nms_iou: float,
        classify: bool,
        passes: int = _PASSES,
    ) -> Boxes2D:
        """The boxes with better edges, and amodal ones, in the order given; what turns out to be found twice goes.

        Boxes of classes that the refiner does not know stay as they are, without amodal ones.

        Args:
            image_bgr: (H, W, 3) uint8.
            background: of the same camera and size.
            found: in px of the image.
            nms_iou: of two boxes that overlap more, the weaker is left out.
            classify: give the boxes the refiner's classes, too.
            passes: how often each box is looked at, where the last look left it. Boxes that are near need one.
        """
        boxes, classes = found.boxes.copy(), found.classes.copy()
        amodal, sd = np.full((2, len(boxes), 4), np.nan)
        known = np.isin(classes, self._numbers)
        rows = np.flatnonzero(known)
        if len(rows):
            boxes[rows], amodal[rows], sd[rows], alike = self._looked_at(image_bgr, background, boxes[rows], passes)
            if classify:
                classes[rows] = alike
        twice = np.setdiff1d(rows, rows[non_maximum_suppression(boxes[rows], found.scores[rows], nms_iou)])
        kept = np.delete(np.arange(len(boxes)), twice)
        return Boxes2D(boxes[kept], found.scores[kept], classes[kept], amodal[kept], sd[kept])

    def _looked_at(
        self, image_bgr: Image, background: StillBackground, found: FloatArray, passes: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Sharper boxes (N, 4), amodal ones (N, 4) and their standard deviations, px, and the classes (N,) that they
        look like, of N > 0 boxes found (N, 4)."""
        height, width = image_bgr.shape[:2]
        boxes = found
        for _ in range(passes):
            crops, windows = blob(image_bgr, background.layers, boxes)
            edges, reach, log_scale, logits = (
                values.astype(np.float64) for values in self._session.run(_OUTPUTS, {"image": crops})
            )
            seen = np.stack([w.to_px(e) for w, e in zip(windows, edges, strict=True)])
            boxes = _moved(found, clipped_to_image(seen, width, height))
        sides = np.tile(np.array([window.size for window in windows], dtype=np.float64), (1, 2))
        amodal = clipped_to_image(boxes + _OUTWARD * reach * sides, width, height)
        sd = _SD_OF_ABSOLUTE_ERROR * np.exp(log_scale) * sides
        return boxes, amodal, sd, self._numbers[logits.argmax(axis=1)]


def _moved(boxes: FloatArray, wanted: FloatArray) -> FloatArray:
    """Boxes (N, 4) with their edges where they are wanted, or as far towards that as they may be moved."""
    most = _MOST_MOVED * np.tile(sides_px(boxes), (1, 2))
    moved = np.clip(wanted, boxes - most, boxes + most)
    sound = np.asarray((sides_px(moved) >= 1.0).all(axis=1))
    return np.where(sound[:, None], moved, boxes)
