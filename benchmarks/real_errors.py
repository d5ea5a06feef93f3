"""What the errors against hand labels are made of: what all vehicles share, sizes, headings, and what is left.

Each part is set to the label's in turn, and the overlap of footprints (BEV IoU) and the distance of centres (ATE) are
taken again: what that gains is what the part costs. The shift that all vehicles share is fitted to the same labels that
it is judged by, two numbers of all vehicles: it is as much the labels' own common frame as the calibration's.

Run: python -m benchmarks.real_errors SITE --labels LABELS.json --area AREA.json --runs build/real [--of fits]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.real_labels import Judged, read_area, read_labels
from benchmarks.real_measures import of_fits, of_tracks
from wibam_core.artifacts.catalogue import FITS, TRACKS
from wibam_core.geometry.box3d import LENGTH, SIZE, WIDTH, XY, YAW
from wibam_core.geometry.iou import bev_iou_paired
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.stages.runner import SiteFolder, latest
from wibam_core.stages.store import StageStore

Array = NDArray[np.float64]

#: Axles farther apart belong to what the labels place less exactly and detectors cut in two, m.
_LONG_M = 6.5


def pairs_of(judged: Iterable[Judged]) -> tuple[Array, Array, list[str]]:
    """Labels (F, 7), boxes (F, 7) and names of all vehicle-instants that were found."""
    every = list(judged)
    pairs = np.concatenate([np.empty((0, 2, 7)), *(one.pairs for one in every)])
    return pairs[:, 0], pairs[:, 1], [name for one in every for name in one.found]


def _without_shift(labels: Array, boxes: Array) -> Array:
    moved = boxes.copy()
    moved[:, XY] -= (boxes - labels)[:, XY].mean(axis=0)
    return moved


def _with(columns: slice | int) -> Callable[[Array, Array], Array]:
    def put(labels: Array, boxes: Array) -> Array:
        changed = boxes.copy()
        changed[:, columns] = labels[:, columns]
        return changed

    return put


def _with_footprint(labels: Array, boxes: Array) -> Array:
    """The label's length and width about the box's own centre."""
    return _with(SIZE)(labels, boxes)


def _without_footprint_bias(labels: Array, boxes: Array) -> Array:
    """Lengths and widths divided by how much larger than the labels they are in the median."""
    changed = boxes.copy()
    for column in (LENGTH, WIDTH):
        changed[:, column] /= np.median(boxes[:, column] / labels[:, column])
    return changed


#: What is set right -> how.
REPAIRS: dict[str, Callable[[Array, Array], Array]] = {
    "nothing": lambda labels, boxes: boxes,
    "the shift that all share": _without_shift,
    "each vehicle's place": _with(XY),
    "each vehicle's heading": _with(YAW),
    "each vehicle's length and width": _with_footprint,
    "the bias of lengths and widths": _without_footprint_bias,
    "the shared shift, lengths and widths": lambda labels, boxes: _with_footprint(
        labels, _without_shift(labels, boxes)
    ),
}


def repaired(labels: Array, boxes: Array) -> list[tuple[str, float, float]]:
    """What is set right, BEV IoU and ATE (m) then."""
    rows = []
    for name, repair in REPAIRS.items():
        changed = repair(labels, boxes)
        distance = np.linalg.norm((changed - labels)[:, XY], axis=1)
        rows.append((name, float(bev_iou_paired(labels, changed).mean()), float(distance.mean())))
    return rows


def along_and_across(labels: Array, boxes: Array) -> Array:
    """(F, 2) errors of centres along and across the label's heading, m."""
    offset = (boxes - labels)[:, XY]
    cos, sin = np.cos(labels[:, YAW]), np.sin(labels[:, YAW])
    return np.stack([cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]], axis=1)


def document(labels: Array, boxes: Array, names: list[str]) -> str:
    """Markdown: what each part costs, and how large the parts are."""
    offset, own = (boxes - labels)[:, XY], along_and_across(labels, boxes)
    mean = offset.mean(axis=0)
    lines = [
        f"{len(labels)} vehicle-instants of {len(set(names))} vehicles.",
        "",
        "| set right | BEV IoU | ATE m |",
        "|---|---|---|",
        *(f"| {name} | {iou:.3f} | {ate:.2f} |" for name, iou, ate in repaired(labels, boxes)),
        "",
        "| part | mean | s.d. | median of the absolute |",
        "|---|---|---|---|",
    ]
    heading = np.degrees(normalise_angle(boxes[:, YAW] - labels[:, YAW]))
    for name, values, unit in (
        ("x", offset[:, 0], "m"),
        ("y", offset[:, 1], "m"),
        ("along the heading", own[:, 0], "m"),
        ("across it", own[:, 1], "m"),
        ("heading", heading, "°"),
        ("length", boxes[:, LENGTH] - labels[:, LENGTH], "m"),
        ("width", boxes[:, WIDTH] - labels[:, WIDTH], "m"),
    ):
        lines.append(f"| {name} | {values.mean():+.2f} {unit} | {values.std():.2f} | {np.median(np.abs(values)):.2f} |")
    for name, rows in (("long", labels[:, LENGTH] > _LONG_M), ("other", labels[:, LENGTH] <= _LONG_M)):
        if rows.any():
            ratio = np.median(boxes[rows][:, [LENGTH, WIDTH]] / labels[rows][:, [LENGTH, WIDTH]], axis=0)
            lines.append("")
            lines.append(
                f"Of {int(rows.sum())} {name} ones (label {'>' if name == 'long' else '<='} {_LONG_M:g} m): length "
                f"{ratio[0]:.2f} and width {ratio[1]:.2f} of the label's in the median."
            )
    lines.append("")
    lines.append(
        f"Share of the squared distance that is the shared shift: {(mean @ mean) / (offset**2).sum(1).mean():.2f}."
    )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", type=Path)
    parser.add_argument("--labels", type=Path, required=True)
    parser.add_argument("--area", type=Path, required=True)
    parser.add_argument("--runs", type=Path, default=Path("build/real"), help="outputs of the last run are measured")
    parser.add_argument("--of", choices=("tracks", "fits"), default="tracks")
    parser.add_argument("--list", action="store_true", help="each vehicle-instant, and each further box")
    arguments = parser.parse_args()
    area, ignored = read_area(arguments.area)
    labels = read_labels(arguments.labels, ignored)
    outputs = latest(SiteFolder.load(arguments.site), StageStore(arguments.runs))
    found = (
        of_tracks(labels, area, list(outputs.read(TRACKS)))
        if arguments.of == "tracks"
        else of_fits(labels, area, outputs.read(FITS))
    )
    judged = list(found)
    truth, boxes, names = pairs_of(one for _, one in judged)
    print(document(truth, boxes, names))
    if arguments.list:
        with np.printoptions(precision=2, suppress=True):
            for of, one in judged:
                for name, (label, box) in zip(one.found, one.pairs, strict=True):
                    print(f"{of.time_ns * 1e-9:.1f} s {name} label {label} box {box}")
                for box in one.further:
                    print(f"{of.time_ns * 1e-9:.1f} s further {box}")


if __name__ == "__main__":
    main()
