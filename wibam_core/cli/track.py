"""`wibam track`: 7DoF tracks from one recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.progress import track as show_progress
from rich.table import Table

from wibam_core.config import TrackConfig
from wibam_core.documents.recordings import VideoInfo
from wibam_core.errors import CalibrationError, MissingCamera
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.formats.rig import read_rig
from wibam_core.formats.tracks import write_tracks
from wibam_core.geometry.box3d import SIZE, XY
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.cut_view import CutView
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import family_of, load_to_detect
from wibam_core.scene import Track
from wibam_core.tracking.recording import track_recording
from wibam_core.tracking.uncalibrated import nominal_camera
from wibam_core.video.decode import frames_nearest
from wibam_core.video.probe import probe
from wibam_core.video.sampling import Span, multiples_within

#: Aspect ratios of calibration and recording may differ by rounding alone.
_MAX_ASPECT_DIFFERENCE = 0.01


def track(
    video: Annotated[Path, typer.Argument(help="A recording.")],
    out: Annotated[Path, typer.Option(help="Where the tracks go, as Parquet.")] = Path("tracks.parquet"),
    calibration: Annotated[
        Path | None, typer.Option(help="A rig.json, as the calibrate stage writes it. Without it metres are nominal.")
    ] = None,
    camera: Annotated[str | None, typer.Option(help="Which camera of the rig. Default: its first.")] = None,
    weights: Annotated[
        Path | None,
        typer.Option(
            help="A fine-tuned model (safetensors or ONNX), or what `wibam weights convert` wrote. Default: the "
            "bundled model."
        ),
    ] = None,
    horizon: Annotated[float | None, typer.Option(help="Without a calibration: the horizon's row, px.")] = None,
    rate: Annotated[float, typer.Option(help="Frames per second that are tracked on.", min=0.1, max=120.0)] = 6.25,
    min_score: Annotated[float, typer.Option(help="Weaker detections are left out.", min=0.01, max=0.99)] = 0.3,
) -> None:
    """Track vehicles in one camera's recording, on the ground."""
    console = Console()
    info = probe(video)
    views: tuple[CutView, ...] = ()
    if calibration is None:
        console.print(
            "[yellow]uncalibrated[/]: the camera is a guess (6 m high, 58° wide), so that metres are nominal. "
            "Give --calibration for real ones.",
            highlight=False,
        )
        seen_by = nominal_camera(info.width_px, info.height_px, horizon_px=horizon)
    else:
        seen_by, views = _calibrated(calibration, camera, info)
    network = load_to_detect(weights or bundled("mono_small.safetensors"), torch.device("cpu"))
    card = network.card
    if weights is None and calibration is not None:  # edges tell where a vehicle is if it is known whence they are seen
        card = card.model_copy(update={"decode": "refined"})
    if card.licence is not None:
        console.print(f"[yellow]{escape(card.licence)}[/]", highlight=False)
    advice = family_of(card.family).advice
    if advice is not None:
        console.print(advice, highlight=False)
    config = TrackConfig(rate_hz=rate, min_score=min_score)
    images = _images(video, info, rate, console)
    tracks = track_recording(
        network, images, seen_by, config, decode=card.decode, factors=SdFactors(**card.sd_factors), views=views
    )
    write_tracks(out, tracks)
    console.print(_table(tracks, "nominal m" if calibration is None else "m"))
    console.print(f"{len(tracks)} tracks: [bold]{out}[/]", highlight=False)


def _calibrated(path: Path, camera_id: str | None, info: VideoInfo) -> tuple[Camera, tuple[CutView, ...]]:
    """The camera, and, where its lens is wide, the views to cut from its pictures."""
    rig = read_rig(path)
    chosen = camera_id or rig.reference_id
    if chosen not in rig.mounted:
        raise MissingCamera(f"{path.name} has no camera {chosen}", hint=f"It has {', '.join(rig.mounted)}.")
    camera = rig.mounted[chosen]
    if abs(camera.width_px / camera.height_px * info.height_px / info.width_px - 1) > _MAX_ASPECT_DIFFERENCE:
        raise CalibrationError(
            f"camera {chosen} was calibrated at {camera.width_px}x{camera.height_px} px, but the recording has "
            f"{info.width_px}x{info.height_px} px",
            hint="Use the calibration of this recording's aspect ratio.",
        )
    return camera, rig.views.get(chosen, ())


def _images(video: Path, info: VideoInfo, rate: float, console: Console) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Frames nearest to each multiple of the period, each once, with their own times."""
    targets = [int(t) + info.first_ns for t in multiples_within(Span(0, info.last_ns - info.first_ns), rate)]
    nearest = frames_nearest(video, targets, tolerance_ns=int(0.5e9 / min(rate, info.fps)))
    last = None
    for frame in show_progress(
        nearest, "Tracking", total=len(targets), console=console, disable=not console.is_terminal
    ):
        if frame.time_ns != last:
            yield frame.time_ns, frame.image_bgr
            last = frame.time_ns


def _table(tracks: list[Track], metre: str) -> Table:
    table = Table("track", "class", "from s", "to s", f"path {metre}", f"size {metre}")
    for found in tracks:
        path = float(np.linalg.norm(np.diff(found.boxes[:, XY], axis=0), axis=1).sum())
        size = " x ".join(f"{side:.1f}" for side in found.boxes[0, SIZE])
        start, end = found.times_ns[[0, -1]] * 1e-9
        table.add_row(str(found.track_id), found.vehicle_class.value, f"{start:.1f}", f"{end:.1f}", f"{path:.1f}", size)
    return table
