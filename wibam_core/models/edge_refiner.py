"""A second look at each 2D box: where exactly its edges are, given what the camera shows without vehicles.

A fixed camera knows its background, against which an edge is plain to see; what is a shadow, what another vehicle, and
how far the vehicle goes on behind what hides it, is learned.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from wibam_core.models.taught import TAUGHT
from wibam_core.models.trunk import ResidualBlock, conv_block

_INPUTS = 7
_CHANNELS = (16, 32, 64, 96)
_NECK = 32
_PROFILE = 48
_HIDDEN = 64
_LOG_SCALES = (-7.0, 0.0)


class EdgeRefinerOutputs(NamedTuple):
    """What is said of B crops; lengths are shares of the crop, order left, top, right, bottom.

    Attributes:
        edges: (B, 4) of what is seen of the vehicle, from the crop's first border (0) to its last (1).
        reach: (B, 4) how far the vehicle goes on, hidden, beyond each edge, at least 0.
        log_scale: (B, 4) of the expected absolute error of the whole vehicle's edges.
        classes: (B, classes) logits.
    """

    edges: Tensor
    reach: Tensor
    log_scale: Tensor
    classes: Tensor

    @property
    def whole(self) -> Tensor:
        """(B, 4) edges of the whole vehicle, hidden parts included."""
        return self.edges + self.reach * self.reach.new_tensor([-1.0, -1.0, 1.0, 1.0])


class EdgeRefinerNetwork(nn.Module):
    """Crops (B, 7, S, S), S a multiple of 16, to `EdgeRefinerOutputs`.

    Channels are the image and the background, BGR in 0..1, and 1 where the background is known.

    An edge is the mean of a distribution over the columns (left, right) or rows (top, bottom) of the feature map
    (Sun et al. 2018, integral regression); what lies hidden beyond it, and how far it may err, is read where it is.
    """

    def __init__(self) -> None:
        super().__init__()
        inputs = _INPUTS + 2  # and where in the crop a pixel lies: the vehicle meant is the one in its middle
        stages = zip((inputs, *_CHANNELS), _CHANNELS, strict=False)
        self.stages = nn.ModuleList(
            nn.Sequential(conv_block(before, after, stride=2), ResidualBlock(after)) for before, after in stages
        )
        self.lateral = nn.ModuleList(nn.Conv2d(channels, _NECK, 1) for channels in _CHANNELS)
        self.merge = conv_block(_NECK, _NECK)
        self.profile = nn.Sequential(
            nn.Conv1d(2 * _NECK, _PROFILE, 5, padding=2),
            nn.ReLU(),
            nn.Conv1d(_PROFILE, _PROFILE, 5, padding=2),
            nn.ReLU(),
        )
        self.places = nn.ModuleList(nn.Conv1d(_PROFILE, 2, 1) for _ in range(2))
        self.beyond = nn.Sequential(nn.Linear(_PROFILE + _CHANNELS[-1] + 4, _HIDDEN), nn.ReLU(), nn.Linear(_HIDDEN, 2))
        self.classes = nn.Linear(_CHANNELS[-1], len(TAUGHT))
        with torch.no_grad():  # at first, edges are nearly all in sight, and off by 3 %
            self.beyond[-1].get_parameter("bias").copy_(torch.tensor([-0.5, -3.5]))

    def features(self, crops: Tensor) -> tuple[Tensor, Tensor]:
        """Maps (B, C, S/2, S/2), and a summary (B, F)."""
        across = torch.linspace(-0.5, 0.5, crops.shape[-1], dtype=crops.dtype, device=crops.device)
        across = torch.zeros_like(crops[:, :1]) + across
        x = torch.cat([crops - 0.5, across, across.transpose(2, 3)], dim=1)
        levels: list[Tensor] = []
        for stage, lateral in zip(self.stages, self.lateral, strict=True):
            x = stage(x)
            levels.append(lateral(x))
        merged = levels[-1]
        for level in reversed(levels[:-1]):
            merged = level + functional.interpolate(merged, scale_factor=2.0, mode="nearest")
        return self.merge(merged), x.mean(dim=(2, 3))

    def heads(self, maps: Tensor, summary: Tensor) -> EdgeRefinerOutputs:
        """What `features` say."""
        (x, at_x), (y, at_y) = (
            self._ends(maps, along, place) for along, place in zip((2, 3), self.places, strict=True)
        )
        edges = torch.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], dim=1)
        context = torch.stack([at_x[:, 0], at_y[:, 0], at_x[:, 1], at_y[:, 1]], dim=1)
        which = torch.zeros_like(edges)[..., None] + torch.eye(4, dtype=edges.dtype, device=edges.device)
        said = self.beyond(torch.cat([context, summary[:, None].expand(-1, 4, -1), which], dim=2))
        reach = functional.softplus(4.0 * said[..., 0]) / 4.0
        return EdgeRefinerOutputs(edges, reach, said[..., 1].clamp(*_LOG_SCALES), self.classes(summary))

    def _ends(self, maps: Tensor, along: int, place: nn.Module) -> tuple[Tensor, Tensor]:
        """(B, 2) where the vehicle begins and ends, seen along axis 2 (columns are left) or 3 (rows are left), and the
        features (B, 2, P) there."""
        profile = self.profile(torch.cat([maps.amax(dim=along), maps.mean(dim=along)], dim=1))
        share = place(profile).softmax(dim=-1)
        count = share.shape[-1]
        # a little beyond both borders, so that a mean can lie on them
        centres = torch.linspace(-0.05, 1.05, count, dtype=share.dtype, device=share.device)
        return (share * centres).sum(dim=-1), share @ profile.transpose(1, 2)

    def forward(self, crops: Tensor) -> EdgeRefinerOutputs:
        return self.heads(*self.features(crops))
