"""One look for all figures: colours that colour-blind readers can tell apart, and axes without clutter."""

from __future__ import annotations

import unicodedata
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK = "#1d2733"
MUTED = "#6b7785"
GRID = "#dfe4ea"

#: Baseline, fine-tuned and truth look the same in every figure and on every image.
BASELINE = "#e8590c"
FINETUNED = "#1e88e5"
TRUTH = "#2b9348"

CAMERA_COLOURS: tuple[str, ...] = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#7a5195",
    "#8a6d3b",
)
CONFLICT_COLOURS: dict[str, str] = {
    "rear_end": "#e69f00",
    "merging": "#56b4e9",
    "crossing": "#d55e00",
    "head_on": "#a3154b",
}


def camera_colour(number: int) -> str:
    """Colour of the n-th camera of a rig."""
    return CAMERA_COLOURS[number % len(CAMERA_COLOURS)]


def bgr(colour: str) -> tuple[int, int, int]:
    """``#rrggbb`` as OpenCV's (blue, green, red)."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return blue, green, red


def printable(text: str) -> str:
    """A user's text without control characters; blanks of all widths (Unicode's Zs) are spaces."""
    return "".join(map(_printable, text))


def _printable(character: str) -> str:
    if unicodedata.category(character) == "Zs":
        return " "
    return character if character.isprintable() else "\N{REPLACEMENT CHARACTER}"


def plain(text: str) -> str:
    """A user's text as matplotlib may show it: no formula between dollar signs, no control characters."""
    return printable(text).replace("$", r"\$")


def new_figure(width_in: float = 8.6, height_in: float = 3.4, *, fixed_aspect: bool = False) -> Figure:
    """An empty figure, bound to no window and to no global state; ``fixed_aspect`` where its axes are maps."""
    size = (width_in, height_in)
    return Figure(figsize=size, layout="compressed" if fixed_aspect else "constrained", facecolor="white")


def tidy(axes: Axes, *, title: str = "", x: str = "", y: str = "", grid: Literal["x", "y", "both", ""] = "y") -> None:
    """Axis labels, a left-aligned title, a light grid along ``grid`` ("x", "y", "both" or "") and no box."""
    axes.set_title(title, loc="left", fontsize=10, fontweight="bold", color=INK)
    axes.set_xlabel(x, fontsize=9, color=INK)
    axes.set_ylabel(y, fontsize=9, color=INK)
    axes.tick_params(labelsize=8.5, colors=MUTED, length=3)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GRID)
    axes.set_axisbelow(True)
    if grid:
        axes.grid(axis=grid, color=GRID, linewidth=0.8)
