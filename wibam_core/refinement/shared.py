"""What all vehicles of a site share, and what their detector does to all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wibam_core.lifting.shapes import DEFORMATIONS, MODE_SD
from wibam_core.refinement.sightings import Sightings
from wibam_core.scene import FloatArray, IntArray

#: Standard deviations of what all vehicles share: how much boxes are too large to the sides, upwards and downwards, as
#: a share of their sides, and how far the mean size of a class at a site is off the catalogue's (logarithm).
EDGE_BIAS_SD = np.array([0.01, 0.01, 0.01])
_CLASS_SIZE_SD = 0.05


@dataclass(frozen=True, eq=False)
class Shared:
    """What all vehicles share: by how much a detector's boxes are too large, and how a class differs from its entry in
    the catalogue, in size and in the modes of its body. Left out, these errors would turn the cameras.

    Attributes:
        classes: (N,) for each sighting its class's number among those that occur.
        deformations: (classes, K, P, 3) of their bodies, see `wibam_core.lifting.shapes`.
        cameras: how many. sd: (G,) standard deviations: of the boxes' three kinds of edges, of each camera's clock (s),
            and 3 + K of each class.
    """

    classes: IntArray
    deformations: FloatArray
    cameras: int
    sd: FloatArray

    @classmethod
    def of(cls, sightings: Sightings, cameras: int, clock_sd_s: float) -> Shared:
        present, number = np.unique(sightings.classes, return_inverse=True)
        own = np.tile(np.concatenate([np.full(3, _CLASS_SIZE_SD), MODE_SD]), len(present))
        sd = np.concatenate([EDGE_BIAS_SD, np.full(cameras, clock_sd_s), own])
        return cls(number, DEFORMATIONS[present], cameras, sd)

    @property
    def clocks(self) -> slice:
        """Where the clocks are among the unknowns."""
        return slice(len(EDGE_BIAS_SD), len(EDGE_BIAS_SD) + self.cameras)

    def of_classes(self, shared: FloatArray) -> FloatArray:
        """(classes, 3 + K) of the unknowns (G,)."""
        return shared[self.clocks.stop :].reshape(len(self.deformations), -1)

    def bodies(self, shared: FloatArray) -> FloatArray:
        """(N, P, 3) by how much the bodies of the sightings differ from their classes' templates."""
        modes = self.of_classes(shared)[:, 3:]
        return np.einsum("ck,ckpd->cpd", modes, self.deformations)[self.classes]

    def sizes(self, shared: FloatArray) -> FloatArray:
        """(N, 3) by how much the usual sizes differ, in logarithms."""
        return self.of_classes(shared)[self.classes, :3]


def outward(boxes: FloatArray) -> FloatArray:
    """(N, V, 4, 3) by how much edges move with a unit of each bias: left and right, top, bottom."""
    sides = boxes[..., 2:] - boxes[..., :2]
    found = np.zeros((*boxes.shape, 3))
    found[..., 0, 0], found[..., 2, 0] = -sides[..., 0], sides[..., 0]
    found[..., 1, 1], found[..., 3, 2] = -sides[..., 1], sides[..., 1]
    return found
