"""What a family of 2D detectors is: a card that says what it takes and gives, and what runs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from wibam_core.detection.boxes import Found, Image
from wibam_core.detection.planes import shares_of
from wibam_core.road_users import RoadUserClass


@dataclass(frozen=True)
class DetectorCard:
    """A family's networks. All take one image at a time, (1, 3, H, W).

    Attributes:
        name: e.g. "YOLOX".
        input_name: of the image; None where that differs from file to file, and it is the only input.
        input_type: as ONNX Runtime names it.
        channels: the order of colours.
        highest: what the brightest value of an image becomes; the darkest is 0.
        outputs: their names; None where they differ from file to file, and there is one alone.
        decode: how outputs become boxes, in a phrase.
        class_names: whose names the classes have: COCO's, in the order of its numbers, or those in the file's metadata.
        files: for a person whose file is of no family: what files of this one are; None where nobody brings one along.
    """

    name: str
    input_name: str | None
    input_type: str
    channels: Literal["BGR", "RGB"]
    highest: float
    outputs: tuple[str, ...] | None
    decode: str
    class_names: Literal["coco", "metadata"]
    files: str | None = None

    def missing(self, session: onnxruntime.InferenceSession) -> list[str]:
        """What a network lacks to be of this family, as far as names and types go; sorted."""
        inputs, outputs = session.get_inputs(), session.get_outputs()
        wanted = {(self.input_name or inputs[0].name, self.input_type)} if inputs else {("an input", self.input_type)}
        lacking = {name for name, _ in wanted - {(node.name, node.type) for node in inputs}}
        lacking |= set(self.outputs or ()) - {node.name for node in outputs}
        if self.input_name is None and len(inputs) != 1:
            lacking.add("one input alone")
        if self.outputs is None and len(outputs) != 1:
            lacking.add("one output alone")
        return sorted(lacking)

    def run(self, session: onnxruntime.InferenceSession, image_bgr: Image) -> list[NDArray[np.float32]]:
        """The outputs, in the card's order, of an image (H, W, 3) uint8, BGR, of the network's own size."""
        planes = cv2.split(image_bgr)
        ordered = planes if self.channels == "BGR" else planes[::-1]
        values = shares_of(ordered, self.highest)[None]
        name = self.input_name or session.get_inputs()[0].name
        wanted = None if self.outputs is None else list(self.outputs)
        return list(session.run(wanted, {name: values}))


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
        card: what they take and give.
        is_model: whether a file holds one, by its metadata and the shapes of its inputs and outputs.
        detector: what runs it: of the session, ``min_score`` and ``nms_iou``.
    """

    card: DetectorCard
    is_model: Callable[[onnxruntime.InferenceSession], bool]
    detector: Callable[..., Detector]
