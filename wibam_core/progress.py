"""How long work tells how far it is. Core code only calls; who listens (a terminal, a worker) decides."""

from __future__ import annotations

from typing import Protocol

_TRUSTED_FRACTION = 0.05  # below it, the elapsed time says too little


class Progress(Protocol):
    def __call__(self, fraction: float, message: str = "", **figures: float) -> None:
        """Report ``fraction`` done in [0, 1], a short message for a person, and named figures (e.g. ``loss``)."""


def remaining_s(elapsed_s: float, fraction: float) -> float | None:
    """How long (s) work will still take that goes on as fast as it did; None before a twentieth of it is done."""
    if fraction < _TRUSTED_FRACTION:
        return None
    return max(elapsed_s * (1.0 - fraction) / fraction, 0.0)


def silent(fraction: float, message: str = "", **figures: float) -> None:
    """A listener that does nothing."""


def part(progress: Progress, start: float, end: float) -> Progress:
    """A listener for one part of a longer work: its 0..1 becomes ``start``..``end``."""

    def report(fraction: float, message: str = "", **figures: float) -> None:
        progress(start + (end - start) * min(max(fraction, 0.0), 1.0), message, **figures)

    return report
