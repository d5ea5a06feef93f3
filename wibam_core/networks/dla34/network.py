"""CenterTrack's DLA-34: how it detects, and how it is trained."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.config import FinetuneConfig
from wibam_core.documents.model_card import ModelCard
from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.pixels import resized_px, scale_of
from wibam_core.models.frames import INPUT_WIDTH_PX, Frame
from wibam_core.models.weights import load_state
from wibam_core.networks.dla34.architecture import DLA34, HEADS
from wibam_core.networks.dla34.centertrack import LONG_SIDE_PX, InputWarp, decode_vehicles, normalised
from wibam_core.networks.dla34.classes import RoadUserChannels
from wibam_core.networks.dla34.losses import box2d_parts, heat_part, lifted_parts, multiview_part, values_at
from wibam_core.networks.dla34.targets import encode
from wibam_core.placing import Decode
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import Vehicles3D
from wibam_core.training.dataset import SiteView
from wibam_core.training.multiview import DEFAULT_MULTIVIEW_WEIGHT, OtherViews
from wibam_core.training.views import FloatArray, LabelledView
from wibam_core.traits import NUSCENES_CLASSES

FAMILY_NAME = "centertrack-dla34"
#: How its boxes can be placed: it states no uncertainties to fuse by, and knows no footprints.
DECODES: tuple[Decode, ...] = ("depth", "plane")
#: The card of converted weights, apart from where they come from.
CARD = ModelCard(family=FAMILY_NAME, classes=NUSCENES_CLASSES, decode=DECODES[0])


class CenterTrack:
    """DLA-34 with CenterTrack's input and encoding; see `wibam_core.training.trainable.TrainableNetwork`.

    Its images are read anew each time they are asked for: next to a step of this network that takes no time, and kept
    they would need more than a megabyte each.

    Args:
        module: with as many channels of heat as the card has classes.
        card: what its file says about it.

    Attributes:
        long_side_px: of its input.
    """

    #: Published rates: "paper" as Howe et al. (2021) trained, in batches of 80, the others as CenterTrack was, in
    #: batches of 32.
    default_rates: Mapping[str, float] = MappingProxyType({"paper": 3.125e-5, "lifted": 1.25e-4, "combined": 1.25e-4})
    states_sd = False
    long_side_px = LONG_SIDE_PX
    #: Labelled views come in any pixels, and are moved to the input's.
    view_width_px = INPUT_WIDTH_PX

    def __init__(self, module: DLA34, card: ModelCard = CARD) -> None:
        self.module = module
        self.card = card
        self._classes = RoadUserChannels.of(card.classes)

    @classmethod
    def load(cls, path: Path, card: ModelCard) -> CenterTrack:
        """The network of a weights file; what errors it raises, `wibam_core.networks.family.Family` says."""
        module = DLA34({**HEADS, "hm": len(card.classes)})
        load_state(module, path)
        return cls(module, card)

    @property
    def known(self) -> frozenset[RoadUserClass]:
        """What nuScenes has a name for, or for something close to it: vans are cars there."""
        return frozenset(c for c, row in zip(CLASSES, self._classes.row_of, strict=True) if row >= 0)

    # --- detecting --------------------------------------------------------------------------
    def predict_each(
        self, frames: Iterable[Frame], *, decodes: Sequence[Decode], min_score: float
    ) -> Iterator[tuple[Vehicles3D, ...]]:
        """See `wibam_core.models.network.Network`; one image a pass, standard deviations unknown."""
        self.module.eval()
        for frame in frames:
            height_px, width_px = frame.image.shape[:2]
            warp = InputWarp.of(width_px, height_px, self.long_side_px)
            camera = frame.camera.resized(width_px, height_px)
            with torch.inference_mode():
                maps = self.module(warp.to_input(frame.image).to(self._device))
                heads = {name: values.cpu() for name, values in maps.items()}
                ways = [
                    decode_vehicles(heads, warp, camera, self._classes, min_score=min_score, decode=decode)
                    for decode in decodes
                ]
            yield tuple(
                Vehicles3D.of(
                    frame.time_ns, found.boxes, classes=found.classes, scores=found.scores, camera_id=frame.camera_id
                )
                for found in ways
            )

    def runnable(self, device: torch.device) -> CenterTrack:
        """Itself, moved there."""
        self.module.to(device)
        return self

    def onnx(self) -> None:
        """None: its deformable convolutions have no operator there."""

    @property
    def _device(self) -> torch.device:
        return next(self.module.parameters()).device

    # --- learning ---------------------------------------------------------------------------
    def reader(self, cache: Path, views: Sequence[SiteView], frames: FrameStore) -> Callable[[int], LabelledView]:
        """Views by number, as the network sees them: 800 px at the longer side."""
        return lambda number: input_view(views[number], frames, self.long_side_px)

    def maps(self, views: Sequence[LabelledView], share: slice) -> dict[str, Tensor]:
        """The raw head outputs of these views of a batch."""
        images = stacked([view.image for view in views])[share]
        heads: dict[str, Tensor] = self.module(normalised(images).to(self._device, memory_format=torch.channels_last))
        return heads

    def losses(
        self, maps: Mapping[str, Tensor], views: Sequence[LabelledView], others: OtherViews, config: FinetuneConfig
    ) -> dict[str, Tensor]:
        """The weighted parts of the loss of the options' method, and ``total``; on the CPU."""
        height, width = maps["hm"].shape[2:]
        targets = encode(views, height, width, self._classes)
        values = values_at(maps, targets)
        parts = {"heat": heat_part(maps, targets, self._classes.channels)}
        if config.method != "paper":
            parts |= box2d_parts(values, targets) | lifted_parts(values, targets, config.decode)
        elif config.box_heads:
            parts |= box2d_parts(values, targets)
        if config.method != "lifted":
            weight = 1.0 if config.method == "paper" else config.multiview_weight or DEFAULT_MULTIVIEW_WEIGHT
            parts["multiview"] = weight * multiview_part(values, targets, others, config.decode)
        return {**parts, "total": torch.stack(list(parts.values())).sum()}


def input_view(view: SiteView, frames: FrameStore, long_side_px: int) -> LabelledView:
    """A site's view with its image, warped to the network's input; pixels and camera are those of the input."""
    labels = view.pseudo_labels
    size = frames.size(view.camera_id)
    warp = InputWarp.of(*size, long_side_px)
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
