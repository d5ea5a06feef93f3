"""The small network as `wibam_core.training.finetune` trains it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from torch import Tensor

from wibam_core.config import FinetuneConfig
from wibam_core.formats.framestore import FrameStore
from wibam_core.models.frames import to_input
from wibam_core.networks.small.architecture import SmallNetwork, SmallOutputs
from wibam_core.networks.small.objectives import objective_of
from wibam_core.networks.small.targets import encode
from wibam_core.training.dataset import ImageCache, SiteView
from wibam_core.training.multiview import OtherViews
from wibam_core.training.views import LabelledView


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
