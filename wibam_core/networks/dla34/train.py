"""DLA-34 as `wibam_core.training.finetune` trains it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.config import FinetuneConfig
from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.pixels import resized_px, scale_of
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.centertrack import LONG_SIDE_PX, InputWarp, normalised
from wibam_core.networks.dla34.losses import box2d_parts, heat_part, lifted_parts, multiview_part, values_at
from wibam_core.networks.dla34.targets import encode
from wibam_core.training.dataset import SiteView
from wibam_core.training.multiview import DEFAULT_MULTIVIEW_WEIGHT, OtherViews
from wibam_core.training.views import FloatArray, LabelledView


class TrainableDLA34:
    """DLA-34 with CenterTrack's input and encoding; see `wibam_core.training.trainable.TrainableNetwork`.

    Its images are read anew each time they are asked for: next to a step of this network that takes no time, and kept
    they would need more than a megabyte each.
    """

    #: Of the published method, for batches of 80, and of CenterTrack's own training, for batches of 32.
    default_rates: Mapping[str, float] = MappingProxyType({"paper": 3.125e-5, "lifted": 1.25e-4, "combined": 1.25e-4})

    def __init__(self, network: DLA34, config: FinetuneConfig) -> None:
        self.network = network
        self._config = config

    def reader(self, cache: Path, views: Sequence[SiteView], frames: FrameStore) -> Callable[[int], LabelledView]:
        """Views by number, as the network sees them: 800 px at the longer side."""
        return lambda number: input_view(views[number], frames)

    def forward(self, views: Sequence[LabelledView], share: slice) -> dict[str, Tensor]:
        """The raw head outputs of these views of a batch."""
        images = stacked([view.image for view in views])[share]
        device = next(self.network.parameters()).device
        heads: dict[str, Tensor] = self.network(normalised(images).to(device, memory_format=torch.channels_last))
        return heads

    def losses(
        self, maps: Mapping[str, Tensor], views: Sequence[LabelledView], others: OtherViews
    ) -> dict[str, Tensor]:
        """The weighted parts of the loss of the options' method, and ``total``; on the CPU."""
        config = self._config
        targets = encode(views, *maps["hm"].shape[2:])
        values = values_at(maps, targets)
        parts = {"heat": heat_part(maps, targets)}
        if config.method != "paper":
            parts |= box2d_parts(values, targets) | lifted_parts(values, targets, config.decode)
        elif config.box_heads:
            parts |= box2d_parts(values, targets)
        if config.method != "lifted":
            weight = 1.0 if config.method == "paper" else config.multiview_weight or DEFAULT_MULTIVIEW_WEIGHT
            parts["multiview"] = weight * multiview_part(values, targets, others, config.decode)
        return {**parts, "total": torch.stack(list(parts.values())).sum()}


def input_view(view: SiteView, frames: FrameStore) -> LabelledView:
    """A site's view with its image, warped to the network's input; pixels and camera are those of the input."""
    labels = view.labels
    size = frames.size(view.camera_id)
    warp = InputWarp.of(*size, LONG_SIDE_PX)
    scale = scale_of(labels.camera.size_px, size)
    matrix = warp.matrix()

    def warped(boxes: FloatArray) -> FloatArray:
        points = resized_px(boxes.reshape(-1, 2), scale)
        return np.asarray(points * matrix[[0, 1], [0, 1]] + matrix[:2, 2]).reshape(-1, 4)

    return replace(
        labels,
        image=warp.image(frames.image(view.camera_id, view.time_ns)),
        camera=warp.camera(labels.camera.resized(*size)),
        boxes2d=warped(labels.boxes2d),
        ignored=warped(labels.ignored),
    )


def stacked(images: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Images (H, W, 3) of any sizes, padded at the bottom and on the right, in black, to one (B, H', W', 3)."""
    height, width = np.max([image.shape[:2] for image in images], axis=0)
    batch = np.zeros((len(images), height, width, 3), np.uint8)
    for number, image in enumerate(images):
        batch[number, : image.shape[0], : image.shape[1]] = image
    return batch
