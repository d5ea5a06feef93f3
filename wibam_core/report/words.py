"""Figures as a person reads them."""

from __future__ import annotations

from wibam_core.documents.base import MeanSd
from wibam_core.safety.drac import MAX_BRAKING_MPS2

NONE = "–"


def number(value: float | None, digits: int) -> str:
    """A number, or a dash."""
    return NONE if value is None else f"{value:.{digits}f}"


def signed(value: float, digits: int) -> str:
    """A number with its sign, as it is printed."""
    return f"{value:+.{digits}f}".replace("-", "−")


def mean_sd(value: MeanSd, digits: int = 2) -> str:
    """``mean ± s.d.``"""
    if value.mean is None:
        return NONE
    return number(value.mean, digits) + ("" if value.sd is None else f" ± {value.sd:.{digits}f}")


def interval(value: float | None, ends: tuple[float | None, float | None], digits: int = 2) -> str:
    """``value [low, high]``; an end without bound is ∞."""
    if value is None:
        return NONE
    low, high = ("∞" if end is None else f"{end:.{digits}f}" for end in ends)
    return f"{value:.{digits}f} [{low}, {high}]"


def percent(share: float | None) -> str:
    """A share as whole percent, or a dash."""
    return NONE if share is None else f"{100 * share:.0f} %"


def braking(deceleration_mps2: float | None) -> str:
    """A needed deceleration; above what tyres can do its size says no more than that."""
    if deceleration_mps2 is not None and deceleration_mps2 > MAX_BRAKING_MPS2:
        return f"> {MAX_BRAKING_MPS2:g}"
    return number(deceleration_mps2, 1)
