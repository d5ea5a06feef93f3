"""nuScenes's classes, by whose names DLA-34's heat map has channels, and the road users that they stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.road_users import CLASSES


@dataclass(frozen=True, eq=False)
class RoadUserChannels:
    """Which channels of a heat map find road users. The others, such as a trailer's, are not looked at.

    A trailer is a box of its own behind its truck's: taken for a road user it would follow its truck without a gap, and
    be in conflict with it all the time.

    Attributes:
        channels: (K,) of the heat map, ascending.
        numbers: (K,) index into `CLASSES` of what each finds.
        row_of: (classes of the catalogue,) which of the K a class is taught in, by what comes closest to it there; −1
            where nothing does.
    """

    channels: tuple[int, ...]
    numbers: NDArray[np.int64]
    row_of: NDArray[np.int64]

    @classmethod
    def of(cls, names: Sequence[str]) -> RoadUserChannels:
        """From the names of a heat map's channels."""
        called = {road_user.number: road_user.traits.elsewhere.nuscenes for road_user in CLASSES}
        number_of = {name: number for number, there in called.items() for name in there.read}
        channels = tuple(channel for channel, name in enumerate(names) if name in number_of)
        rows = {names[channel]: row for row, channel in enumerate(channels)}
        return cls(
            channels,
            np.array([number_of[name] for name in rows], dtype=np.int64),
            np.array([rows.get(there.written or "", -1) for there in called.values()], dtype=np.int64),
        )
