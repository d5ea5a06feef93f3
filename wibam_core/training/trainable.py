"""What the training loop needs of a network beside what every network does: the loop is one, the networks are many."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor, nn

from wibam_core.config import FinetuneConfig
from wibam_core.documents.model_card import ModelCard
from wibam_core.formats.framestore import FrameStore
from wibam_core.models.network import Network
from wibam_core.training.dataset import SiteView
from wibam_core.training.multiview import OtherViews
from wibam_core.training.views import LabelledView


class TrainableNetwork(Network, Protocol):
    """A 3D network with its input, its encoding of road users and its losses.

    Attributes:
        card: what its file says about it; training changes it.
        module: its weights, trained in place; on any device.
        default_rates: learning rate by method, where the options give none. It can be trained by these methods.
        view_width_px: how wide the images are in whose pixels it is given labelled views.
        states_sd: whether it states standard deviations.
    """

    card: ModelCard

    @property
    def module(self) -> nn.Module: ...

    @property
    def default_rates(self) -> Mapping[str, float]: ...

    @property
    def view_width_px(self) -> int: ...

    @property
    def states_sd(self) -> bool: ...

    def reader(self, cache: Path, views: Sequence[SiteView], frames: FrameStore) -> Callable[[int], LabelledView]:
        """A function from a view's number to that view in pixels of the network's input, with its image.

        ``cache`` names a file that it may make anew.
        """

    def maps(self, views: Sequence[LabelledView], share: slice) -> dict[str, Tensor]:
        """What it says (b, C, h, w), float32, on its device, of the ``share`` of a batch of views.

        Their size is the same for every share of a batch.
        """

    def losses(
        self, maps: Mapping[str, Tensor], views: Sequence[LabelledView], others: OtherViews, config: FinetuneConfig
    ) -> dict[str, Tensor]:
        """The weighted parts of the loss of a whole batch and their sum as ``total``, on the CPU.

        Args:
            maps: of all views, see `maps`.
            views: of known road users alone.
            others: the views of other cameras.
            config: method, and how boxes are placed.
        """

    def runnable(self, device: torch.device) -> Network:
        """The same network as it detects fastest: on the device, or, where it can do better, elsewhere."""

    def onnx(self) -> bytes | None:
        """An ONNX file of it, its card included; None where its family has none."""
