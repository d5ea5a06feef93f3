"""Hand labels of a real site, and what of a result they can judge.

Labels stand for single instants and for an area in which every vehicle was labelled. What lies outside of it, close to
its border or on what was left out on purpose (a towed trailer) counts neither way. They evaluate, and choose nothing
within a run; what was chosen with them in sight is in ``looks.json``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.evaluation.matching import assign
from wibam_core.geometry.box3d import LENGTH, WIDTH, XY, YAW
from wibam_core.geometry.iou import bev_iou_paired
from wibam_core.geometry.se3 import normalise_angle

Array = NDArray[np.float64]

#: A vehicle is found if a box lies nearer than this to its centre, m.
MATCH_M = 2.0
#: Boxes whose centre is this close to the border of the labelled area count neither way, m.
BORDER_M = 0.5
#: So much is added to each side of what is to be ignored, m.
_IGNORED_MARGIN_M = 0.6
#: Labels of a vehicle that a camera sees less of than this are not asked of it.
LEAST_VISIBLE = 0.3


@dataclass(frozen=True, eq=False)
class Labels:
    """The vehicles of one labelled instant.

    Attributes:
        time_ns: when.
        vehicle_ids: (N,) of vehicles, the same over time.
        boxes: (N, 7). velocities_mps: (N, 2), zero where nothing is known.
        visibility: camera id -> (N,) share that it sees.
        ignored: (K, 5) x, y, length, width, yaw of what counts neither way.
    """

    time_ns: int
    vehicle_ids: tuple[str, ...]
    boxes: Array
    velocities_mps: Array
    visibility: Mapping[str, Array]
    ignored: Array

    def at(self, time_ns: int) -> Array:
        """Boxes (N, 7) where the vehicles are a little before or after the instant."""
        moved = self.boxes.copy()
        moved[:, XY] += self.velocities_mps * (time_ns - self.time_ns) * 1e-9
        return moved


@dataclass(frozen=True, eq=False)
class Area:
    """Where every vehicle was labelled: corners (M, 2) of a convex or simple polygon, m."""

    corners: Array

    def border_m(self, places: Array) -> Array:
        """Distance (N,) of places (N, 2) from the border, positive inside."""
        start, end = self.corners, np.roll(self.corners, -1, axis=0)
        along = end - start
        share = ((places[:, None] - start) * along).sum(axis=-1) / (along**2).sum(axis=-1)
        nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
        distance = np.linalg.norm(places[:, None] - nearest, axis=-1).min(axis=1)
        x, y = places[:, None, 0], places[:, None, 1]
        crosses = (start[:, 1] > y) != (end[:, 1] > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            reached = start[:, 0] + (y - start[:, 1]) * along[:, 0] / along[:, 1]
        inside = (crosses & (x < reached)).sum(axis=1) % 2 == 1
        return np.where(inside, distance, -distance)


@dataclass(frozen=True, eq=False)
class Judged:
    """What a set of boxes got right at one instant, of one camera or of all.

    Attributes:
        asked: ids of the vehicles that count. found: (F,) of these, with the errors of each: centre distance (m),
            heading (deg), overlap of footprints.
        pairs: (F, 2, 7) of each the label, moved to the time of the boxes, and the box.
        further: (K, 7) boxes that are no vehicle.
    """

    asked: tuple[str, ...]
    found: tuple[str, ...]
    ate_m: Array
    aoe_deg: Array
    bev_iou: Array
    pairs: Array
    further: Array

    @property
    def false(self) -> int:
        """How many boxes are no vehicle."""
        return len(self.further)


def read_labels(labels: Path, ignored: Mapping[int, Array]) -> list[Labels]:
    """Labels of a JSON file by instant: a list of objects with ``time_ns``, ``vehicle_id``, ``x_m``, ``y_m``, sizes,
    ``yaw_rad``, ``visibility`` and, where they are known, ``vx_mps`` and ``vy_mps``."""
    rows = json.loads(labels.read_text(encoding="utf-8"))
    found = []
    for time_ns in sorted({row["time_ns"] for row in rows}):
        of = [row for row in rows if row["time_ns"] == time_ns]
        boxes = [
            [
                row["x_m"],
                row["y_m"],
                row["height_m"] / 2,
                row["length_m"],
                row["width_m"],
                row["height_m"],
                row["yaw_rad"],
            ]
            for row in of
        ]
        cameras = sorted({camera for row in of for camera in row["visibility"]})
        found.append(
            Labels(
                time_ns,
                tuple(str(row["vehicle_id"]) for row in of),
                np.array(boxes, dtype=np.float64),
                np.array([[row.get("vx_mps", 0.0), row.get("vy_mps", 0.0)] for row in of], dtype=np.float64),
                {camera: np.array([row["visibility"].get(camera, 0.0) for row in of]) for camera in cameras},
                ignored.get(time_ns, np.empty((0, 5))),
            )
        )
    return found


def read_area(path: Path) -> tuple[Area, dict[int, Array]]:
    """The labelled area of a JSON file (``polygon_m``), and what is to be ignored at which instant (``ignore``)."""
    content = json.loads(path.read_text(encoding="utf-8"))
    ignored: dict[int, list[list[float]]] = {}
    for one in content.get("ignore", []):
        names = ("x_m", "y_m", "length_m", "width_m", "yaw_rad")
        ignored.setdefault(int(one["time_ns"]), []).append([float(one[name]) for name in names])
    return Area(np.array(content["polygon_m"], dtype=np.float64)), {
        time_ns: np.array(rows) for time_ns, rows in ignored.items()
    }


def judge(
    labels: Labels, area: Area, boxes: Array, time_ns: int | None = None, counts: NDArray[np.bool_] | None = None
) -> Judged:
    """Compare boxes with the labels of an instant.

    Args:
        labels: of the instant.
        area: vehicles whose centre is inside are asked for; boxes inside are held against what found them.
        boxes: (N, 7) of one time.
        time_ns: that time; None: the instant itself.
        counts: (labels,) which vehicles may be asked for, beside lying in the area; None: all. Others take part in the
            comparison, so that what found them is not false.
    """
    truth = labels.at(labels.time_ns if time_ns is None else time_ns)
    asked = area.border_m(labels.boxes[:, XY]) >= 0
    if counts is not None:
        asked &= counts
    distance = np.linalg.norm(truth[:, None, XY] - boxes[None, :, XY], axis=-1)
    rows, columns = assign(distance, MATCH_M)
    own = asked[rows]
    matched_truth, matched = truth[rows[own]], boxes[columns[own]]
    left = np.ones(len(boxes), dtype=bool)
    left[columns] = False
    left &= area.border_m(boxes[:, XY]) >= BORDER_M
    left &= ~_on_ignored(labels.ignored, boxes)
    if counts is not None:  # whoever is not asked for excuses what lies near
        left &= ~(distance[~asked] < MATCH_M).any(axis=0)
    return Judged(
        tuple(name for name, of in zip(labels.vehicle_ids, asked, strict=True) if of),
        tuple(labels.vehicle_ids[row] for row in rows[own]),
        np.linalg.norm(matched_truth[:, XY] - matched[:, XY], axis=1),
        np.degrees(np.abs(normalise_angle(matched_truth[:, YAW] - matched[:, YAW]))),
        bev_iou_paired(matched_truth, matched),
        np.stack([matched_truth, matched], axis=1),
        boxes[left],
    )


def _on_ignored(ignored: Array, boxes: Array) -> NDArray[np.bool_]:
    """(N,) whether the centre of a box lies on something that counts neither way, or it covers that one's centre."""
    on = np.zeros(len(boxes), dtype=bool)
    for x, y, length, width, yaw in ignored:
        across = _within(boxes[:, XY] - [x, y], np.full(len(boxes), yaw))
        half = np.array([length, width]) / 2 + _IGNORED_MARGIN_M
        on |= (np.abs(across) <= half).all(axis=1)
        covers = _within(np.array([x, y]) - boxes[:, XY], boxes[:, YAW])
        on |= (np.abs(covers) <= boxes[:, [LENGTH, WIDTH]] / 2).all(axis=1)
    return on


def _within(offset: Array, yaw: Array) -> Array:
    """Offsets (N, 2) along and across headings (N,)."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]], axis=1)


def figures(judged: Sequence[Judged], seed: int = 0) -> dict[str, object]:
    """Counts, means and 95 % intervals of what was judged.

    Shares have Wilson's interval; means one of 2,000 bootstrap samples of vehicles, since the sightings of one vehicle
    err alike.
    """
    asked = sum(len(one.asked) for one in judged)
    found = [name for one in judged for name in one.found]
    false = sum(one.false for one in judged)
    result: dict[str, object] = {
        "asked": asked,
        "found": len(found),
        "false": false,
        "vehicles": len({name for one in judged for name in one.asked}),
        "recall": _share(len(found), asked),
        "recall_interval": wilson(len(found), asked),
        "precision": _share(len(found), len(found) + false),
        "precision_interval": wilson(len(found), len(found) + false),
    }
    for name in ("ate_m", "aoe_deg", "bev_iou"):
        values = np.concatenate([np.empty(0), *(getattr(one, name) for one in judged)])
        result[name] = float(values.mean()) if len(values) else None
        result[f"{name}_median"] = float(np.median(values)) if len(values) else None
        result[f"{name}_interval"] = bootstrap(values, found, seed)
    return result | _without_shared_shift(judged)


def _without_shared_shift(judged: Sequence[Judged]) -> dict[str, object]:
    """By how much all boxes that found a vehicle lie beside the labels together, m, and the errors without that.

    The shift is the mean over the same vehicles: cameras that see each other's vehicles cannot tell it, and labels are
    no surer of it than their own common frame is.
    """
    pairs = np.concatenate([np.empty((0, 2, 7)), *(one.pairs for one in judged)])
    if len(pairs) < 2:
        return {"shift_m": None, "ate_m_unshifted": None, "bev_iou_unshifted": None}
    labels, boxes = pairs[:, 0], pairs[:, 1].copy()
    shift = (boxes - labels)[:, XY].mean(axis=0)
    boxes[:, XY] -= shift
    return {
        "shift_m": shift.tolist(),
        "ate_m_unshifted": float(np.linalg.norm((boxes - labels)[:, XY], axis=1).mean()),
        "bev_iou_unshifted": float(bev_iou_paired(labels, boxes).mean()),
    }


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def wilson(part: int, whole: int, z: float = 1.96) -> tuple[float, float] | None:
    """Wilson's 95 % interval of a share; None of nothing."""
    if not whole:
        return None
    share = part / whole
    middle = (share + z**2 / (2 * whole)) / (1 + z**2 / whole)
    half = z / (1 + z**2 / whole) * float(np.sqrt(share * (1 - share) / whole + z**2 / (4 * whole**2)))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def bootstrap(values: Array, groups: Sequence[str], seed: int, samples: int = 2000) -> tuple[float, float] | None:
    """95 % interval of the mean of values (N,), drawing whole groups (N,); None below two groups."""
    names = sorted(set(groups))
    if len(names) < 2:
        return None
    of = np.array([names.index(name) for name in groups])
    sums, counts = np.bincount(of, values, len(names)), np.bincount(of, minlength=len(names))
    drawn = np.random.default_rng(seed).integers(0, len(names), (samples, len(names)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)
