"""The classes that a network tells apart, by their names in the catalogue of road users."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.errors import InvalidWeights
from wibam_core.road_users import CLASSES, RoadUserClass

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ClassChannels:
    """Which class each channel of a network stands for.

    Attributes:
        numbers: (C,) index into `CLASSES` of each channel.
    """

    numbers: IntArray

    @classmethod
    def of(cls, source: str, names: Sequence[str]) -> ClassChannels:
        """From the names that a file gives its channels.

        Raises:
            InvalidWeights: the catalogue lacks one of them, or it stands there twice.
        """
        known = {road_user.value: road_user.number for road_user in CLASSES}
        unknown = [name for name in names if name not in known]
        if unknown:
            raise InvalidWeights(
                f"{source} knows a class {unknown[0]!r}, which we do not",
                hint=f"The classes are {', '.join(known)}.",
                field="classes",
            )
        if len(set(names)) < len(names):
            raise InvalidWeights(f"{source} names a class twice: {', '.join(names)}", field="classes")
        return cls(np.array([known[name] for name in names], dtype=np.int64))

    @property
    def known(self) -> frozenset[RoadUserClass]:
        """The classes."""
        return frozenset(CLASSES[number] for number in self.numbers)

    @property
    def channel_of(self) -> IntArray:
        """(classes of the catalogue,) channel of each class; −1 for one that the network does not know."""
        channels = np.full(len(CLASSES), -1, dtype=np.int64)
        channels[self.numbers] = np.arange(len(self.numbers))
        return channels
