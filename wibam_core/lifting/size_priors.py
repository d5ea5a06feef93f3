"""What is known of the sizes of vehicles before looking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wibam_core.scene import CLASSES, FloatArray, VehicleClass


@dataclass(frozen=True)
class SizePrior:
    """Length, width, height: usual value in m, and standard deviation of its logarithm."""

    size_m: tuple[float, float, float]
    log_sd: tuple[float, float, float]


#: From what is sold and driven: passenger cars 3.6–5.1 m, panel vans 4.4–6.9 m, rigid trucks 5.5–12 m, buses 9–13 m.
SIZE_PRIORS: dict[VehicleClass, SizePrior] = {
    VehicleClass.CAR: SizePrior((4.4, 1.82, 1.52), (0.10, 0.05, 0.08)),
    VehicleClass.VAN: SizePrior((5.3, 2.0, 2.2), (0.13, 0.06, 0.12)),
    VehicleClass.TRUCK: SizePrior((8.0, 2.45, 3.2), (0.20, 0.06, 0.12)),
    VehicleClass.BUS: SizePrior((11.5, 2.55, 3.1), (0.12, 0.03, 0.06)),
}

#: (classes, 3) in the order of `CLASSES`.
LOG_SIZE_MEAN: FloatArray = np.log([SIZE_PRIORS[c].size_m for c in CLASSES])
LOG_SIZE_SD: FloatArray = np.array([SIZE_PRIORS[c].log_sd for c in CLASSES])
LOG_SIZE_MEAN.setflags(write=False)
LOG_SIZE_SD.setflags(write=False)
