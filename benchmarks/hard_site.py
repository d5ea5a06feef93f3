"""One site that has it all, over HTTP: a map grid, fisheyes, chapters, a fixed cycle, minutes between starts.

Simulated with its truth: coordinates are those of a UTM zone, all lenses are fisheyes, the signals run a fixed cycle
(so that they fit again and again), the first camera was started five minutes before the others, and saves one picture a
second until then, and the second camera's recording comes in two chapters. The site is uploaded to a service over HTTP
as a user would upload it, a job makes tracks of it, and what comes out is compared with the truth.

Run: python -m benchmarks.hard_site FOLDER [--shared SECONDS] [--size WIDTH HEIGHT] [--set stage.option=value ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from wibam_core.artifacts.catalogue import CLOCKS, TRACKS
from wibam_core.cli.embedded import EmbeddedService
from wibam_core.cli.run import parse_options
from wibam_core.cli.service import watch
from wibam_core.cli.upload import send_site
from wibam_core.client import JobView, WibamClient
from wibam_core.formats.clocks import Clocks
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import Track, site_camera
from wibam_core.site import Site, SiteCamera, ViewDirection
from wibam_core.stages.runner import SiteFolder
from wibam_core.synthetic.clocks import CameraClock
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import CameraJob, plan_recordings, record_camera

Array = NDArray[np.float64]

_NS_PER_S = 1_000_000_000
#: Where the intersection lies in its UTM zone, m.
GRID_M = np.array([691_234.5, 5_334_567.25, 0.0])
APART_S = 300.0
FPS = 8.0
#: Tracks are looked for within this distance of the middle of the intersection, and are right within that of a vehicle.
WITHIN_M, RIGHT_M = 25.0, 2.0
#: Options that make a short story of it.
QUICK = ("rounds.most=0", "finetune.steps=60", "frames.rate_hz=8", "detect.rate_hz=4", "track.rate_hz=4")


def plan_hard(folder: Path, options: SimulationOptions, shared_s: float) -> list[CameraJob]:
    """What each camera films; the second one in two chapters, as GoPro's cameras call them."""
    recordings = folder / "recordings"
    planned = []
    for number, job in enumerate(plan_recordings(options, recordings)):
        if number == 0:
            alone = job.frame_times_ns < APART_S * _NS_PER_S
            times = np.concatenate([job.frame_times_ns[alone][:: round(FPS)], job.frame_times_ns[~alone]])
            planned.append(replace(job, frame_times_ns=times))
            continue
        times = job.frame_times_ns[job.frame_times_ns < shared_s * _NS_PER_S]
        clock = replace(job.clock, start_s=job.clock.start_s + APART_S)
        job = replace(job, clock=clock, frame_times_ns=times)
        if number == 1:
            planned += _chapters(job, recordings / job.camera_id)
        else:
            planned.append(job)
    return planned


def _chapters(job: CameraJob, folder: Path) -> list[CameraJob]:
    """A recording in two files, each with stamps that begin where the first one's do."""
    folder.mkdir(parents=True)
    at = len(job.frame_times_ns) // 2
    first, second = job.frame_times_ns[:at], job.frame_times_ns[at:]
    gone_ns = int(second[0] - first[0])
    later = CameraClock(job.clock.true_s(gone_ns), job.clock.drift, job.clock.phase_ns)
    return [
        replace(job, frame_times_ns=first, path=folder / "GX010042.MP4"),
        replace(job, clock=later, frame_times_ns=second - gone_ns, path=folder / "GX020042.MP4"),
    ]


def record_hard(folder: Path, options: SimulationOptions, shared_s: float) -> list[CameraJob]:
    """Render all recordings and describe the site; returns what each file shows."""
    folder.mkdir(parents=True)
    (folder / "recordings").mkdir()
    jobs = plan_hard(folder, options, shared_s)
    described: dict[str, SiteCamera] = {}
    for job in jobs:
        truth = record_camera(job, lambda share: None)
        in_grid = SE3(job.camera.T_world_cam.rotation, job.camera.T_world_cam.translation + GRID_M)
        camera = site_camera(job.camera_id, replace(job.camera, T_world_cam=in_grid), truth.signals)
        described[job.camera_id] = camera.model_copy(update={"views": (_towards_middle(job.camera),)})
    site = Site(name="Hard intersection", cameras=tuple(described.values()))
    (folder / "site.json").write_text(site.model_dump_json(indent=1), encoding="utf-8")
    return jobs


def _towards_middle(camera: Camera) -> ViewDirection:
    x, y, height = camera.centre_m
    down = np.degrees(np.arctan2(height, np.hypot(x, y)))
    azimuth = np.degrees(np.arctan2(-y, -x))
    return ViewDirection(azimuth_deg=float(azimuth), down_deg=float(down), across_deg=100, height_deg=70)


def clock_errors_s(found: Clocks, jobs: Sequence[CameraJob]) -> dict[str, float]:
    """By how much each camera's mapped time errs in the middle of its recording, s."""
    reference = jobs[0].clock
    errors = {}
    for job in {job.camera_id: job for job in reversed(jobs)}.values():
        local_ns = int(job.frame_times_ns.mean())
        true_ns = reference.local_ns(job.clock.true_s(local_ns))
        errors[job.camera_id] = (int(found.maps[job.camera_id].to_reference_ns(local_ns)) - true_ns) / 1e9
    return dict(sorted(errors.items()))


def judge_tracks(tracks: Sequence[Track], jobs: Sequence[CameraJob], shared_s: float) -> tuple[int, int, int, Array]:
    """Once a second: vehicles that are there, those that a track found, tracks that are none; and the errors, m."""
    reference, traffic = jobs[0].clock, jobs[0].traffic
    there = found = further = 0
    errors: list[float] = []
    for second in np.arange(APART_S + 5.0, APART_S + shared_s - 3.0):
        boxes = traffic.at(reference.true_s(round(second * _NS_PER_S)))[1]
        true = boxes[np.hypot(*boxes[:, :2].T) <= WITHIN_M, :2]
        at = [_place(track, round(second * _NS_PER_S)) for track in tracks]
        seen = np.array([place for place in at if place is not None and np.hypot(*place) <= WITHIN_M]).reshape(-1, 2)
        apart = np.linalg.norm(true[:, None] - seen[None], axis=-1)
        right = apart.min(axis=1, initial=np.inf) <= RIGHT_M
        there, found = there + len(true), found + int(right.sum())
        further += int(
            (np.linalg.norm(seen[:, None] - boxes[None, :, :2], axis=-1).min(axis=1, initial=np.inf) > RIGHT_M).sum()
        )
        errors += apart.min(axis=1, initial=np.inf)[right].tolist()
    return there, found, further, np.array(errors)


def _place(track: Track, time_ns: int) -> Array | None:
    """Where a track is at a time, in the intersection's own metres."""
    if not track.times_ns[0] <= time_ns <= track.times_ns[-1]:
        return None
    return np.array([np.interp(time_ns, track.times_ns, track.boxes[:, axis]) - GRID_M[axis] for axis in (0, 1)])


def run_over_http(folder: Path, data: Path, options: Sequence[str], console: Console) -> JobView:
    """Upload the site, run a job to its tracks, and fetch clocks and tracks into the folder."""
    with EmbeddedService(data) as service, WibamClient(service.url, service.token) as client:
        site_id = send_site(client, SiteFolder.load(folder), console)
        job = watch(client, client.create_job(site_id, parse_options(list(options))).id, console, service.check)
        for artifact in (CLOCKS, TRACKS):
            client.download_artifact(job.id, artifact.id, folder / artifact.file)
    return job


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shared", type=float, default=36.0, help="seconds that all cameras film")
    parser.add_argument("--size", type=int, nargs=2, default=(640, 360))
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--set", dest="options", action="append", default=[])
    given = parser.parse_args()
    simulated = SimulationOptions(
        seed=given.seed,
        cameras=3,
        seconds=APART_S + given.shared,
        fps=FPS,
        width_px=given.size[0],
        height_px=given.size[1],
        lens="fisheye",
        traffic_density=1.5,
    )
    console = Console()
    jobs = record_hard(given.folder / "site", simulated, given.shared)
    job = run_over_http(given.folder / "site", given.folder / "data", [*QUICK, *given.options], console)
    for stage in job.stages:
        for warning in stage.warnings:
            console.print(f"{warning.stage}: {warning.code}: {warning.message}", highlight=False)
    for camera_id, error_s in clock_errors_s(CLOCKS.codec.read(given.folder / "site" / CLOCKS.file), jobs).items():
        console.print(f"clock of {camera_id}: off by {1000 * error_s:.0f} ms", highlight=False)
    tracks = TRACKS.codec.read(given.folder / "site" / TRACKS.file)
    there, found, further, errors = judge_tracks(tracks, jobs, given.shared)
    console.print(
        f"{len(tracks)} tracks; of {there} vehicles within {WITHIN_M:.0f} m, counted once a second, {found} found "
        f"(median {np.median(errors) if len(errors) else np.nan:.2f} m off), {further} further",
        highlight=False,
    )


if __name__ == "__main__":
    main()
