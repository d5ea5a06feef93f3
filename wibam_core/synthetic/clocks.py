"""Camera clocks that are neither set nor run alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.clocks import ClockMap

IntArray = NDArray[np.int64]
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class CameraClock:
    """One camera's clock: it starts at 0 when the recording starts, and runs fast by ``drift``.

    Attributes:
        start_s: true time at which the clock shows 0.
        drift: relative error of the rate, e.g. 20e-6.
        phase_ns: the first frame is exposed at this time on the camera's clock.
    """

    start_s: float
    drift: float
    phase_ns: int

    def local_ns(self, true_s: float) -> int:
        """What the clock shows at a true time."""
        return round((true_s - self.start_s) * (1 + self.drift) * _NS_PER_S)

    def true_s(self, local_ns: int) -> float:
        """The true time at which the clock shows ``local_ns``."""
        return self.start_s + local_ns / _NS_PER_S / (1 + self.drift)

    def map_to(self, reference: CameraClock) -> ClockMap:
        """This clock against another camera's."""
        rate = (1 + reference.drift) / (1 + self.drift)
        return ClockMap(reference.local_ns(self.start_s), rate - 1)

    def frame_times_ns(self, seconds: float, fps: float, kept: NDArray[np.bool_]) -> IntArray:
        """Exposure times on this clock of the frames that were ``kept``, in a recording of ``seconds``."""
        k = np.arange(frame_count(seconds, fps))
        return np.asarray(self.phase_ns + np.rint(k * _NS_PER_S / fps).astype(np.int64))[kept]


def frame_count(seconds: float, fps: float) -> int:
    """Frames in a recording without drops."""
    return max(1, round(seconds * fps))


def sample_clock(rng: np.random.Generator, max_offset_s: float, max_drift_ppm: float, fps: float) -> CameraClock:
    """A clock whose start differs from any other's by at most ``max_offset_s``."""
    return CameraClock(
        start_s=float(rng.uniform(0, max_offset_s)),
        drift=float(rng.uniform(-max_drift_ppm, max_drift_ppm)) * 1e-6,
        phase_ns=int(rng.uniform(0, 1 / fps) * _NS_PER_S),
    )
