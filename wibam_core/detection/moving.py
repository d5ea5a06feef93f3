"""What moves before a fixed camera: silhouettes beside its still background, of whatever it is.

No detector is asked, so that what none has learned is found, too. A pixel belongs to a silhouette where its light
differs from the background's by more than usual there, and not only as a shadow does. A shadow takes the same share of
the light from all that lies in it: in the logarithm of light, the difference that it makes has no colour, and edges
only along the shadow's own border, where they are soft, but not at a road marking inside it. So what counts is an edge
of that difference, a colour of it, or more light than the background has. A body is what such pixels enclose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.detection.background import FEWEST_UNCOVERED, StillBackground, outside
from wibam_core.detection.boxes import FloatArray, Image
from wibam_core.geometry.pixels import resized_px, scale_of, shrunk_image

Tones = NDArray[np.int16]

#: Images are looked at this wide: silhouettes need no more, and edges are made sharp by a second look.
_WIDTH_PX = 640
#: Light is counted in steps: so many make a factor of e. So much is added to it before, since dark pixels are noisy.
_STEPS = 256.0
_DARK = 16.0
#: What differs from the background: edges, more light and colour beyond these, in factors of e, and beyond so many
#: standard deviations of what is usual there.
_EDGE, _LIGHT, _COLOUR = 0.10, 0.15, 0.18
_EDGE_SDS, _LIGHT_SDS, _COLOUR_SDS = 4.0, 5.0, 6.0
#: Specks are removed that are narrower than this, and gaps closed that are, px of images `_WIDTH_PX` wide.
_SPECK_PX, _GAP_PX = 2, 7
#: Smaller silhouettes are noise: px² and px.
_LEAST_PX2, _LEAST_SIDE_PX = 30, 5
#: A silhouette fills at least this share of its box: several vehicles in a row do not.
_LEAST_FILLED = 0.4
#: The image, or else the background, has clearly more edges if the difference is this share of both together, along
#: the outline, this many px to both sides of it, and within it. Weaker edges than this, in factors of e, are texture.
_UNCOVERED, _RIM_PX, _TEXTURE = 0.15, 2, 0.06
#: Standard deviation of a normal error in median absolute ones.
_SD_OF_MEDIAN = 1.4826
#: Frames by which it is judged what is usual.
_FRAMES = 16


class _Difference(NamedTuple):
    """Of an image's tones from the background's, (H, W) each: edges of the mean over colours, the most, the spread."""

    edge: Tones
    light: Tones
    colour: Tones


@dataclass(frozen=True, eq=False)
class Stillness:
    """A fixed camera's view without vehicles, and by how much it differs from that as it is.

    Attributes:
        tones: (H, W, 3) logarithm of its light, shrunk.
        least: what each part of a difference must exceed to be more than usual, (H, W) each.
        known: (H, W) uint8: 255 where the background is known, else 0.
        size: width and height of the images that it is of, px.
    """

    tones: Tones
    least: _Difference
    known: Image
    size: tuple[int, int]

    @classmethod
    def of(
        cls,
        background: StillBackground,
        images: Sequence[Image],
        boxes: Sequence[FloatArray] | None = None,
        uncovered: Sequence[Image] | None = None,
    ) -> Stillness:
        """Of a background and images of the same camera.

        Most of the images show it at each place, or most of those do that have no box there: how an image looks where
        somebody stands tells nothing of what is usual.

        Args:
            background: what is still.
            images: (H, W, 3), at least one.
            boxes: of each image, (N, 4) xyxy px: what hides the background there.
            uncovered: of each image, (H, W) uint8 above 0 where it surely shows the background, as for that.
        """
        tones = _tones(background.image)
        scale = scale_of((images[0].shape[1], images[0].shape[0]), (tones.shape[1], tones.shape[0]), 4)
        places = np.linspace(0, len(images) - 1, min(len(images), _FRAMES)).round().astype(int)
        decided = np.zeros(tones.shape[:2], bool)
        shrunk: list[Image] = []
        if uncovered is not None:
            shrunk = [resized_mask(of, (tones.shape[1], tones.shape[0])) for of in uncovered]
            decided = np.sum([of > 0 for of in shrunk], axis=0) >= FEWEST_UNCOVERED
            shown = np.sum([shrunk[k] > 0 for k in places], axis=0)
            for k in np.setdiff1d(np.arange(len(images)), places):  # others that show what too few of these do
                if ((shrunk[k] > 0) & decided & (shown < FEWEST_UNCOVERED)).any():
                    places, shown = np.append(places, k), shown + (shrunk[k] > 0)
        apart = np.stack([np.abs(_tones(images[k]).astype(np.float32) - tones).mean(axis=2) for k in places])
        hidden = np.zeros(apart.shape, bool)
        if boxes is not None:
            hidden = ~np.stack([outside(resized_px(boxes[k], scale), tones.shape[:2]) for k in places])
        if uncovered is not None:
            hidden = np.where(decided, ~np.stack([shrunk[k] > 0 for k in places]), hidden)
        apart[hidden & ~hidden.all(axis=0)] = np.nan  # of what is always hidden all images tell
        sd = (_SD_OF_MEDIAN * np.nanmedian(apart, axis=0)).astype(np.float32)
        limits = ((_EDGE, _EDGE_SDS), (_LIGHT, _LIGHT_SDS), (_COLOUR, _COLOUR_SDS))
        least = _Difference(*(np.maximum(of * _STEPS, sds * sd).astype(np.int16) for of, sds in limits))
        known = np.where(shrunk_image(background.known, _WIDTH_PX) == 255, np.uint8(255), np.uint8(0))
        height, width = background.image.shape[:2]
        return cls(tones, least, known, (width, height))

    def silhouettes(self, image: Image) -> FloatArray:
        """Boxes (N, 4) xyxy around what is not background in an image (H, W, 3), px of the image.

        What touches in the image has one box.
        """
        return self._boxes(self._around(image))

    def told_apart(self, image: Image) -> tuple[FloatArray, Image]:
        """What is not background in an image (H, W, 3), told apart by which of the two shows somebody.

        Whoever covers the ground has an outline, and windows and wheels within it; the ground that is seen where
        somebody stood has none. So where the image has clearly fewer edges than the background, the background shows
        somebody who has left.

        Returns:
            Boxes (N, 4) xyxy, px, around what covers the background in the image, and (h, w) uint8, shrunk as `tones`:
            255 where the image shows ground that the background lacks.
        """
        around = self._around(image)
        here, there = _edges(_tones(image)), _edges(self.tones)
        uncovered = np.zeros(self.known.shape, np.uint8)
        covering = []
        for contour in around:
            left, top, width, height = cv2.boundingRect(contour)
            low = np.maximum([left - _RIM_PX, top - _RIM_PX], 0)
            window = (slice(low[1], top + height + _RIM_PX), slice(low[0], left + width + _RIM_PX))
            rim = np.zeros(here[window].shape, np.uint8)
            cv2.drawContours(rim, [contour - low.astype(np.int32)], -1, 255, 2 * _RIM_PX + 1)
            body = cv2.drawContours(rim.copy(), [contour - low.astype(np.int32)], -1, 255, cv2.FILLED)
            shares = [cv2.mean(here[window], of)[0] - cv2.mean(there[window], of)[0] for of in (rim, body)]
            alls = [cv2.mean(here[window], of)[0] + cv2.mean(there[window], of)[0] for of in (rim, body)]
            if all(share < -_UNCOVERED * of for share, of in zip(shares, alls, strict=True)):
                cv2.drawContours(uncovered, [contour], -1, 255, cv2.FILLED)
            else:
                covering.append(contour)
        return self._boxes(covering), uncovered

    def _boxes(self, around: Sequence[NDArray[np.int32]]) -> FloatArray:
        """(N, 4) xyxy px of the image around contours that are large and full enough."""
        left, top, width, height = np.array([cv2.boundingRect(of) for of in around], np.float64).reshape(-1, 4).T
        # the contour runs through the middles of the outermost pixels
        area = np.array([cv2.contourArea(of) + cv2.arcLength(of, True) / 2 + 1 for of in around])
        sound = (area >= _LEAST_PX2) & (np.minimum(width, height) >= _LEAST_SIDE_PX)
        sound &= area >= _LEAST_FILLED * width * height
        boxes = np.column_stack([left, top, left + width - 1, top + height - 1])[sound]
        order = np.lexsort(boxes.T)
        return np.asarray(resized_px(boxes[order], scale_of(self._shrunk, self.size, 4)))

    def bodies(self, image: Image) -> Image:
        """(h, w) uint8: 255 where something covers the background of an image (H, W, 3), else 0; shrunk as `tones`."""
        covered = np.zeros(self.known.shape, np.uint8)
        cv2.drawContours(covered, self._around(image), -1, 255, cv2.FILLED)
        return covered

    def shrunk_px(self, boxes: FloatArray) -> FloatArray:
        """Boxes (N, 4) xyxy, px of the images, in those of `bodies`."""
        return np.asarray(resized_px(boxes, scale_of(self.size, self._shrunk, 4)))

    @property
    def _shrunk(self) -> tuple[int, int]:
        return self.known.shape[1], self.known.shape[0]

    def _around(self, image: Image) -> Sequence[NDArray[np.int32]]:
        """Outer contours of all that differs from the background, px of the shrunk image."""
        found = _difference(_tones(image), self.tones)
        mask = cv2.compare(found.edge, self.least.edge, cv2.CMP_GT)
        mask |= cv2.compare(found.light, self.least.light, cv2.CMP_GT)
        mask |= cv2.compare(found.colour, self.least.colour, cv2.CMP_GT)
        mask &= self.known
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((_SPECK_PX, _SPECK_PX), np.uint8))
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_GAP_PX, _GAP_PX))
        around, _ = cv2.findContours(
            cv2.morphologyEx(mask, cv2.MORPH_CLOSE, disc), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
        )
        return around


def resized_mask(mask: Image, size: tuple[int, int]) -> Image:
    """A mask (H, W) of an image at another width and height, px."""
    return np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)


def _tones(image: Image) -> Tones:
    """(H, W, 3) logarithm of light in steps, of the shrunk and slightly blurred image."""
    table = np.rint(_STEPS * np.log(np.arange(256) + _DARK)).astype(np.int16)
    return np.asarray(cv2.LUT(cv2.GaussianBlur(shrunk_image(image, _WIDTH_PX), (3, 3), 0), table))


def _difference(tones: Tones, still: Tones) -> _Difference:
    blue, green, red = cv2.split(cv2.subtract(tones, still))
    most = cv2.max(cv2.max(blue, green), red)
    colour = cv2.subtract(most, cv2.min(cv2.min(blue, green), red))
    return _Difference(_slope(blue, green, red), most, colour)


def _slope(blue: Tones, green: Tones, red: Tones) -> Tones:
    """(H, W) by how much the mean of the colours changes from one pixel to the next, across and down added."""
    mean = cv2.addWeighted(cv2.addWeighted(blue, 0.5, green, 0.5, 0.0), 2 / 3, red, 1 / 3, 0.0)
    x, y = (cv2.Sobel(mean, cv2.CV_16S, *along, ksize=3, scale=0.25) for along in ((1, 0), (0, 1)))
    return np.asarray(cv2.add(cv2.absdiff(x, np.zeros_like(x)), cv2.absdiff(y, np.zeros_like(y))))


def _edges(tones: Tones) -> Tones:
    """(H, W) edges of tones (H, W, 3), 0 where they are texture."""
    return np.asarray(cv2.subtract(cv2.max(_slope(*cv2.split(tones)), _TEXTURE * _STEPS), _TEXTURE * _STEPS))
