"""Detectors of the YOLOX family (Ge et al. 2021, arXiv 2107.08430) trained on COCO's 80 classes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from wibam_core.detection.boxes import FloatArray, Found, Image, IntArray, select
from wibam_core.detection.family import DetectorCard, DetectorFamily
from wibam_core.detection.riders import road_users
from wibam_core.road_users import CLASSES, RoadUserClass

CARD = DetectorCard(
    name="YOLOX",
    input_name=None,
    input_type="tensor(float)",
    channels="BGR",
    highest=255.0,
    outputs=None,
    decode="a row a cell: offset and logarithm of the size in cells, objectness, probabilities",
    class_names="coco",
    files="the YOLOX family trained on COCO: one image input (1, 3, H, W) and one output (1, cells, 85) that is not "
    "decoded, with a cell per 8, 16 and 32 px",
)
STRIDES = (8, 16, 32)
#: What moves, by COCO's index: the first of its 80 names.
_COCO_NAMES = ("person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat")
#: Aeroplanes and boats do not drive on roads: seen from above, a vehicle is often taken for one. They count as
#: vehicles, of whichever of our classes comes next.
_TAKEN_FOR = ("airplane", "boat")


@dataclass(frozen=True, eq=False)
class _Kind:
    """Classes that are told apart only once something is found to be one of them.

    Attributes:
        counted: COCO's indices of all that count as one. known: those that are a class of ours.
        classes: our class of each of the latter.
    """

    counted: IntArray
    known: IntArray
    classes: IntArray

    @classmethod
    def of(cls, road_users: Iterable[RoadUserClass], taken_for: Iterable[str] = ()) -> _Kind:
        """Those of our classes that COCO knows. It has no vans: they come as cars or trucks."""
        known = sorted((_COCO_NAMES.index(name), c.number) for c in road_users for name in c.traits.elsewhere.coco.read)
        indices, classes = np.array(known, dtype=np.int64).T
        others = np.array([_COCO_NAMES.index(name) for name in taken_for], dtype=np.int64)
        return cls(np.concatenate([indices, others]), indices, classes)


_RIDDEN = (RoadUserClass.BICYCLE, RoadUserClass.MOTORCYCLE)
_VEHICLES = _Kind.of((c for c in CLASSES if not c.traits.vulnerable), _TAKEN_FOR)
_TWO_WHEELERS = _Kind.of(_RIDDEN)
_PERSONS = _Kind.of((RoadUserClass.PEDESTRIAN,))
_COCO_CLASSES = 80
_PADDING = 114
#: Largest exponent of a side: e^12 px is wider than any image, and nothing overflows.
_MAX_LOG_SIDE = 12.0


def is_yolox_model(session: onnxruntime.InferenceSession) -> bool:
    """Whether a network has the inputs and the output of this family, at a fixed size."""
    if CARD.missing(session):
        return False
    shape, out = session.get_inputs()[0].shape, session.get_outputs()[0].shape
    if len(shape) != 4 or shape[1] != 3 or not all(isinstance(n, int) and n > 0 and n % 32 == 0 for n in shape[2:]):
        return False
    return len(out) == 3 and out[1:] == [len(_grid(shape[3], shape[2])[0]), 5 + _COCO_CLASSES]


class YoloxDetector:
    """Runs a YOLOX network on letterboxed images.

    Args:
        session: for which `is_yolox_model` holds.
        min_score: objectness times the probability of being any of a kind, of a box that is kept.
        nms_iou: of two boxes that overlap more, the weaker is left out.
    """

    #: What it looks for.
    classes = tuple(CLASSES[number] for kind in (_VEHICLES, _TWO_WHEELERS, _PERSONS) for number in kind.classes)

    def __init__(self, session: onnxruntime.InferenceSession, *, min_score: float, nms_iou: float) -> None:
        self._session = session
        self._height, self._width = session.get_inputs()[0].shape[2:]
        self._cells, self._strides = _grid(self._width, self._height)
        self._min_score, self._nms_iou = min_score, nms_iou

    def detect(self, image_bgr: Image) -> Found:
        """Road users in an image (H, W, 3) uint8, BGR, in its own pixels."""
        height, width = image_bgr.shape[:2]
        (output,) = CARD.run(self._session, letterbox(image_bgr, self._width, self._height))
        raw = output[0].astype(np.float64)
        vehicles, two_wheelers, persons = (
            self._found(kind, raw, (width, height)) for kind in (_VEHICLES, _TWO_WHEELERS, _PERSONS)
        )
        return road_users(vehicles, two_wheelers, persons, self._nms_iou)

    def _found(self, kind: _Kind, raw: FloatArray, size: tuple[int, int]) -> Found:
        """What of a kind the output says is in an image of ``size`` px."""
        probabilities = np.clip(raw[:, 5:], 0.0, 1.0)
        # classes are independent sigmoids: of the kind is what is at least one of its classes
        score = np.clip(raw[:, 4], 0.0, 1.0) * (1.0 - (1.0 - probabilities[:, kind.counted]).prod(axis=1))
        classes = kind.classes[probabilities[:, kind.known].argmax(axis=1)]
        good = np.flatnonzero(score >= self._min_score)
        boxes = self._decode(raw, good) / min(self._width / size[0], self._height / size[1])
        # COCO's pixels begin where ours have their half: its (0, 0) is the corner of the first pixel
        return select(boxes - 0.5, score[good], classes[good], size, self._nms_iou)

    def _decode(self, raw: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
        """Boxes xyxy (N, 4) of some rows of the output, px of the network's input."""
        strides = self._strides[rows, None]
        centres = (raw[rows, :2] + self._cells[rows]) * strides
        halves = np.exp(np.minimum(raw[rows, 2:4], _MAX_LOG_SIDE)) * strides / 2
        return np.concatenate([centres - halves, centres + halves], axis=1)


YOLOX = DetectorFamily(CARD, is_yolox_model, YoloxDetector)


def letterbox(image: Image, width_px: int, height_px: int) -> Image:
    """Resize an image (H, W, 3) into the top left corner of a grey one, its aspect ratio kept."""
    scale = min(width_px / image.shape[1], height_px / image.shape[0])
    width, height = max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1)
    canvas = np.full((height_px, width_px, 3), _PADDING, dtype=np.uint8)
    canvas[:height, :width] = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    return canvas


def _grid(width_px: int, height_px: int) -> tuple[FloatArray, FloatArray]:
    """x and y of every cell (N, 2) and its stride (N,), in the order of the output: row by row, finest level first."""
    cells, strides = [], []
    for stride in STRIDES:
        rows, columns = np.mgrid[: height_px // stride, : width_px // stride]
        cells.append(np.stack([columns.ravel(), rows.ravel()], axis=1))
        strides.append(np.full(rows.size, stride))
    return np.concatenate(cells).astype(np.float64), np.concatenate(strides).astype(np.float64)
