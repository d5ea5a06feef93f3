"""DLA-34 with deformable upsampling, as CenterTrack's monocular 3D detector uses it.

Deep layer aggregation (Yu et al. 2018) in the arrangement of CenterNet and CenterTrack (Zhou et al. 2019, 2020).
Parameter names and shapes are those of the published checkpoints, so that a user's weights load after
`wibam_core.networks.dla34.convert`; they are the only reason for names such as ``actf`` and ``amodel_offset``.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import torch
from torch import Tensor, nn

from wibam_core.networks.dla34.deformable import DeformableConv2d

#: Output channels of each head of the nuScenes 3D detection network.
HEADS: Mapping[str, int] = MappingProxyType(
    {"hm": 10, "reg": 2, "wh": 2, "dep": 1, "rot": 8, "dim": 3, "amodel_offset": 2}
)
STRIDE = 4
_CHANNELS = (16, 32, 64, 128, 256, 512)
_MOMENTUM = 0.1


def _conv_bn_relu(inputs: int, outputs: int, kernel: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs, momentum=_MOMENTUM),
        nn.ReLU(inplace=True),
    )


class _BasicBlock(nn.Module):
    """Two 3x3 convolutions and a shortcut that the caller gives."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs, momentum=_MOMENTUM)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs, momentum=_MOMENTUM)
        self.relu = nn.ReLU(inplace=True)

    def forward(self, x: Tensor, shortcut: Tensor) -> Tensor:
        out = self.relu(self.bn1(self.conv1(x)))
        return self.relu(self.bn2(self.conv2(out)) + shortcut)


class _Root(nn.Module):
    """Aggregates the ends of a tree's branches by a 1x1 convolution."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 1, bias=False)
        self.bn = nn.BatchNorm2d(outputs, momentum=_MOMENTUM)
        self.relu = nn.ReLU(inplace=True)

    def forward(self, *branches: Tensor) -> Tensor:
        return self.relu(self.bn(self.conv(torch.cat(branches, dim=1))))


class _Tree(nn.Module):
    """Hierarchical aggregation: two blocks and a root, or two trees of one level less that share the last root."""

    def __init__(
        self, levels: int, inputs: int, outputs: int, stride: int, *, keeps_input: bool = False, aggregated: int = 0
    ) -> None:
        super().__init__()
        self.levels = levels
        self.keeps_input = keeps_input
        aggregated += 2 * outputs if levels == 1 else outputs
        aggregated += inputs if keeps_input else 0
        if levels == 1:
            self.tree1: nn.Module = _BasicBlock(inputs, outputs, stride)
            self.tree2: nn.Module = _BasicBlock(outputs, outputs, 1)
            self.root = _Root(aggregated, outputs)
        else:
            self.tree1 = _Tree(levels - 1, inputs, outputs, stride)
            self.tree2 = _Tree(levels - 1, outputs, outputs, 1, aggregated=aggregated)
        self.downsample = nn.MaxPool2d(stride, stride) if stride > 1 else nn.Identity()
        # Trees of trees carry a projection that published checkpoints hold but no output depends on.
        self.project: nn.Module = (
            nn.Identity()
            if inputs == outputs
            else nn.Sequential(nn.Conv2d(inputs, outputs, 1, bias=False), nn.BatchNorm2d(outputs, momentum=_MOMENTUM))
        )

    def forward(self, x: Tensor, branches: tuple[Tensor, ...] = ()) -> Tensor:
        bottom = self.downsample(x)
        if self.keeps_input:
            branches = (*branches, bottom)
        if self.levels > 1:
            first = self.tree1(x)
            aggregated: Tensor = self.tree2(first, (*branches, first))
            return aggregated
        first = self.tree1(x, self.project(bottom))
        second = self.tree2(first, first)
        joined: Tensor = self.root(second, first, *branches)
        return joined


class _Base(nn.Module):
    """The backbone: six levels at strides 1, 2, 4, 8, 16 and 32."""

    def __init__(self) -> None:
        super().__init__()
        c = _CHANNELS
        self.base_layer = _conv_bn_relu(3, c[0], 7)
        self.level0 = _conv_bn_relu(c[0], c[0], 3)
        self.level1 = _conv_bn_relu(c[0], c[1], 3, stride=2)
        self.level2 = _Tree(1, c[1], c[2], 2)
        self.level3 = _Tree(2, c[2], c[3], 2, keeps_input=True)
        self.level4 = _Tree(2, c[3], c[4], 2, keeps_input=True)
        self.level5 = _Tree(1, c[4], c[5], 2, keeps_input=True)

    def forward(self, x: Tensor) -> list[Tensor]:
        x = self.base_layer(x)
        levels = []
        for level in (self.level0, self.level1, self.level2, self.level3, self.level4, self.level5):
            x = level(x)
            levels.append(x)
        return levels


class _DeformConv(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = DeformableConv2d(inputs, outputs)
        self.actf = nn.Sequential(nn.BatchNorm2d(outputs, momentum=_MOMENTUM), nn.ReLU(inplace=True))

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.actf(self.conv(x))
        return out


class _IDAUp(nn.Module):
    """Iterative aggregation: brings coarser maps to the first one's size, adding each to the one before."""

    def __init__(self, outputs: int, inputs: tuple[int, ...], factors: tuple[int, ...]) -> None:
        super().__init__()
        self.count = len(inputs)
        for i in range(1, self.count):
            factor = factors[i]
            setattr(self, f"proj_{i}", _DeformConv(inputs[i], outputs))
            setattr(self, f"node_{i}", _DeformConv(outputs, outputs))
            up = nn.ConvTranspose2d(outputs, outputs, 2 * factor, factor, factor // 2, groups=outputs, bias=False)
            _fill_bilinear(up.weight)
            setattr(self, f"up_{i}", up)

    def forward(self, maps: list[Tensor]) -> list[Tensor]:
        """All maps at the size of the first, each with those before it added in."""
        out = [maps[0]]
        for i in range(1, self.count):
            raised = getattr(self, f"up_{i}")(getattr(self, f"proj_{i}")(maps[i]))
            out.append(getattr(self, f"node_{i}")(raised + out[-1]))
        return out


def _fill_bilinear(weight: Tensor) -> None:
    """Set a transposed convolution's kernels (C, 1, k, k) to bilinear interpolation."""
    size = weight.shape[-1]
    half = (size + 1) // 2
    centre = (2 * half - 1 - half % 2) / (2.0 * half)
    ramp = 1 - (torch.arange(size) / half - centre).abs()
    with torch.no_grad():
        weight.copy_(ramp[:, None] * ramp[None, :])


class _DLAUp(nn.Module):
    """Aggregates levels 2 to 5 from the coarsest up; gives the finest map after every step, finest first."""

    def __init__(self) -> None:
        super().__init__()
        c = _CHANNELS
        self.ida_0 = _IDAUp(c[4], (c[4], c[5]), (1, 2))
        self.ida_1 = _IDAUp(c[3], (c[3], c[4], c[4]), (1, 2, 2))
        self.ida_2 = _IDAUp(c[2], (c[2], c[3], c[3], c[3]), (1, 2, 2, 2))

    def forward(self, levels: list[Tensor]) -> list[Tensor]:
        maps = list(levels)
        out = [maps[-1]]
        for start, ida in ((4, self.ida_0), (3, self.ida_1), (2, self.ida_2)):
            maps[start:] = ida(maps[start:])
            out.insert(0, maps[-1])
        return out


class DLA34(nn.Module):
    """Image to head maps at stride 4.

    Args:
        heads: name -> channels. Each head is a 3x3 convolution to 256 channels, ReLU, and a 1x1 convolution.
    """

    def __init__(self, heads: Mapping[str, int] = HEADS) -> None:
        super().__init__()
        self.heads = dict(heads)
        self.base = _Base()
        self.dla_up = _DLAUp()
        self.ida_up = _IDAUp(_CHANNELS[2], _CHANNELS[2:5], (1, 2, 4))
        for name, channels in self.heads.items():
            head = nn.Sequential(
                nn.Conv2d(_CHANNELS[2], 256, 3, padding=1), nn.ReLU(inplace=True), nn.Conv2d(256, channels, 1)
            )
            if name == "hm":
                nn.init.constant_(head[2].bias, -4.6)  # type: ignore[arg-type]  # objects are rare: sigmoid gives 0.01
            setattr(self, name, head)

    def forward(self, images: Tensor) -> dict[str, Tensor]:
        """Raw head outputs (B, channels, H/4, W/4) of normalised BGR images (B, 3, H, W); H, W multiples of 32."""
        maps = self.dla_up(self.base(images))
        features = self.ida_up(maps[:3])[-1]
        hidden = {name: getattr(self, name)[:2](features) for name in self.heads}
        with torch.autocast(images.device.type, enabled=False):  # bfloat16 knows a depth to 1 % only
            last = {name: getattr(self, name)[2] for name in self.heads}
            return {name: last[name](values.to(last[name].weight.dtype)) for name, values in hidden.items()}
