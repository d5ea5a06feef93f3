"""`wibam detect`: 2D vehicles in one recording."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from wibam_core.detection.boxes import Found
from wibam_core.detection.detector import BUNDLED, load_detector
from wibam_core.documents.recordings import VideoInfo
from wibam_core.road_users import CLASSES
from wibam_core.video.decode import frames_nearest
from wibam_core.video.probe import probe
from wibam_core.video.sampling import Span, multiples_within


def detect(
    video: Annotated[Path, typer.Argument(help="A recording.")],
    out: Annotated[Path, typer.Option(help="Where the boxes go, as JSON.")] = Path("boxes.json"),
    detector: Annotated[
        Path | None, typer.Option(help="An ONNX detector of the YOLOX family. Default: the bundled one.")
    ] = None,
    rate: Annotated[float, typer.Option(help="Frames per second that are looked at.", min=0.001, max=1000.0)] = 2.0,
    min_score: Annotated[float, typer.Option(help="Weaker boxes are left out.", min=0.01, max=0.99)] = 0.2,
    nms_iou: Annotated[
        float, typer.Option(help="Of two boxes that overlap more, one is left out.", min=0, max=1)
    ] = 0.6,
    threads: Annotated[int, typer.Option(help="CPU threads.", min=1)] = 2,
) -> None:
    """Detect vehicles in a recording: a list of frames with their boxes in px of the recording."""
    console = Console()
    network = load_detector(detector or BUNDLED, min_score=min_score, nms_iou=nms_iou, threads=threads)
    info = probe(video)
    targets = _targets_ns(info, rate)
    nearest = frames_nearest(video, targets, tolerance_ns=int(0.5e9 / min(rate, info.fps)), threads=threads)
    frames: dict[int, Found] = {}
    for frame in track(nearest, "Detecting", total=len(targets), console=console, disable=not console.is_terminal):
        if frame.time_ns not in frames:
            frames[frame.time_ns] = network.detect(frame.image_bgr)
    document = [_to_json(time_ns, found) for time_ns, found in frames.items()]
    out.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    console.print(_table(frames))
    empty = sum(1 for found in frames.values() if not len(found.boxes))
    console.print(f"{len(frames)} frames, {empty} of them without a vehicle: [bold]{out}[/]", highlight=False)


def _targets_ns(info: VideoInfo, rate: float) -> list[int]:
    """Multiples of the period from the first frame on."""
    relative = multiples_within(Span(0, info.last_ns - info.first_ns), rate)
    return [int(time_ns) + info.first_ns for time_ns in relative]


def _to_json(time_ns: int, found: Found) -> dict[str, Any]:
    return {
        "time_ns": time_ns,
        "time_s": time_ns / 1e9,
        "boxes": [
            {"xyxy_px": [round(v, 2) for v in box], "class": CLASSES[number].value, "score": round(score, 4)}
            for box, score, number in zip(
                found.boxes.tolist(), found.scores.tolist(), found.classes.tolist(), strict=True
            )
        ],
    }


def _table(frames: dict[int, Found]) -> Table:
    boxes: Counter[str] = Counter()
    scores: Counter[str] = Counter()
    seen: Counter[str] = Counter()
    for found in frames.values():
        names = [CLASSES[number].value for number in found.classes]
        boxes.update(names)
        seen.update(set(names))
        for name, score in zip(names, found.scores.tolist(), strict=True):
            scores[name] += score
    table = Table("class", "boxes", "in frames", "mean score")
    for vehicle in CLASSES:
        if boxes[vehicle]:
            mean = scores[vehicle] / boxes[vehicle]
            table.add_row(vehicle.value, str(boxes[vehicle]), str(seen[vehicle]), f"{mean:.2f}")
    return table
