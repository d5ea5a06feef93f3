"""The shared convolutional trunk: five stages of residual blocks and a feature pyramid merged at stride 4."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

#: Pixels of the network's input per cell of its output.
STRIDE = 4

#: Input sides are multiples of this.
INPUT_MULTIPLE = 32


@dataclass(frozen=True)
class TrunkShape:
    """Channels after each halving of the resolution (strides 2, 4, 8, 16, 32), and of the merged pyramid.

    ``blocks`` gives the residual blocks at strides 4, 8, 16 and 32. With ``refine`` a convolution follows every step
    up the pyramid, which tells apart the four cells that a coarser one was copied to.
    """

    channels: tuple[int, int, int, int, int]
    blocks: tuple[int, int, int, int]
    neck: int
    refine: bool = False


def conv_block(inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    """Convolution, batch normalisation, ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions around a skip connection."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = conv_block(channels, channels)
        self.second = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm2d(channels)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.norm(self.second(self.first(x))))


class Trunk(nn.Module):
    """Images (B, 3, H, W), BGR in 0..1, to features (B, neck, H/4, W/4); H and W are multiples of 32."""

    mean: Tensor
    std: Tensor

    def __init__(self, shape: TrunkShape) -> None:
        super().__init__()
        self.register_buffer("mean", torch.tensor([0.45, 0.45, 0.45]).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor([0.27, 0.27, 0.27]).view(1, 3, 1, 1))
        self.stem = conv_block(3, shape.channels[0], stride=2)
        self.stages = nn.ModuleList(
            nn.Sequential(conv_block(inputs, outputs, stride=2), *(ResidualBlock(outputs) for _ in range(blocks)))
            for inputs, outputs, blocks in zip(shape.channels[:-1], shape.channels[1:], shape.blocks, strict=True)
        )
        self.lateral = nn.ModuleList(nn.Conv2d(outputs, shape.neck, 1) for outputs in shape.channels[1:])
        self.refine = nn.ModuleList(
            conv_block(shape.neck, shape.neck) if shape.refine else nn.Identity() for _ in shape.channels[3:]
        )
        self.merge = conv_block(shape.neck, shape.neck)

    def forward(self, images: Tensor) -> Tensor:
        x = self.stem((images - self.mean) / self.std)
        levels: list[Tensor] = []
        for stage, lateral in zip(self.stages, self.lateral, strict=True):
            x = stage(x)
            levels.append(lateral(x))
        merged = levels[-1]
        for level, refine in zip(reversed(levels[1:-1]), self.refine, strict=True):
            merged = refine(level + functional.interpolate(merged, scale_factor=2.0, mode="nearest"))
        merged = levels[0] + functional.interpolate(merged, scale_factor=2.0, mode="nearest")
        features: Tensor = self.merge(merged)
        return features
