"""What the training loop needs of a network: the loop is one, the networks are two."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np
from torch import Tensor

from wibam_core.config import FinetuneConfig
from wibam_core.formats.framestore import FrameStore
from wibam_core.models.dla34 import DLA34
from wibam_core.models.inference import to_input
from wibam_core.models.small import SmallNetwork, SmallOutputs
from wibam_core.models.weights import Monocular
from wibam_core.training.dataset import ImageCache, SiteView
from wibam_core.training.dla34 import TrainableDLA34
from wibam_core.training.multiview import OtherViews
from wibam_core.training.objectives import objective_of
from wibam_core.training.targets import encode
from wibam_core.training.views import LabelledView


class TrainableNetwork(Protocol):
    """A network with its input and its encoding of vehicles.

    Attributes:
        network: trained in place; on any device.
        default_rates: learning rate by method, where the options give none.
    """

    @property
    def network(self) -> Monocular: ...

    @property
    def default_rates(self) -> Mapping[str, float]: ...

    def reader(self, cache: Path, views: Sequence[SiteView], frames: FrameStore) -> Callable[[int], LabelledView]:
        """A function from a view's number to that view in pixels of the network's input, with its image.

        ``cache`` names a file that it may make anew.
        """

    def forward(self, views: Sequence[LabelledView], share: slice) -> dict[str, Tensor]:
        """The network's maps (b, C, h, w), float32, on its device, for the ``share`` of a batch of views.

        Their size is the same for every share of a batch.
        """

    def losses(
        self, maps: Mapping[str, Tensor], views: Sequence[LabelledView], others: OtherViews
    ) -> dict[str, Tensor]:
        """The weighted parts of the loss of a whole batch and their sum as ``total``, on the CPU."""


class TrainableSmall:
    """The small network; see `TrainableNetwork`."""

    default_rates: Mapping[str, float] = MappingProxyType({"paper": 1e-4, "lifted": 2.5e-3, "combined": 2.5e-3})

    def __init__(self, network: SmallNetwork, config: FinetuneConfig) -> None:
        self.network = network
        self._objective = objective_of(config)

    def reader(self, cache: Path, views: Sequence[SiteView], frames: FrameStore) -> Callable[[int], LabelledView]:
        """Views by number, their prepared images kept in a file."""
        return ImageCache(cache, views, frames).view

    def forward(self, views: Sequence[LabelledView], share: slice) -> dict[str, Tensor]:
        """The fields of `SmallOutputs`."""
        images = np.stack([view.image for view in views[share]])
        return dict(vars(self.network(to_input(images, self.network.mean_sizes_m.device))))

    def losses(
        self, maps: Mapping[str, Tensor], views: Sequence[LabelledView], others: OtherViews
    ) -> dict[str, Tensor]:
        """Of the objective that the options ask for."""
        outputs = SmallOutputs(**{name: values.cpu() for name, values in maps.items()})
        return self._objective(outputs, encode(views), self.network.mean_sizes_m.cpu(), others)


def trainable_of(network: Monocular, config: FinetuneConfig) -> TrainableNetwork:
    """The network with what belongs to it."""
    return TrainableDLA34(network, config) if isinstance(network, DLA34) else TrainableSmall(network, config)
