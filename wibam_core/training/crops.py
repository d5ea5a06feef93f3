"""Windows of images to learn from: most of what a fixed camera sees never shows a road user, and costs as much.

With a share of 1, each window is the whole image. The network is convolutional: what it says about a road user depends
on the pixels around it alone, and a window is what a camera with another principal point takes. Of a few windows, each
at random around a road user of the view, its anchor, the one that teaches most is taken; some windows lie anywhere, so
that the whole background is learned, too. Whoever a window cuts is neither taught nor judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.boxes2d import areas_px2, clipped_to_image, sides_px
from wibam_core.geometry.camera import Camera
from wibam_core.models.trunk import INPUT_MULTIPLE
from wibam_core.training.views import FloatArray, LabelledView

#: Windows are at least so wide and high where the image is: what is smaller leaves a trunk one cell to normalise over.
_LEAST_PX = 2 * INPUT_MULTIPLE
#: This share of the windows lies anywhere in the image, whatever is there.
_ANYWHERE_SHARE = 0.1
#: So many windows are tried, each around an anchor.
_TRIES = 3
#: What a vehicle in a window counts beside the confidence of its 3D box: it teaches its 2D box in any case.
_WORTH_WITHOUT_BOX = 0.3
#: A vehicle is whole in a window that holds this share of what the image holds of its 2D box.
_WHOLE_SHARE = 0.999


@dataclass(frozen=True)
class Window:
    """A part of an image, px: its first column and row, its width and height."""

    left_px: int
    top_px: int
    width_px: int
    height_px: int


def windows(views: Sequence[LabelledView], share: float, rng: np.random.Generator) -> list[Window]:
    """A window of each of the views of a batch, all of one size where the images are.

    They are so wide and high as this ``share`` of the image, in multiples of `INPUT_MULTIPLE`, or more, so that the
    first anchor of each view has room: else the largest vehicles would never be taught.
    """
    anchors = [_anchors(view, rng) for view in views]
    firsts = np.concatenate([np.zeros((1, 4)), *(of_view[:1] for of_view in anchors)])
    least = np.ceil(sides_px(firsts).max(axis=0))
    return [_window(view, of_view, share, least, rng) for view, of_view in zip(views, anchors, strict=True)]


def _anchors(view: LabelledView, rng: np.random.Generator) -> FloatArray:
    """(K, 4) 2D boxes of vehicles of the view; none where the window may lie anywhere."""
    count = len(view.classes)
    anywhere, rows = rng.random() < _ANYWHERE_SHARE, rng.integers(max(count, 1), size=_TRIES)
    return view.boxes2d[:0] if anywhere or not count else view.boxes2d[rows]


def _window(
    view: LabelledView, anchors: FloatArray, share: float, least: FloatArray, rng: np.random.Generator
) -> Window:
    """The window around one of the anchors that holds most; anywhere where there is none."""
    whole = np.array(view.image.shape[1::-1])
    wanted = np.maximum(np.ceil(share * whole), np.maximum(least, _LEAST_PX))
    size = np.minimum(-(-wanted // INPUT_MULTIPLE) * INPUT_MULTIPLE, whole).astype(np.int64)
    last = whole - size
    if not len(anchors):
        return Window(*rng.integers(0, last, endpoint=True).tolist(), *size.tolist())
    ends = anchors[:, :2], anchors[:, 2:] - size
    tried = np.rint(rng.uniform(np.minimum(*ends), np.maximum(*ends)))
    corners = np.clip(tried, 0, last).astype(np.int64)
    worth = (_WORTH_WITHOUT_BOX + view.confidence) * _held(view.boxes2d, corners, size)
    return Window(*corners[int(worth.sum(axis=1).argmax())].tolist(), *size.tolist())


def _held(boxes: FloatArray, corners: NDArray[np.int64], size: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(K, N) which boxes (N, 4) are whole in windows of one size (2,) with these first pixels (K, 2)."""
    low, high = corners[:, None] - 0.5, corners[:, None] + size - 0.5
    return np.asarray(((boxes[:, :2] >= low) & (boxes[:, 2:] <= high)).all(axis=-1))


def crop_camera(camera: Camera, window: Window) -> Camera:
    """The camera that takes the window of the image, where rows of padding below the image do not count."""
    K = camera.K.copy()
    K[:2, 2] -= window.left_px, window.top_px
    height_px = min(window.height_px, camera.height_px - window.top_px)
    return Camera(K, camera.dist, camera.T_world_cam, window.width_px, height_px)


def crop(view: LabelledView, window: Window) -> tuple[LabelledView, NDArray[np.int64]]:
    """What the view shows in a window, and which (K,) of its vehicles are whole there; the others are ignored."""
    size = window.width_px, window.height_px
    shift = np.tile([window.left_px, window.top_px], 2)
    boxes = view.boxes2d - shift
    inside = clipped_to_image(boxes, *size)
    shown = clipped_to_image(view.boxes2d, *view.image.shape[1::-1])
    share = areas_px2(inside) / np.maximum(areas_px2(shown), 1e-9)
    kept = np.flatnonzero(share >= _WHOLE_SHARE)
    ignored = np.concatenate([clipped_to_image(view.ignored - shift, *size), inside[share < _WHOLE_SHARE]])
    rows = slice(window.top_px, window.top_px + window.height_px)
    columns = slice(window.left_px, window.left_px + window.width_px)
    part = replace(
        view.where(kept),
        image=view.image[rows, columns],
        camera=crop_camera(view.camera, window),
        boxes2d=boxes[kept],
        ignored=ignored[areas_px2(ignored) > 0],
        whole_width_px=view.whole_width_px or view.camera.width_px,
    )
    return part, kept
