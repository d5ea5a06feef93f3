"""What every 3D network does; `wibam_core.training.trainable` says what one does that can be trained."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

from wibam_core.documents.model_card import ModelCard
from wibam_core.models.frames import Frame
from wibam_core.placing import Decode
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Vehicles3D


class Network(Protocol):
    """A 3D network: images and cameras to boxes in the world, with standard deviations where it states any.

    Attributes:
        card: what its file says about it.
        known: the road users that it finds, and can be taught, under their own name or one that is close to it. Others
            are never asked of it.
    """

    @property
    def card(self) -> ModelCard: ...

    @property
    def known(self) -> frozenset[RoadUserClass]: ...

    def predict_each(
        self, frames: Iterable[Frame], *, decodes: Sequence[Decode], min_score: float
    ) -> Iterator[tuple[Vehicles3D, ...]]:
        """Detect road users: per frame, in the frames' order, a `Vehicles3D` in the world for each way to place boxes.

        It runs once for all of these ways, on the device that it is on. Standard deviations are as it has learned
        them; NaN where it states none.

        Args:
            frames: consumed as needed, a few of them in memory.
            decodes: how boxes are placed; its family knows which of `Decode` it can.
            min_score: what is less sure than this is left out.
        """


def predict(network: Network, frames: Iterable[Frame], *, decode: Decode, min_score: float) -> Iterator[Vehicles3D]:
    """Detect road users, placed in one way: see `Network.predict_each`."""
    return (vehicles for (vehicles,) in network.predict_each(frames, decodes=(decode,), min_score=min_score))
