"""What a run at a site of other bodies found, against its truth: boxes in images, fits, tracks, and each model's share.

A detector is asked for vehicles that it sees half of, 12 px at the shorter side; fits and tracks are asked for what two
cameras see half of within 35 m of the middle of all cameras. Of the training part, fits leave out on purpose whoever is
there later, too, as a queue is: only those of the test part tell how many vehicles can be fitted.

Run: python -m benchmarks.other_bodies.measure SITE [SITE ...] [--runs FOLDER ...] [--json docs/other-bodies.json]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmarks.real_errors import along_and_across, repaired
from benchmarks.real_measures import tracks_at
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.artifacts.catalogue import DETECTIONS, FITS, RIG, ROUND_DETECTIONS, SPLIT, TRACKS
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.evaluation.matching import assign, match_on_ground
from wibam_core.evaluation.metrics import METRICS, compare
from wibam_core.formats.labels import read_labels
from wibam_core.geometry.box3d import SIZE, XY
from wibam_core.geometry.boxes2d import image_iou, sides_px
from wibam_core.scene import Boxes2D, FrameKey, LabelledInstant
from wibam_core.stages.runner import SiteFolder, latest
from wibam_core.stages.store import StageStore

Array = NDArray[np.float64]
Row = dict[str, object]

_LEAST_VISIBLE, _LEAST_PX = 0.5, 12.0
_RANGE_M, _VIEWS, _SAME_M = 35.0, 2, 2.0
#: A box that overlaps no vehicle by so much is false (IoU).
_FALSE_IOU = 0.3
#: Recordings keep times to some microseconds.
_SAME_TIME_NS = 1_000_000
_SIDES = ("x0", "y0", "x1", "y1")


@dataclass(eq=False)
class Tally:
    """Vehicle-instants by model, and matched boxes.

    Attributes:
        names: (A) models of all that were asked for. found: (A) whether they were. further: false ones.
        truth, boxes: of those found, what is true and what was found.
    """

    names: list[str] = field(default_factory=list)
    found: list[bool] = field(default_factory=list)
    further: int = 0
    truth: list[Array] = field(default_factory=list)
    boxes: list[Array] = field(default_factory=list)

    def recall(self, name: str | None = None) -> tuple[int, int]:
        """How many were found, and asked for: of one model, or of all."""
        of = [found for own, found in zip(self.names, self.found, strict=True) if name in (None, own)]
        return sum(of), len(of)

    @property
    def pairs(self) -> tuple[Array, Array, list[str]]:
        """True (K, n) and found (K, n) boxes, and models."""
        names = [name for name, found in zip(self.names, self.found, strict=True) if found]
        return np.array(self.truth), np.array(self.boxes), names

    def add(self, names: Sequence[str], truth: Array, boxes: Array) -> None:
        self.names += names
        self.found += [True] * len(names)
        self.truth += list(truth)
        self.boxes += list(boxes)

    def miss(self, names: Sequence[str]) -> None:
        self.names += names
        self.found += [False] * len(names)


def model_names(site: Path) -> dict[int, str]:
    """Vehicle id -> its model's name."""
    table = pq.read_table(site / "truth" / "models.parquet").to_pydict()
    return dict(zip(table["vehicle_id"], table["model"], strict=True))


def of_detections(site: Path, detected: Mapping[FrameKey, Boxes2D]) -> Tally:
    """Boxes of what is seen. The pairs are boxes around whole vehicles (K, 4), px."""
    names, tally = model_names(site), Tally()
    table = pq.read_table(site / "truth" / "boxes2d.parquet").to_pandas()
    for camera_id, rows in table.groupby("camera_id"):
        times = np.sort(rows.time_ns.unique())
        for frame, seen in detected.items():
            if frame.camera_id != camera_id:
                continue
            nearest = times[np.abs(times - frame.local_ns).argmin()]
            if abs(nearest - frame.local_ns) > _SAME_TIME_NS:
                continue
            there = rows[rows.time_ns == nearest]
            visible, whole = (there[[f"{kind}_{s}" for s in _SIDES]].to_numpy(float) for kind in ("visible", "amodal"))
            asked = (there.visibility.to_numpy() >= _LEAST_VISIBLE) & (sides_px(visible).min(axis=1) >= _LEAST_PX)
            overlap = image_iou(seen.boxes, visible)
            mine, theirs = assign(1 - overlap, 0.5)
            hit = asked[theirs]
            who = [names[i] for i in there.vehicle_id.tolist()]
            found = np.where(np.isnan(seen.amodal_boxes), seen.boxes, seen.amodal_boxes)
            tally.add([who[k] for k in theirs[hit]], whole[theirs[hit]], found[mine[hit]])
            tally.miss([who[k] for k in np.setdiff1d(np.flatnonzero(asked), theirs)])
            tally.further += int((overlap.max(axis=1, initial=0.0) < _FALSE_IOU).sum())
    return tally


def of_boxes(site: Path, middle: Array, instants: Iterable[tuple[int, Array]]) -> Tally:
    """Boxes (N, 7) in the world at some times, about the middle (2,) of the cameras."""
    names, tally = model_names(site), Tally()
    labels = LabelTimeline(read_labels(site / "labels.parquet"))
    for time_ns, boxes in instants:
        label = labels.at(time_ns)
        if label is None:
            continue
        truth = label.vehicles.boxes
        match = match_on_ground(truth, _asked(label, middle), boxes, _SAME_M)
        who = [names[i] for i in label.vehicles.ids.tolist()]
        tally.add([who[k] for k in match.labels], truth[match.labels], boxes[match.detections])
        tally.miss([who[k] for k in match.missed])
        off = np.linalg.norm(boxes[match.false_positives][:, XY] - middle, axis=1)
        tally.further += int((off < _RANGE_M).sum())
    return tally


def _asked(label: LabelledInstant, middle: Array) -> NDArray[np.bool_]:
    seen = np.array([share >= _LEAST_VISIBLE for share in label.visibility.values()]).sum(axis=0) >= _VIEWS
    return np.asarray(seen & (np.linalg.norm(label.vehicles.boxes[:, XY] - middle, axis=1) < _RANGE_M))


def figures(tally: Tally) -> Row:
    """Recall and precision, and of boxes in the world the five metrics and the median ratio of sizes."""
    found, asked = tally.recall()
    row: Row = {
        "asked": asked, "found": found, "recall": found / max(asked, 1),
        "precision": found / max(found + tally.further, 1),
    }  # fmt: skip
    truth, boxes, _ = tally.pairs
    if not len(truth):
        return row
    if truth.shape[1] == 4:
        off = (boxes - truth) * [-1, -1, 1, 1]
        row["edges_off_px"] = dict(zip(_SIDES, np.median(off, axis=0).tolist(), strict=True))
        row["edges_abs_px"] = dict(zip(_SIDES, np.median(np.abs(off), axis=0).tolist(), strict=True))
        return row
    metrics = compare(boxes, truth)
    row |= {name: float(np.nanmean(getattr(metrics, name))) for name in METRICS}
    row["aoe_median_deg"] = float(np.nanmedian(metrics.aoe_deg))
    row["turned_round"] = float((metrics.aoe_deg > 90).mean())
    row["size_ratio"] = np.median(boxes[:, SIZE] / truth[:, SIZE], axis=0).tolist()
    return row


def by_model(tally: Tally) -> list[Row]:
    """The same of every model that was asked for."""
    rows = []
    for name in sorted(set(tally.names)):
        own = Tally()
        truth, boxes, names = tally.pairs
        mine = np.array([other == name for other in names], bool)
        if mine.any():
            own.add([name] * int(mine.sum()), truth[mine], boxes[mine])
        found, asked = tally.recall(name)
        own.miss([name] * (asked - found))
        rows.append({"model": name, **figures(own)})
    return rows


def measure(site: Path, outputs: ArtifactReader) -> dict[str, Row]:
    """All that the stages that ran found."""
    middle = np.mean([camera.centre_m[:2] for camera in outputs.read(RIG).values()], axis=0)
    kinds: dict[str, Tally] = {"detections": of_detections(site, outputs.read(DETECTIONS))}
    kinds["detections after rounds"] = of_detections(site, outputs.read(ROUND_DETECTIONS))
    fits = outputs.read(FITS)
    kinds["fits"] = of_boxes(site, middle, ((v.time_ns, v.boxes) for v in fits))
    test = set(outputs.read(SPLIT).times_ns["test"])
    kinds["fits of the test part"] = of_boxes(site, middle, ((v.time_ns, v.boxes) for v in fits if v.time_ns in test))
    if outputs.has(TRACKS):
        tracks = list(outputs.read(TRACKS))
        times = [v.time_ns for v in fits]
        kinds["tracks"] = of_boxes(site, middle, ((t, tracks_at(tracks, t)) for t in times))
    found = {}
    for kind, tally in kinds.items():
        found[kind] = {**figures(tally), "models": by_model(tally)}
        truth, boxes, _ = tally.pairs
        if len(truth) and truth.shape[1] == 7:
            own = along_and_across(truth, boxes)
            right = repaired(truth, boxes)
            found[kind]["set_right"] = {what: {"bev_iou": iou, "ate_m": ate} for what, iou, ate in right}
            found[kind]["along_across_m"] = {"mean": own.mean(axis=0).tolist(), "sd": own.std(axis=0).tolist()}
    return found


def lines(name: str, found: Mapping[str, Row]) -> list[str]:
    """A table for a person."""
    columns = ("of", "model", "found", "recall", "precision", "BEV IoU", "ATE m", "AOE °", "sizes over true")
    shown = [f"## {name}", "", f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    for kind, row in found.items():
        models = row["models"]
        assert isinstance(models, list)
        for of in ({"model": "all", **row}, *models):
            shown.append(f"| {kind} | {_cells(of)} |")
    return shown


def _cells(row: Row) -> str:
    def number(name: str, digits: int) -> str:
        value = row.get(name)
        return f"{value:.{digits}f}" if isinstance(value, float) else "–"

    ratio = row.get("size_ratio")
    sizes = ", ".join(f"{r:.2f}" for r in ratio) if isinstance(ratio, list) else "–"
    precision = number("precision", 2) if row["model"] == "all" else "–"
    return " | ".join(
        (
            str(row["model"]), f"{row['found']} of {row['asked']}", number("recall", 2), precision,
            number("bev_iou", 3), number("ate_m", 2), number("aoe_deg", 1), sizes,
        )
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sites", type=Path, nargs="+")
    parser.add_argument("--runs", type=Path, nargs="+", help="outputs of each site, if not in SITE/outputs")
    parser.add_argument("--json", type=Path, help="write all figures there")
    typed = parser.parse_args()
    runs = typed.runs or [site / "outputs" for site in typed.sites]
    every = {}
    for site, run in zip(typed.sites, runs, strict=True):
        every[site.name] = measure(site, latest(SiteFolder.load(site), StageStore(run)))
        print("\n".join(lines(site.name, every[site.name])), flush=True)
    if typed.json:
        typed.json.write_text(json.dumps(every, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
