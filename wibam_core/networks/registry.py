"""Which networks there are."""

from __future__ import annotations

from wibam_core.config import FinetuneConfig
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.train import TrainableDLA34
from wibam_core.networks.small.train import TrainableSmall
from wibam_core.networks.weights import Monocular
from wibam_core.training.trainable import TrainableNetwork


def trainable_of(network: Monocular, config: FinetuneConfig) -> TrainableNetwork:
    """The network with what belongs to it."""
    return TrainableDLA34(network, config) if isinstance(network, DLA34) else TrainableSmall(network, config)
