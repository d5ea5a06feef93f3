"""What the training loop needs of a network: the loop is one, the networks are two."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from torch import Tensor

from wibam_core.formats.framestore import FrameStore
from wibam_core.networks.weights import Monocular
from wibam_core.training.dataset import SiteView
from wibam_core.training.multiview import OtherViews
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
