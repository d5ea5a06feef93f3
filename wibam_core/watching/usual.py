"""Gathering what is usual of a site's cameras: `wibam_core.formats.usual`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.formats.usual import STILL_WIDTH_PX, Found, Gray, Usual
from wibam_core.geometry.pixels import resized_height_px, resized_image

#: A still picture is the median of at most so many, at least so far apart: what drives by shows in few of them.
_MOST_PICTURES, _LEAST_APART_S = 32, 1.5


class Noticed:
    """Gathers what is usual over a stretch of time, picture by picture. Pictures of one camera come in order of time.

    Args:
        duration_s: about how long the stretch is: the pictures that make a still one are spread over it.
    """

    def __init__(self, duration_s: float) -> None:
        self._apart_ns = round(max(_LEAST_APART_S, duration_s / _MOST_PICTURES) * 1e9)
        self._pictures: dict[str, list[Gray]] = {}
        self._last_ns: dict[str, int] = {}
        self._scores: dict[str, list[float]] = {}

    def wants(self, camera_id: str, time_ns: int) -> bool:
        """Whether a picture of this time would be used; most are passed over."""
        last_ns = self._last_ns.get(camera_id)
        enough = len(self._pictures.get(camera_id, ())) >= _MOST_PICTURES
        return not enough and (last_ns is None or time_ns - last_ns >= self._apart_ns)

    def see(self, camera_id: str, time_ns: int, image_bgr: NDArray[np.uint8]) -> None:
        """Take in a picture (H, W, 3), if it is wanted."""
        if self.wants(camera_id, time_ns):
            self._last_ns[camera_id] = time_ns
            self._pictures.setdefault(camera_id, []).append(still_picture(image_bgr))

    def find(self, camera_id: str, scores: NDArray[np.float64]) -> None:
        """Take in the scores (N,) of what was found in one picture."""
        counts = self._scores.setdefault(camera_id, [0.0, 0.0, 0.0])
        for place, value in enumerate((1.0, float(len(scores)), float(scores.sum()))):
            counts[place] += value

    def usual(self) -> Usual:
        """What was usual; a camera with fewer than three pictures has no still one."""
        stills = {
            camera_id: np.median(np.stack(pictures), axis=0).astype(np.uint8)
            for camera_id, pictures in self._pictures.items()
            if len(pictures) > 2
        }
        found = {
            camera_id: Found(int(images), int(boxes), total / boxes if boxes else float("nan"))
            for camera_id, (images, boxes, total) in self._scores.items()
        }
        return Usual(stills, found)


def still_picture(image_bgr: NDArray[np.uint8]) -> Gray:
    """A picture (H, W, 3) as still ones are: gray, `STILL_WIDTH_PX` wide."""
    height, width = image_bgr.shape[:2]
    small = resized_image(image_bgr, STILL_WIDTH_PX, resized_height_px(width, height, STILL_WIDTH_PX))
    weights = np.array([0.114, 0.587, 0.299], np.float32)
    gray: Gray = np.clip(np.rint(small.astype(np.float32) @ weights), 0, 255).astype(np.uint8)
    return gray
