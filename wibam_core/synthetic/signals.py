"""The signal program: two phases that take turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wibam_core.synthetic.layout import PHASES


@dataclass(frozen=True)
class SignalProgram:
    """Fixed-time control: green, amber, red for phase "a", then the same for phase "b", over and over.

    Attributes:
        cycle_s: time in which both phases have had their turn.
        amber_s: amber before red. all_red_s: red for everybody between two turns.
        offset_s: time at which phase "a" turns green.
    """

    cycle_s: float = 22.0
    amber_s: float = 3.0
    all_red_s: float = 1.5
    offset_s: float = 0.0

    def __post_init__(self) -> None:
        if self.green_s < 2.0:
            raise ValueError(
                f"a cycle of {self.cycle_s} s leaves {self.green_s:.1f} s of green per phase; 2 s is least"
            )

    @property
    def green_s(self) -> float:
        return self.cycle_s / len(PHASES) - self.amber_s - self.all_red_s

    def state(self, phase: str, time_s: float) -> str:
        """ "green", "amber" or "red"."""
        turn = self.cycle_s / len(PHASES)
        since = (time_s - self.offset_s - PHASES.index(phase) * turn) % self.cycle_s
        if since < self.green_s:
            return "green"
        return "amber" if since < self.green_s + self.amber_s else "red"

    def states(self, time_s: float) -> dict[str, str]:
        """State of every phase."""
        return {phase: self.state(phase, time_s) for phase in PHASES}

    def changes(self, start_s: float, end_s: float) -> list[tuple[float, str, str, str]]:
        """All changes in [start, end): time, phase, state before, state after; sorted by time."""
        found = []
        turn = self.cycle_s / len(PHASES)
        for number, phase in enumerate(PHASES):
            green = self.offset_s + number * turn
            steps = (
                (green, "red", "green"),
                (green + self.green_s, "green", "amber"),
                (green + self.green_s + self.amber_s, "amber", "red"),
            )
            for first, before, after in steps:
                k = np.arange(np.ceil((start_s - first) / self.cycle_s), np.ceil((end_s - first) / self.cycle_s))
                found += [(float(first + i * self.cycle_s), phase, before, after) for i in k]
        return sorted(found)
