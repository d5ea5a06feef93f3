"""`wibam calibration`: files of other programs into a site's description."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from wibam_core.calibration.foreign.registry import read_file
from wibam_core.calibration.foreign.to_site import chosen, describe
from wibam_core.calibration.rig import solve_camera
from wibam_core.config import CalibrateConfig
from wibam_core.errors import InputError
from wibam_core.site import Site
from wibam_core.stages.recording_files import check_elsewhere, find_recording
from wibam_core.text import decode_text
from wibam_core.video.probe import probe


def calibration(
    site_dir: Annotated[Path, typer.Argument(help="The site folder; its site.json is made or changed.")],
    camera: Annotated[str, typer.Argument(help="The camera's id.")],
    files: Annotated[
        list[Path],
        typer.Argument(
            help="A lens, a pose or surveyed points: OpenCV YAML, JSON or XML, Kalibr, COLMAP, TUMTraf, MATLAB (JSON, "
            ".mat), QGIS .points, OpenDroneMap, GeoJSON."
        ),
    ],
    name: Annotated[
        list[str] | None, typer.Option(help="What a file with several cameras calls this one. Default: its id.")
    ] = None,
) -> None:
    """Read a camera's calibration from files of other programs into site.json."""
    console = Console()
    path = site_dir / "site.json"
    site = Site.load(path) if path.is_file() else None
    before = None if site is None else next((one for one in site.cameras if one.id == camera), None)
    found = []
    for file in files:
        form, cameras = read_file(file)
        found.append(chosen(cameras, [camera, *(name or [])], file.name))
        console.print(escape(f"{file.name}: {form}"), highlight=False, soft_wrap=True)
    size_px = _size_px(site_dir, camera, () if before is None else before.recordings) or (
        None if before is None else (before.width_px, before.height_px)
    )
    size_px = size_px or next((one.intrinsics.size_px for one in found if one.intrinsics is not None), None)
    if size_px is None:
        check_elsewhere(site_dir / "recordings", camera)
        raise InputError(
            f"the size of camera {camera}'s pictures is not known",
            hint=f"Put its recording into {site_dir / 'recordings'}, named {camera} with any ending.",
        )
    described = describe(camera, found, size_px, before, None if site is None else site.origin)
    solved = solve_camera(described.camera, CalibrateConfig())
    document: dict[str, Any] = {"name": site_dir.resolve().name, "cameras": []}
    if site is not None:
        document = json.loads(decode_text(path.read_bytes()))
    entry = described.camera.model_dump(mode="json", exclude_defaults=True)
    entry["calibration"]["kind"] = described.camera.calibration.kind
    ids = [one["id"] for one in document["cameras"]]
    if camera in ids:
        document["cameras"][ids.index(camera)] = entry
    else:
        document["cameras"].append(entry)
    if described.origin is not None:
        document["origin"] = described.origin.model_dump(mode="json", exclude_none=True)
    text = json.dumps(document, indent=1, ensure_ascii=False)
    Site.parse(text)
    site_dir.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n", encoding="utf-8")
    for note in described.notes:
        console.print(escape(note), highlight=False, soft_wrap=True)
    for caution in solved.cautions:
        console.print(f"[yellow]{escape(caution.message)}[/]. {escape(caution.hint)}", highlight=False, soft_wrap=True)
    x, y, z = solved.camera.centre_m
    fit = "" if solved.median_px is None else f", {len(solved.world)} points off by {solved.median_px:.2f} px (median)"
    kind = described.camera.calibration.kind
    console.print(
        escape(f"{path}: camera {camera}, {kind}, at {x:.2f}, {y:.2f}, {z:.2f} m{fit}"), highlight=False, soft_wrap=True
    )


def _size_px(site_dir: Path, camera: str, listed: Sequence[str]) -> tuple[int, int] | None:
    """That of the camera's recording, where the folder has one; of several files that of the first.

    Raises:
        SiteFileError: it has several that nothing says belong together.
        MissingCamera: a file that the site lists is not there.
    """
    recording = find_recording(site_dir / "recordings", camera, listed)
    if recording is None:
        return None
    info = probe(recording.files[0].path)
    return info.width_px, info.height_px
