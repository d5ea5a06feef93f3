"""The bundled 2D vehicle detector: a lighter trunk, boxes as distances from a cell to their four sides.

It stands in for an off-the-shelf detector at simulated sites and knows nothing about 3D.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from wibam_core.models.taught import TAUGHT
from wibam_core.models.trunk import Trunk, TrunkShape, conv_block

DETECTOR_SHAPE = TrunkShape(channels=(16, 16, 32, 64, 128), blocks=(0, 1, 1, 2), neck=32, refine=True)

_HEAD_CHANNELS = 32


class Detector2D(nn.Module):
    """Images (B, 3, H, W), BGR in 0..1, to heat logits (B, 4, H/4, W/4) and log l, t, r, b (B, 4, H/4, W/4).

    Distances are in cells of 4 px, from the cell's centre.
    """

    def __init__(self, shape: TrunkShape = DETECTOR_SHAPE) -> None:
        super().__init__()
        self.trunk = Trunk(shape)
        self.shared = conv_block(shape.neck, _HEAD_CHANNELS)
        self.heat = nn.Conv2d(_HEAD_CHANNELS, len(TAUGHT), 1)
        self.log_ltrb = nn.Conv2d(_HEAD_CHANNELS, 4, 1)
        nn.init.constant_(self.heat.get_parameter("bias"), -2.94)
        nn.init.constant_(self.log_ltrb.get_parameter("bias"), 1.3)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        features = self.shared(self.trunk(images))
        return self.heat(features).float(), self.log_ltrb(features).float()


class ExportedDetector2D(nn.Module):
    """What the ONNX file computes: ``heat`` after the sigmoid and a 3x3 peak suppression, and ``ltrb`` in cells."""

    def __init__(self, detector: Detector2D) -> None:
        super().__init__()
        self.detector = detector

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        logits, log_ltrb = self.detector(image)
        heat = logits.sigmoid()
        peak = (functional.max_pool2d(heat, 3, 1, 1) == heat).to(heat.dtype)
        return heat * peak, torch.exp(log_ltrb.clamp(-3.0, 5.0))
