"""Modulated deformable convolution (DCNv2, Zhu et al. 2019) in plain PyTorch: one code path on CPU and GPU."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


class DeformableConv2d(nn.Module):
    """A 3x3 convolution whose taps move and are weighted by what a second convolution says of the place.

    That second convolution, ``conv_offset_mask``, gives 27 channels: 18 offsets, read as (dy, dx) for each tap in row
    order, px; and 9 weights through a sigmoid. Outside the image everything is zero. It starts as half of a
    plain convolution: no offsets, all weights 0.5.
    """

    _TAPS = 9

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(out_channels, in_channels, 3, 3))
        self.bias = nn.Parameter(torch.zeros(out_channels))
        self.conv_offset_mask = nn.Conv2d(in_channels, 3 * self._TAPS, kernel_size=3, padding=1)
        nn.init.kaiming_uniform_(self.weight, a=5**0.5)
        nn.init.zeros_(self.conv_offset_mask.weight)
        nn.init.zeros_(self.conv_offset_mask.bias)  # type: ignore[arg-type]

    def forward(self, x: Tensor) -> Tensor:
        """(B, in, H, W) to (B, out, H, W)."""
        steering = self.conv_offset_mask(x)
        steering = steering.to(torch.promote_types(steering.dtype, torch.float32))  # bfloat16 places only to 1 px
        return deformable_conv2d(x, steering[:, :18], torch.sigmoid(steering[:, 18:]), self.weight, self.bias)


def deformable_conv2d(x: Tensor, offset: Tensor, mask: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """3x3 modulated deformable convolution, stride 1, zero padding 1.

    Args:
        x: (B, in, H, W).
        offset: (B, 18, H, W), (dy, dx) in px for each of the 9 taps in row order.
        mask: (B, 9, H, W), the weight of each tap.
        weight: (out, in, 3, 3).
        bias: (out,).

    Returns:
        (B, out, H, W).
    """
    batch, channels, height, width = x.shape
    rows = torch.arange(height, dtype=offset.dtype, device=x.device)
    columns = torch.arange(width, dtype=offset.dtype, device=x.device)
    tap = torch.arange(9, device=x.device)
    moves = offset.view(batch, 9, 2, height, width)
    y = moves[:, :, 0] + (tap // 3 - 1).to(offset.dtype)[:, None, None] + rows[:, None]
    x_at = moves[:, :, 1] + (tap % 3 - 1).to(offset.dtype)[:, None, None] + columns
    # grid_sample with align_corners counts from −1 at the first pixel's centre to 1 at the last's.
    grid = torch.stack([2 * x_at / max(width - 1, 1) - 1, 2 * y / max(height - 1, 1) - 1], dim=-1)
    sampled = functional.grid_sample(
        x, grid.reshape(batch, 9 * height, width, 2), mode="bilinear", padding_mode="zeros", align_corners=True
    )
    sampled = sampled.view(batch, channels, 9, height, width) * mask[:, None]
    flat = sampled.reshape(batch, channels * 9, height * width)
    out = weight.reshape(weight.shape[0], -1) @ flat
    return out.view(batch, -1, height, width) + bias[:, None, None]
