"""Cameras' clocks: each against the reference, and the traffic lights that tell. Time is int nanoseconds."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class ClockPiece:
    """From when on a camera's clock is off by more than at the beginning of its recording.

    A recording of several segments (joined files, a restarted camera) is one timeline, on which a segment may have
    been put where it was only assumed to lie; what it lies off is its shift.

    Attributes:
        from_ns: time of the segment's first frame on the camera's own clock.
        shift_ns: what is added to the reference times of this segment; it does not add up over segments.
    """

    from_ns: int
    shift_ns: int


@dataclass(frozen=True)
class ClockMap:
    """A camera's clock against the reference: ``t_ref = t_local + offset_ns + drift · t_local + shift``.

    ``t_local`` is the time of a frame in its recording, int ns. The shift is 0 up to the first piece, and then that of
    the piece that ``t_local`` lies in: one oscillator, so one drift, but a segment may lie elsewhere than assumed.

    Raises:
        ValueError: the pieces do not ascend, on the camera's own clock or on the reference clock.
    """

    offset_ns: int = 0
    drift: float = 0.0
    pieces: tuple[ClockPiece, ...] = ()

    def __post_init__(self) -> None:
        starts, reference = self._starts_ns, self.to_reference_ns(self._starts_ns)
        if (np.diff(starts) <= 0).any() or (np.diff(reference) <= 0).any():
            raise ValueError(f"the pieces of a clock must ascend on both clocks: {self.pieces}")

    @property
    def _starts_ns(self) -> IntArray:
        return np.array([piece.from_ns for piece in self.pieces], dtype=np.int64)

    @property
    def _shifts_ns(self) -> IntArray:
        return np.array([0, *(piece.shift_ns for piece in self.pieces)], dtype=np.int64)

    def to_reference_ns(self, local_ns: IntArray | int) -> IntArray:
        """Local timestamps (...) to the reference clock (...)."""
        local = np.asarray(local_ns, dtype=np.int64)
        shift = self._shifts_ns[np.searchsorted(self._starts_ns, local, side="right")]
        return local + self.offset_ns + np.rint(self.drift * local).astype(np.int64) + shift

    def to_local_ns(self, reference_ns: IntArray | int) -> IntArray:
        """Reference timestamps (...) to this camera's clock (...), the inverse within 1 ns where frames are.

        A time between two pieces, when the camera did not record, stays below the start of the later piece.
        """
        reference = np.asarray(reference_ns, dtype=np.int64)
        starts = self._starts_ns
        piece = np.searchsorted(self.to_reference_ns(starts), reference, side="right")
        reference = reference - self.offset_ns - self._shifts_ns[piece]
        local = reference - np.rint(reference * (self.drift / (1.0 + self.drift))).astype(np.int64)
        ends = np.append(starts - 1, np.iinfo(np.int64).max)
        return np.asarray(np.minimum(local, ends[piece]))


@dataclass(frozen=True)
class SignalChange:
    """A traffic light seen to change in one camera.

    Attributes:
        camera_id, signal_id: where; the same ``signal_id`` in two cameras is the same lamp or shows the same phase.
        time_ns: on that camera's own clock (presentation timestamps).
        before, after: "red", "amber", "green", "red_amber" or "off".
        confidence: in [0, 1].
        half_interval_ns: the change happened within ``time_ns`` ± this: half the time between the last frame that
            shows the old state and the first that shows the new one. 0 where it is exact.
    """

    camera_id: str
    signal_id: str
    time_ns: int
    before: str
    after: str
    confidence: float = field(default=1.0)
    half_interval_ns: int = 0
