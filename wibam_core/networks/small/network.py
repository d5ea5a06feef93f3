"""The small network: how it detects, and how it is trained."""

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
from wibam_core.models.classes import ClassChannels
from wibam_core.models.frames import INPUT_WIDTH_PX, Frame, to_input
from wibam_core.models.weights import load_state
from wibam_core.networks.small.architecture import CLASS_NAMES, SmallNetwork, SmallOutputs
from wibam_core.networks.small.export import small_onnx
from wibam_core.networks.small.objectives import objective_of
from wibam_core.networks.small.onnx_network import FAMILY_NAME, OnnxNetwork
from wibam_core.networks.small.predict import Maps, predict_each
from wibam_core.networks.small.targets import encode
from wibam_core.placing import Decode
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Vehicles3D
from wibam_core.training.dataset import ImageCache, SiteView
from wibam_core.training.multiview import OtherViews
from wibam_core.training.views import LabelledView

#: The card of the bundled weights.
CARD = ModelCard(family=FAMILY_NAME, classes=CLASS_NAMES, decode="plane", input_width_px=INPUT_WIDTH_PX)


class SmallMonocular:
    """The small network in torch; see `wibam_core.training.trainable.TrainableNetwork`.

    Args:
        module: as many channels of heat as the card has classes.
        card: what its file says about it.
    """

    default_rates: Mapping[str, float] = MappingProxyType({"paper": 1e-4, "lifted": 2.5e-3, "combined": 2.5e-3})
    states_sd = True

    def __init__(self, module: SmallNetwork, card: ModelCard = CARD) -> None:
        self.module = module
        self.card = card
        self._classes = ClassChannels.of(f"a network of the family {card.family}", card.classes)

    @classmethod
    def load(cls, path: Path, card: ModelCard) -> SmallMonocular:
        """The network of a weights file; what errors it raises, `wibam_core.networks.family.Family` says."""
        classes = ClassChannels.of(path.name, card.classes)
        module = SmallNetwork(mean_sizes_m=[(1.0, 1.0, 1.0)] * len(classes.numbers))
        load_state(module, path)
        width_px = card.input_width_px or INPUT_WIDTH_PX
        return cls(module, card.model_copy(update={"input_width_px": width_px}))

    @property
    def known(self) -> frozenset[RoadUserClass]:
        """What it tells apart."""
        return self._classes.known

    # --- detecting --------------------------------------------------------------------------
    def predict_each(
        self, frames: Iterable[Frame], *, decodes: Sequence[Decode], min_score: float, batch_size: int = 8
    ) -> Iterator[tuple[Vehicles3D, ...]]:
        """See `wibam_core.models.network.Network`; so many images a pass."""
        self.module.eval()
        maps = Maps(self._run, self.module.mean_sizes_m.cpu(), self._classes.numbers, self.view_width_px)
        return predict_each(maps, frames, decodes=decodes, min_score=min_score, batch_size=batch_size)

    def _run(self, images: NDArray[np.uint8]) -> SmallOutputs:
        outputs: SmallOutputs = self.module(to_input(images, self.module.mean_sizes_m.device))
        return SmallOutputs(**{name: values.cpu() for name, values in vars(outputs).items()})

    def runnable(self, device: torch.device) -> OnnxNetwork:
        """In ONNX Runtime on the CPU, where it is faster than torch on one."""
        return OnnxNetwork.of(self.onnx())

    def onnx(self) -> bytes:
        """See `wibam_core.networks.small.export.small_onnx`."""
        return small_onnx(self.module, self.card)

    # --- learning ---------------------------------------------------------------------------
    @property
    def view_width_px(self) -> int:
        """That of its input."""
        return self.card.input_width_px or INPUT_WIDTH_PX

    def reader(self, cache: Path, views: Sequence[SiteView], frames: FrameStore) -> Callable[[int], LabelledView]:
        """Views by number, their prepared images kept in a file."""
        return ImageCache(cache, views, frames).view

    def maps(self, views: Sequence[LabelledView], share: slice) -> dict[str, Tensor]:
        """The fields of `SmallOutputs`."""
        images = np.stack([view.image for view in views[share]])
        return dict(vars(self.module(to_input(images, self.module.mean_sizes_m.device))))

    def losses(
        self, maps: Mapping[str, Tensor], views: Sequence[LabelledView], others: OtherViews, config: FinetuneConfig
    ) -> dict[str, Tensor]:
        """Of the objective that the options ask for."""
        outputs = SmallOutputs(**{name: values.cpu() for name, values in maps.items()})
        mean_sizes_m = self.module.mean_sizes_m.cpu()
        in_channels = [replace(view, classes=self._classes.channel_of[view.classes]) for view in views]
        # float32 holds the sizes to a fraction of a micrometre, to which they were written
        targets = encode(in_channels, mean_sizes_m.double().numpy().round(6))
        return objective_of(config)(outputs, targets, mean_sizes_m, others)
