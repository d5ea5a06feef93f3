"""One labelled image, as training sees it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.camera import Camera
from wibam_core.road_users import RoadUserClass

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LabelledView:
    """An image with what is known about the N vehicles in it.

    Attributes:
        image: (H, W, 3) uint8, BGR.
        camera: of the image's size, but for rows of padding at the bottom of the image.
        boxes2d: (N, 4) xyxy, px of ``image``: the visible part of each vehicle.
        classes: (N,) indices into `wibam_core.road_users.CLASSES`.
        boxes3d: (N, 7) in the world; NaN where unknown: such a vehicle teaches the heat and its 2D box alone.
        confidence: (N,) weight in [0, 1] of the 3D box: a pseudo-label, that is a fit, or a true one in simulation.
        front_known: (N,) whether the 3D box tells front from rear; where not, either heading is right.
        ignored: (M, 4) xyxy, px: regions in which the heat is not judged.
        not_looked_for: the road users that nothing here says anything about: their heat is judged nowhere.
        whole_width_px: how wide the image is of which ``image`` is a window; None: it is whole.
    """

    image: NDArray[np.uint8]
    camera: Camera
    boxes2d: FloatArray
    classes: NDArray[np.int64]
    boxes3d: FloatArray
    confidence: FloatArray
    front_known: NDArray[np.bool_]
    ignored: FloatArray
    not_looked_for: frozenset[RoadUserClass] = frozenset()
    whole_width_px: int | None = None

    def __post_init__(self) -> None:
        n = len(self.classes)
        shapes = {
            "boxes2d": (n, 4),
            "boxes3d": (n, 7),
            "confidence": (n,),
            "front_known": (n,),
            "ignored": (len(self.ignored), 4),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} must have shape {shape}, got {np.shape(getattr(self, name))}")

    def where(self, rows: NDArray[np.int64]) -> LabelledView:
        """The view with these (K,) of its vehicles alone; the image still shows the others."""
        return replace(
            self,
            boxes2d=self.boxes2d[rows],
            classes=self.classes[rows],
            boxes3d=self.boxes3d[rows],
            confidence=self.confidence[rows],
            front_known=self.front_known[rows],
        )
