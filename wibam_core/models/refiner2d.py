"""A second look at each 2D box: where exactly its edges are, given what the camera shows without vehicles.

A fixed camera knows its background, against which an edge is plain to see; what is a shadow, and what another vehicle,
is learned.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from wibam_core.models.trunk import ResidualBlock, conv_block
from wibam_core.scene import CLASSES

_CHANNELS = (16, 32, 64)
_NECK = 24
_PROFILE = 32


class Refiner2D(nn.Module):
    """Crops (B, 7, S, S), S a multiple of 8, to edges (B, 4), log scales (B, 4) and class logits (B, 4).

    Channels are the image and the background, BGR in 0..1, and 1 where the background is known. Edges are left, top,
    right, bottom in crops from the crop's first border (0) to its last (1); log scales are those of their expected
    absolute errors.

    An edge is the mean of a distribution over the columns (left, right) or rows (top, bottom) of the feature map
    (Sun et al. 2018, integral regression).
    """

    def __init__(self) -> None:
        super().__init__()
        stages = zip((7, *_CHANNELS), _CHANNELS, strict=False)
        self.stages = nn.ModuleList(
            nn.Sequential(conv_block(inputs, outputs, stride=2), ResidualBlock(outputs)) for inputs, outputs in stages
        )
        self.lateral = nn.ModuleList(nn.Conv2d(outputs, _NECK, 1) for outputs in _CHANNELS)
        self.merge = conv_block(_NECK, _NECK)
        self.profile = nn.Sequential(
            nn.Conv1d(2 * _NECK, _PROFILE, 5, padding=2),
            nn.ReLU(),
            nn.Conv1d(_PROFILE, _PROFILE, 5, padding=2),
            nn.ReLU(),
        )
        self.places = nn.ModuleList(nn.Conv1d(_PROFILE, 2, 1) for _ in range(2))
        self.log_scale = nn.Linear(_CHANNELS[-1], 4)
        self.classes = nn.Linear(_CHANNELS[-1], len(CLASSES))
        nn.init.constant_(self.log_scale.get_parameter("bias"), -3.5)

    def features(self, crops: Tensor) -> tuple[Tensor, Tensor]:
        """Maps (B, C, S/2, S/2), and a summary (B, F)."""
        x = crops - 0.5
        levels: list[Tensor] = []
        for stage, lateral in zip(self.stages, self.lateral, strict=True):
            x = stage(x)
            levels.append(lateral(x))
        merged = levels[-1]
        for level in reversed(levels[:-1]):
            merged = level + functional.interpolate(merged, scale_factor=2.0, mode="nearest")
        return self.merge(merged), x.mean(dim=(2, 3))

    def heads(self, maps: Tensor, summary: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Edges, log scales and class logits of `features`."""
        ends = [self._ends(maps, along, place) for along, place in zip((2, 3), self.places, strict=True)]
        edges = torch.stack([ends[0][:, 0], ends[1][:, 0], ends[0][:, 1], ends[1][:, 1]], dim=1)
        return edges, self.log_scale(summary).clamp(-7.0, 0.0), self.classes(summary)

    def _ends(self, maps: Tensor, along: int, place: nn.Module) -> Tensor:
        """(B, 2) where the vehicle begins and ends, seen along axis 2 (columns are left) or 3 (rows are left)."""
        profile = self.profile(torch.cat([maps.amax(dim=along), maps.mean(dim=along)], dim=1))
        share = place(profile).softmax(dim=-1)
        count = share.shape[-1]
        # a little beyond both borders, so that a mean can lie on them
        centres = torch.linspace(-0.05, 1.05, count, dtype=share.dtype, device=share.device)
        return (share * centres).sum(dim=-1)

    def forward(self, crops: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return self.heads(*self.features(crops))
