"""MOTChallenge: per camera a sequence of 2D boxes with identities (Milan et al. 2016, arXiv 1603.00831).

::

    <camera id>/seqinfo.ini
    <camera id>/gt/gt.txt    frame, id, left, top, width, height, 1, class, visibility     boxes with an identity
    <camera id>/det/det.txt  frame, -1, left, top, width, height, score, class, -1, -1     all boxes

Frames and pixels count from 1: the corner of the image is at (1, 1). ``seqinfo.ini`` says the rate, and, for our own
reader, the first instant and the period in ns. The same id in two cameras' sequences is the same vehicle. Visibility
is −1: unknown.
"""

from __future__ import annotations

import configparser
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np

from wibam_core.errors import InputError
from wibam_core.exchange import csv_files
from wibam_core.exchange.base import CAMERA_ID, Content, Part, require_parts
from wibam_core.exchange.boxes import corner_xywh, from_corner_xywh
from wibam_core.exchange.files import read_text, wrong
from wibam_core.exchange.names import classes_by_name
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.scene import AnnotatedInstant, Detections2D, FloatArray, MultiViewVehicle

#: Class numbers of MOT16 and later by COCO's names, table 3 of arXiv 1603.00831: it knows no truck and no bus.
_NUMBERS: Mapping[str, int] = MappingProxyType(
    {"person": 1, "car": 3, "truck": 3, "bus": 3, "bicycle": 4, "motorcycle": 5}
)
#: What a number that says nothing stands for: the benchmark's own detections are of people.
_UNSAID = "person"
#: Left, top, width, height of a box at the corner of the image that has no extent.
_FIRST_PIXEL = np.array([1.0, 1.0, 0.0, 0.0])
_MOST_FRAMES = 1_000_000
#: How far apart a box of ``gt.txt`` and the same box of ``det.txt`` may be: three decimals are written.
_ROUNDED_PX = 1e-3


@dataclass(frozen=True)
class _Sequence:
    """One camera's sequence: frame n, from 1 on, is of the instant ``first_ns + (n - 1) * period_ns``."""

    camera_id: str
    first_ns: int
    period_ns: int
    frames: int


@dataclass(frozen=True)
class _Row:
    frame: int
    identity: int
    bbox: tuple[float, float, float, float]
    confidence: float
    number: int


class MotChallenge:
    """See this module."""

    name = "motchallenge"
    title = "MOTChallenge sequences"
    needs = frozenset({Part.BOXES_2D})
    writes = frozenset({Part.BOXES_2D})
    reads = frozenset({Part.BOXES_2D})
    loses = (
        "3D boxes, places on the ground, the calibration and labels; frames' own times of exposure, since a frame is "
        "an instant; identities of what was seen once only; amodal boxes; and vans, trucks and buses become cars."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """Write three files a camera."""
        require_parts(self, content)
        instants = sorted(content.instants or (), key=lambda instant: instant.time_ns)
        times = np.array([instant.time_ns for instant in instants], np.int64)
        period_ns = int(np.diff(times).min()) if len(times) > 1 else 1_000_000_000
        paths: list[Path] = []
        for camera_id in sorted({camera_id for instant in instants for camera_id in instant.detections}):
            frames = 1 + round((int(times[-1]) - int(times[0])) / period_ns)
            sequence = _Sequence(camera_id, int(times[0]), period_ns, frames)
            identified, seen = _rows(sequence, instants)
            for name, lines in (
                ("seqinfo.ini", _seqinfo(sequence, content.size_px(camera_id))),
                ("gt/gt.txt", [_line(row, 1, -1) for row in identified]),
                ("det/det.txt", [_line(row, row.confidence, -1, -1) for row in seen]),
            ):
                path = folder / camera_id / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
                paths.append(path)
        return paths

    def read(self, path: Path) -> Content:
        """Read the folder of one sequence, or one that holds several.

        A box of ``gt.txt`` is the same box of ``det.txt`` with an identity, or one of its own with score 1. Entries
        that the benchmark ignores, and classes that are no road users of ours, are left out, and noted.
        """
        folders = [path] if (path / "seqinfo.ini").is_file() else sorted(p.parent for p in path.glob("*/seqinfo.ini"))
        if not folders:
            raise InputError(
                f"{path.name} holds no MOTChallenge sequence",
                hint="Give the folder with a seqinfo.ini, or the one above several such folders.",
            )
        left_out: Counter[str] = Counter()
        detections: dict[int, dict[str, Detections2D]] = {}
        identities: dict[int, dict[str, dict[int, int]]] = {}
        for folder in folders:
            sequence = _read_seqinfo(folder)
            for time_ns, seen, ids in _read_sequence(folder, sequence, left_out):
                detections.setdefault(time_ns, {})[sequence.camera_id] = seen
                identities.setdefault(time_ns, {})[sequence.camera_id] = ids
        return Content(
            instants=[
                AnnotatedInstant(time_ns, detections[time_ns], _vehicles(detections[time_ns], identities[time_ns]))
                for time_ns in sorted(detections)
            ],
            notes=tuple(f"{n} boxes of {what} were left out" for what, n in sorted(left_out.items())),
        )


def _number(c: RoadUserClass) -> int:
    name = c.traits.elsewhere.coco.written
    return -1 if name is None else _NUMBERS.get(name, -1)


def _rows(sequence: _Sequence, instants: Iterable[AnnotatedInstant]) -> tuple[list[_Row], list[_Row]]:
    """Boxes of a camera that have an identity, and all of them."""
    identified, seen = [], []
    for instant in instants:
        found = instant.detections.get(sequence.camera_id)
        if found is None:
            continue
        frame = 1 + round((instant.time_ns - sequence.first_ns) / sequence.period_ns)
        owners = {vehicle.views.get(sequence.camera_id): vehicle for vehicle in instant.vehicles}
        for i, (left, top, width, height) in enumerate((corner_xywh(found.boxes) + _FIRST_PIXEL).tolist()):
            row = _Row(
                frame, -1, (left, top, width, height), float(found.scores[i]), _number(CLASSES[found.classes[i]])
            )
            seen.append(row)
            owner = owners.get(i)
            if owner is not None and owner.track_id >= 0:
                identified.append(
                    _Row(frame, owner.track_id + 1, row.bbox, row.confidence, _number(owner.vehicle_class))
                )
    return sorted(identified, key=lambda row: (row.frame, row.identity)), seen


def _line(row: _Row, confidence: float, *rest: int) -> str:
    box = ",".join(f"{value:.3f}" for value in row.bbox)
    return f"{row.frame},{row.identity},{box},{confidence:g},{row.number},{','.join(map(str, rest))}"


def _seqinfo(sequence: _Sequence, size_px: tuple[int, int]) -> list[str]:
    return [
        "[Sequence]",
        f"name={sequence.camera_id}",
        "imDir=img1",
        f"frameRate={1e9 / sequence.period_ns:g}",
        f"seqLength={sequence.frames}",
        f"imWidth={size_px[0]}",
        f"imHeight={size_px[1]}",
        "imExt=.jpg",
        f"firstTimeNs={sequence.first_ns}",
        f"periodNs={sequence.period_ns}",
    ]


def _read_seqinfo(folder: Path) -> _Sequence:
    path = folder / "seqinfo.ini"
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(read_text(path, 1 << 20))
        said = parser["Sequence"]
        frames = int(said["seqLength"])
        period_ns = int(said["periodNs"]) if "periodNs" in said else round(1e9 / float(said["frameRate"]))
        first_ns = int(said.get("firstTimeNs", "0"))
    except (configparser.Error, KeyError, ValueError, ZeroDivisionError, OverflowError) as error:
        raise wrong(path, "Sequence", f"{error} (frameRate and seqLength are needed, as numbers)") from error
    if not 0 < frames <= _MOST_FRAMES or period_ns <= 0 or abs(first_ns) > 2**62:
        raise wrong(path, "seqLength", f"from 1 to {_MOST_FRAMES} frames are read, at a rate above 0")
    if not CAMERA_ID.fullmatch(folder.name):
        raise wrong(path, "name", f"{folder.name!r} is no camera id", "Name the folder by letters, digits, - and _.")
    return _Sequence(folder.name, first_ns, period_ns, frames)


def _read_rows(path: Path, sequence: _Sequence) -> list[_Row]:
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        try:
            values = csv_files.read_numbers(line)
            row = _Row(
                int(values[0]),
                int(values[1]),
                (values[2], values[3], values[4], values[5]),
                values[6],
                int(values[7]) if len(values) > 7 else -1,
            )
        except (ValueError, IndexError, OverflowError) as error:
            raise wrong(path, f"line {number}", "seven numbers or more with commas between are needed") from error
        if not 1 <= row.frame <= sequence.frames:
            raise wrong(path, f"line {number}", f"frame {row.frame} is not one of the {sequence.frames} of seqinfo.ini")
        if not np.isfinite([*row.bbox, row.confidence]).all() or min(row.bbox[2:]) < 0:
            raise wrong(path, f"line {number}", "a box needs finite numbers, and no negative width or height")
        rows.append(row)
    return rows


def _read_sequence(
    folder: Path, sequence: _Sequence, left_out: Counter[str]
) -> Iterable[tuple[int, Detections2D, dict[int, int]]]:
    """Instant (ns), boxes and track id -> index of its box, frame by frame; counts in ``left_out``."""
    files = {name: folder / name / f"{name}.txt" for name in ("gt", "det")}
    if not any(path.is_file() for path in files.values()):
        raise InputError(f"{folder.name} has neither gt/gt.txt nor det/det.txt", hint="One of them is needed.")
    rows = {name: _read_rows(path, sequence) if path.is_file() else [] for name, path in files.items()}
    ignored = sum(row.confidence == 0 for row in rows["gt"])
    if ignored:
        left_out["kinds that the benchmark ignores"] += ignored
    by_frame: dict[str, dict[int, list[_Row]]] = {"gt": {}, "det": {}}
    for name, of_file in rows.items():
        for row in of_file:
            if name == "gt" and row.confidence == 0:
                continue
            if _class_of(row.number) is None:
                left_out[f"class {row.number}"] += 1
            else:
                by_frame[name].setdefault(row.frame, []).append(row)
    for frame in range(1, sequence.frames + 1):
        time_ns = sequence.first_ns + (frame - 1) * sequence.period_ns
        yield time_ns, *_frame(sequence, time_ns, by_frame["gt"].get(frame, []), by_frame["det"].get(frame, []))


@cache
def _class_of(number: int) -> RoadUserClass | None:
    """The class that a number stands for first; None of what is no road user of ours."""
    names = classes_by_name(lambda names: names.coco)
    if number == -1:
        return names.get(_UNSAID)
    return next((names[name] for name, own in _NUMBERS.items() if own == number and name in names), None)


def _frame(
    sequence: _Sequence, time_ns: int, identified: Sequence[_Row], seen: Sequence[_Row]
) -> tuple[Detections2D, dict[int, int]]:
    rows = list(seen)
    identities: dict[int, int] = {}
    for row in identified:
        near = np.abs(_bboxes(rows) - row.bbox).max(axis=1)
        same = int(near.argmin()) if len(near) and near.min() <= _ROUNDED_PX else len(rows)
        if same == len(rows):
            rows.append(_Row(row.frame, row.identity, row.bbox, 1.0, row.number))
        identities[row.identity - 1] = same
    classes = [c.number for row in rows if (c := _class_of(row.number)) is not None]
    boxes = from_corner_xywh(_bboxes(rows) - _FIRST_PIXEL)
    scores = np.clip([row.confidence for row in rows], 0.0, 1.0)
    return Detections2D(sequence.camera_id, time_ns, boxes, scores, np.array(classes, np.int64)), identities


def _bboxes(rows: Sequence[_Row]) -> FloatArray:
    return np.array([row.bbox for row in rows], dtype=np.float64).reshape(-1, 4)


def _vehicles(
    detections: Mapping[str, Detections2D], identities: Mapping[str, Mapping[int, int]]
) -> tuple[MultiViewVehicle, ...]:
    """What has the same identity in several cameras is one vehicle; where it stands is not known."""
    views: dict[int, dict[str, int]] = {}
    for camera_id, of_camera in identities.items():
        for track_id, index in of_camera.items():
            views.setdefault(track_id, {})[camera_id] = index
    vehicles = []
    for obj_id, track_id in enumerate(sorted(views)):
        votes: Counter[int] = Counter()
        for camera_id, index in views[track_id].items():
            votes[int(detections[camera_id].classes[index])] += 1
        vehicle_class = CLASSES[votes.most_common(1)[0][0]]
        vehicles.append(MultiViewVehicle(obj_id, track_id, vehicle_class, np.nan, np.nan, views[track_id]))
    return tuple(vehicles)
