"""How far headings in single images lie off those of the tracks of all cameras, by how steeply a vehicle is seen.

Hand labels are few: whether they include a sighting that is turned round decides on their mean. The headings of tracks
of all cameras are known at every instant, and err little at a real site (`benchmarks.real_sites`), so that they stand
in for labels here. What errs together in single images and in tracks is not seen.

Run: python -m benchmarks.real_headings SITE --area AREA.json --runs build/real [--min-score 0.3] [--before]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.real_labels import MATCH_M, Area, read_area
from benchmarks.real_measures import ONE_CAMERA_M, tracks_at
from wibam_core.artifacts.catalogue import FRAMES, PREDICTIONS, PREDICTIONS_BASELINE, RIG, TRACKS
from wibam_core.evaluation.matching import assign
from wibam_core.geometry.box3d import XY, YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.scene import CameraRig, Track, Vehicles3D
from wibam_core.stages.runner import SiteFolder, latest
from wibam_core.stages.store import StageStore

Array = NDArray[np.float64]

#: Bounds of the groups: how far below the horizon a vehicle is seen, deg.
_STEEP_DEG = (0.0, 20.0, 30.0, 40.0, 50.0, 90.0)


def sightings(found: Iterable[Vehicles3D], tracks: Sequence[Track], rig: CameraRig, area: Area) -> Iterator[Array]:
    """Of each image (N, 2): how steeply each vehicle is seen whose track is matched, and the heading's error, deg.

    Args:
        found: boxes in single images.
        tracks: of all cameras.
        rig: the cameras.
        area: vehicles outside of it are left out.
    """
    for one in found:
        camera = rig[str(one.camera_id)]
        truth = tracks_at(tracks, one.time_ns)
        away_m = np.linalg.norm(truth[:, XY] - camera.centre_m[:2], axis=1)
        counts = (away_m <= ONE_CAMERA_M) & (area.border_m(truth[:, XY]) >= 0)
        rows, columns = assign(np.linalg.norm(truth[:, None, XY] - one.boxes[None, :, XY], axis=-1), MATCH_M)
        rows, columns = rows[counts[rows]], columns[counts[rows]]
        error = np.abs(normalise_angle(one.boxes[columns, YAW] - truth[rows, YAW]))
        steep = np.arctan2(camera.centre_m[2], away_m[rows])
        yield np.degrees(np.stack([steep, error], axis=1))


def document(seen: Array) -> str:
    """Markdown of sightings (N, 2) as `sightings` gives them."""
    lines = [
        "| seen from above by | sightings | AOE ° (median) | off by more than 45° | 135° |",
        "|---|---|---|---|---|",
    ]
    groups = [(f"{low:g} to {high:g}°", low, high) for low, high in pairwise(_STEEP_DEG)]
    for name, low, high in [*groups, ("all", 0.0, 90.0)]:
        error = seen[(seen[:, 0] >= low) & (seen[:, 0] < high), 1]
        if len(error):
            lines.append(
                f"| {name} | {len(error)} | {error.mean():.1f} ({np.median(error):.1f}) | {(error > 45).mean():.3f} "
                f"| {(error > 135).mean():.3f} |"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", type=Path)
    parser.add_argument("--area", type=Path, required=True, help="JSON, as for benchmarks.real_sites")
    parser.add_argument("--runs", type=Path, default=Path("build/real"), help="outputs of the last run are measured")
    parser.add_argument("--min-score", type=float, default=0.3)
    parser.add_argument(
        "--before", action="store_true", help="of the network before fine-tuning, in images of the test part"
    )
    arguments = parser.parse_args()
    outputs = latest(SiteFolder.load(arguments.site), StageStore(arguments.runs))
    every: Iterable[Vehicles3D]
    if arguments.before:
        every = outputs.read(PREDICTIONS_BASELINE)
    else:
        times_ns = [instant.time_ns for instant in outputs.read(FRAMES).frame_sets]
        every = (of for _, found in outputs.read(PREDICTIONS).at(times_ns) for of in found.values())
    strong = (of.where(of.scores >= arguments.min_score) for of in every)
    area, _ = read_area(arguments.area)
    print(document(np.concatenate(list(sightings(strong, outputs.read(TRACKS), outputs.read(RIG), area)))))


if __name__ == "__main__":
    main()
