"""The ways in which the boxes that a network sees are placed in the world."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

#: ``plane``: where the ray to the 3D centre is half the vehicle's height above ground. ``depth``: on that ray at the
#: regressed depth. ``fused``: by both, by their regressed uncertainties. ``ground``: where the ray to the footprint
#: meets the ground. ``fitted``: from there, where they agree best with all that the network says about them, the edges
#: of their 2D boxes included. ``refined``: as ``fitted``, with edges of a second look at each vehicle.
Decode = Literal["plane", "depth", "fused", "ground", "fitted", "refined"]

#: What a network must have learned for some of them, beside what all need.
NEEDS: Mapping[str, str] = MappingProxyType(
    {"fused": "uncertainties to fuse by", **dict.fromkeys(("ground", "fitted", "refined"), "footprints")}
)
