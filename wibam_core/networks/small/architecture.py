"""The small centre-point network: 3D vehicles from one image.

A vehicle is a peak of its class's heat map at the centre of its 2D box. At the peak the heads give the 2D box, the
offset to the projected 3D centre, the depth for a focal length of `REFERENCE_FOCAL_PX`, the size against the class's
mean, and alpha: the yaw less the azimuth of the world ray through the projected 3D centre, which is what the
appearance determines whatever the camera's pitch. One more head gives the offset to the projected centre of the
footprint, which lies on the ground whatever the vehicle's height: a 3D centre is placed on the ground plane only as
well as the height is known, and 0.1 m of height move it by 0.2 m where a camera 8 m high sees it 35 m away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from wibam_core.models.trunk import Trunk, TrunkShape, conv_block

#: Depth is learned as if every camera had this focal length, in px of the image that the network sees.
REFERENCE_FOCAL_PX = 400.0

#: What the bundled weights tell apart, and mean length, width and height of each, m.
CLASS_NAMES = ("car", "van", "truck", "bus")
MEAN_SIZES_M = ((4.49, 1.82, 1.55), (5.34, 1.98, 2.18), (7.72, 2.38, 3.15), (10.75, 2.49, 3.03))

#: Groups of regressed values with a common uncertainty each.
UNCERTAINTY_GROUPS = ("centre3d", "depth", "size", "yaw", "footprint")

SMALL_SHAPE = TrunkShape(channels=(16, 32, 64, 128, 160), blocks=(1, 1, 2, 1), neck=40)

_HEAD_CHANNELS = 64


@dataclass(frozen=True)
class SmallOutputs:
    """Maps (B, C, H/4, W/4).

    Attributes:
        heat: (B, C, ...) logits per class.
        box2d: (B, 4, ...) offset of the 2D box's centre from the cell x, y, and log width, height; cells.
        centre3d: (B, 2, ...) offset of the projected 3D centre from the cell x, y; cells.
        depth: (B, 1, ...) log of the depth in m for `REFERENCE_FOCAL_PX`.
        size: (B, 3, ...) log of length, width, height over the class's mean.
        yaw: (B, 2, ...) sin and cos of alpha, not normalised.
        footprint: (B, 2, ...) offset of the footprint's projected centre from the cell x, y; cells.
        log_scale: (B, 5, ...) log of the expected absolute error of each of `UNCERTAINTY_GROUPS`: cells, log depth,
            log size, rad, cells.
    """

    heat: Tensor
    box2d: Tensor
    centre3d: Tensor
    depth: Tensor
    size: Tensor
    yaw: Tensor
    footprint: Tensor
    log_scale: Tensor


#: Initial biases: of each class's heat, 0.05 everywhere; of the other heads, one per channel, typical boxes, depths and
#: errors.
_HEAT_BIAS = -2.94
_HEAD_BIASES = {
    "box2d": (0.0, 0.0, 2.3, 2.0),
    "centre3d": (0.0, 0.0),
    "depth": (3.0,),
    "size": (0.0, 0.0, 0.0),
    "yaw": (0.0, 0.0),
    "footprint": (0.0, 0.0),
    "log_scale": (-1.0,) * len(UNCERTAINTY_GROUPS),
}


class SmallNetwork(nn.Module):
    """1.5 million parameters; images (B, 3, H, W), BGR in 0..1, to `SmallOutputs` at stride 4.

    Attributes:
        mean_sizes_m: (C, 3) mean length, width, height per class.

    Args:
        shape: of its trunk.
        mean_sizes_m: of the classes that it is to tell apart; weights that are loaded bring their own.
    """

    mean_sizes_m: Tensor

    def __init__(self, shape: TrunkShape = SMALL_SHAPE, mean_sizes_m: Sequence[Sequence[float]] = MEAN_SIZES_M) -> None:
        super().__init__()
        self.trunk = Trunk(shape)
        self.shared = conv_block(shape.neck, _HEAD_CHANNELS)
        biases = {"heat": (_HEAT_BIAS,) * len(mean_sizes_m), **_HEAD_BIASES}
        self.heads = nn.ModuleDict({name: _head(of_channels) for name, of_channels in biases.items()})
        self.register_buffer("mean_sizes_m", torch.tensor(mean_sizes_m))

    def forward(self, images: Tensor) -> SmallOutputs:
        features = self.shared(self.trunk(images)).float()
        with torch.autocast(images.device.type, enabled=False):  # bfloat16 knows offsets and depths to 1 % only
            return SmallOutputs(**self._maps(features))

    def _maps(self, features: Tensor) -> dict[str, Tensor]:
        """What each head says, in one pass over the features: one pass for each takes several times as long."""
        heads = [head for head in self.heads.values() if isinstance(head, nn.Conv2d)]
        weight, bias = (torch.cat([head.get_parameter(name) for head in heads]) for name in ("weight", "bias"))
        maps = functional.conv2d(features, weight, bias).split([head.out_channels for head in heads], dim=1)
        return dict(zip(self.heads, maps, strict=True))


def _head(biases: tuple[float, ...]) -> nn.Conv2d:
    head = nn.Conv2d(_HEAD_CHANNELS, len(biases), 1)
    nn.init.normal_(head.weight, std=0.01)
    with torch.no_grad():
        torch.nn.Module.get_parameter(head, "bias").copy_(torch.tensor(biases))
    return head
