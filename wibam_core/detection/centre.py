"""The bundled detector: peaks of a centre heat map, and from each the distances to the four sides of its box."""

from __future__ import annotations

import numpy as np
import onnxruntime

from wibam_core.detection.boxes import Found, Image, select
from wibam_core.detection.family import DetectorCard, DetectorFamily
from wibam_core.detection.metadata import network_classes
from wibam_core.errors import InvalidWeights
from wibam_core.geometry.pixels import resized_height_px, resized_image, resized_px, scale_of

#: What the file's metadata calls this kind of network.
FAMILY = "wibam-centre"
CARD = DetectorCard(
    name=FAMILY,
    input_name="image",
    input_type="tensor(float)",
    channels="BGR",
    highest=1.0,
    outputs=("heat", "ltrb"),
    decode="peaks of a heat map, and from each the distances to the four sides of its box",
    class_names="metadata",
)
INPUT_WIDTH_PX = 640
STRIDE = 4
_HEIGHT_MULTIPLE = 32


def is_centre_model(session: onnxruntime.InferenceSession) -> bool:
    """Whether the file says that it holds a network of this kind."""
    return session.get_modelmeta().custom_metadata_map.get("family") == FAMILY


class CentreDetector:
    """Runs the bundled network.

    Images are 640 px wide, padded at the bottom to a multiple of 32. The outputs are ``heat`` (1, C, H/4, 160), zero
    but at peaks, and ``ltrb`` (1, 4, H/4, 160) in cells of 4 px. The centre of cell (x, y) is
    ((x + 0.5)·4 − 0.5, (y + 0.5)·4 − 0.5) px of the input.

    Args:
        session: for which `is_centre_model` holds.
        min_score: heat of a peak that is kept.
        nms_iou: of two boxes that overlap more, the weaker is left out.

    Raises:
        InvalidWeights: the network lacks these outputs, or does not name its classes, or one that we do not know.
    """

    def __init__(self, session: onnxruntime.InferenceSession, *, min_score: float, nms_iou: float) -> None:
        if missing := CARD.missing(session):
            raise InvalidWeights(
                f"the {FAMILY} detector has no {', '.join(missing)}", hint="Use the detector as it was exported."
            )
        self._session = session
        self.classes = network_classes(session, f"the {FAMILY} detector")
        self._numbers = np.array([c.number for c in self.classes], dtype=np.int64)
        self._min_score, self._nms_iou = min_score, nms_iou

    def detect(self, image_bgr: Image) -> Found:
        """Vehicles in an image (H, W, 3) uint8, BGR, in its own pixels.

        Raises:
            InvalidWeights: the network has heat for more or fewer classes than it names.
        """
        height, width = image_bgr.shape[:2]
        content = resized_height_px(width, height, INPUT_WIDTH_PX)
        image = resized_image(image_bgr, INPUT_WIDTH_PX, content)
        heat, ltrb = CARD.run(self._session, np.pad(image, ((0, -content % _HEIGHT_MULTIPLE), (0, 0), (0, 0))))
        if len(heat[0]) != len(self.classes):
            raise InvalidWeights(
                f"the {FAMILY} detector names {len(self.classes)} classes and has heat for {len(heat[0])}",
                hint="Use the detector as it was exported.",
            )
        numbers, rows, columns = np.nonzero(heat[0] >= self._min_score)
        scores = heat[0, numbers, rows, columns].astype(np.float64)
        sides = STRIDE * ltrb[0, :, rows, columns].astype(np.float64).reshape(-1, 4)
        centres = resized_px(np.stack([columns, rows], axis=1), STRIDE)
        boxes = np.concatenate([centres - sides[:, :2], centres + sides[:, 2:]], axis=1)
        native = resized_px(boxes, scale_of((INPUT_WIDTH_PX, content), (width, height), 4))
        return select(native, scores, self._numbers[numbers], (width, height), self._nms_iou)


CENTRE = DetectorFamily(CARD, is_centre_model, CentreDetector)
