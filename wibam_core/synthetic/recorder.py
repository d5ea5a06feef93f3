"""Recordings of a simulated site: real video files, a site description, and the exact truth.

Written into the folder (see `wibam_core.site` for the first two):

- ``site.json``, ``recordings/<camera id>.mp4``
- ``labels.parquet``: true 7DoF boxes with their visibility per camera (`wibam_core.formats.labels`)
- ``truth/options.json``: the options; ``truth/clocks.json``, ``truth/rig.json``: as the stages would find them
- ``truth/changes.json``: list of ``{camera_id, signal_id, time_ns, before, after}``; the time is the true one on that
  camera's own clock, for changes within its recording of heads that its site description names
- ``truth/boxes2d.parquet``: per frame and vehicle in view ``camera_id, time_ns`` (own clock), ``vehicle_id, class``,
  ``visible_x0 .. amodal_y1`` (xyxy px) and ``visibility``
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from wibam_core.calibration.views import views_of_site
from wibam_core.errors import Conflict
from wibam_core.formats.clocks import Clocks, write_clocks
from wibam_core.formats.labels import write_labels
from wibam_core.formats.rig import write_rig
from wibam_core.geometry.camera import Camera
from wibam_core.progress import Progress, part, silent
from wibam_core.scene import CameraRig, LabelledInstant, Vehicles3D, site_camera
from wibam_core.site import SignalRegion, Site
from wibam_core.synthetic.cameras import site_cameras
from wibam_core.synthetic.clocks import CameraClock, frame_count, sample_clock
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.lighting import Lighting, Photometry, develop, sample_lighting, sample_photometry
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.parallel import run_jobs
from wibam_core.synthetic.render import Renderer
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.sumo import simulate_sumo_traffic
from wibam_core.synthetic.traffic import Traffic, simulate_traffic
from wibam_core.synthetic.wide import WideRenderer, with_lens
from wibam_core.video.encode import VideoWriter
from wibam_core.video.sampling import Span, common_instants

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
_NS_PER_S = 1_000_000_000
_VACANT_HINT = "Choose another folder, or overwrite what is there with --force."
_HEIGHTS_M = {"site": (6.0, 10.0), "ego": (1.5, 2.8)}


@dataclass(frozen=True, eq=False)
class CameraJob:
    """All that one camera's recording needs; picklable, and independent of the other cameras."""

    camera_id: str
    camera: Camera
    clock: CameraClock
    frame_times_ns: IntArray
    traffic: Traffic
    lighting: Lighting
    photometry: Photometry
    fps: float
    seed: int
    path: Path


@dataclass(frozen=True, eq=False)
class CameraTruth:
    """What one camera saw: one row per frame and vehicle in view.

    Attributes:
        signals: regions of the signal heads in view, one per phase at most.
        times_ns: (R,) on the camera's own clock. vehicle_ids, classes: (R,).
        visible_boxes, amodal_boxes: (R, 4) xyxy px. visibility: (R,).
    """

    camera_id: str
    signals: tuple[SignalRegion, ...]
    times_ns: IntArray
    vehicle_ids: IntArray
    classes: IntArray
    visible_boxes: Array
    amodal_boxes: Array
    visibility: Array


def record_site(
    folder: Path, options: SimulationOptions, progress: Progress = silent, *, overwrite: bool = False
) -> Site:
    """Simulate a site and write it into ``folder``, which is created.

    Returns:
        the site description, as in ``site.json``.

    Raises:
        Conflict: the folder holds a site or recordings already, and ``overwrite`` is not set. Nothing was written.
    """
    recordings, truth_folder = folder / "recordings", folder / "truth"
    if not overwrite:
        _check_vacant(folder, recordings)
    recordings.mkdir(parents=True, exist_ok=True)
    truth_folder.mkdir(exist_ok=True)
    progress(0.0, "simulating traffic")
    jobs = plan_recordings(options, recordings)
    truths = run_jobs(record_camera, jobs, options.workers, part(progress, 0.05, 0.95))
    progress(0.95, "writing the truth")
    site = Site(
        name=f"Simulated intersection {options.seed}",
        cameras=tuple(
            site_camera(job.camera_id, job.camera, truth.signals) for job, truth in zip(jobs, truths, strict=True)
        ),
    )
    (folder / "site.json").write_text(site.model_dump_json(indent=1) + "\n", encoding="utf-8")
    write_labels(folder / "labels.parquet", _labels(options, jobs, truths))
    _write_truth(truth_folder, options, site, jobs, truths)
    progress(1.0, f"{len(jobs)} recordings")
    return site


def _check_vacant(folder: Path, recordings: Path) -> None:
    if (folder / "site.json").exists():
        raise Conflict(f"{folder} holds a site already", hint=_VACANT_HINT)
    if recordings.exists() and any(recordings.iterdir()):
        raise Conflict(f"{folder} holds recordings already", hint=_VACANT_HINT)


def plan_recordings(options: SimulationOptions, recordings: Path) -> list[CameraJob]:
    """Everything random is drawn here, so that it does not matter which process renders which camera."""
    layout = make_layout(options.seed)
    rng = np.random.default_rng([options.seed, 51])
    program = SignalProgram(cycle_s=options.cycle_s, offset_s=float(rng.uniform(0, options.cycle_s)))
    duration_s = options.seconds + options.max_offset_s + 2.0
    simulate = simulate_sumo_traffic if options.traffic == "sumo" else simulate_traffic
    traffic = simulate(
        layout, options.seed, duration_s, program, density=options.traffic_density, parked=options.parked
    )
    cameras = site_cameras(
        layout,
        np.random.default_rng([options.seed, 52]),
        options.cameras,
        (options.width_px, options.height_px),
        options.distortion,
        _HEIGHTS_M[options.regime],
    )
    cameras = [
        with_lens(camera, options.lens, np.random.default_rng([options.seed, 55, i]))
        for i, camera in enumerate(cameras)
    ]
    lighting = sample_lighting(np.random.default_rng([options.seed, 53]))
    jobs = []
    for i, camera in enumerate(cameras):
        own = np.random.default_rng([options.seed, 54, i])
        clock = sample_clock(own, options.max_offset_s, options.max_drift_ppm, options.fps)
        kept = own.random(frame_count(options.seconds, options.fps)) >= options.drop_rate
        kept[0] = True
        drawn = sample_photometry(own)
        photometry = Photometry(
            float(np.clip(drawn.gain, 0.8, 1.35)), drawn.gamma, drawn.tint, min(drawn.noise_sd, 4.5), 0.45
        )
        jobs.append(
            CameraJob(
                camera_id=f"cam{i + 1}",
                camera=camera,
                clock=clock,
                frame_times_ns=clock.frame_times_ns(options.seconds, options.fps, kept),
                traffic=traffic,
                lighting=lighting,
                photometry=photometry,
                fps=options.fps,
                seed=int(own.integers(2**31)),
                path=recordings / f"cam{i + 1}.mp4",
            )
        )
    return jobs


def record_camera(job: CameraJob, advance: Callable[[float], None]) -> CameraTruth:
    """Render one camera's recording and write its video; ``advance`` is told the share that is done."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(job.seed)
    renderer = (WideRenderer if job.camera.is_wide else Renderer)(job.traffic.layout, job.lighting, job.camera)
    period_s, phase = rng.uniform(15, 40), rng.uniform(0, 2 * np.pi)
    rows: list[tuple[IntArray, IntArray, IntArray, Array, Array, Array]] = []
    with VideoWriter(job.path, job.camera.width_px, job.camera.height_px, job.fps) as writer:
        for number, time_ns in enumerate(job.frame_times_ns.tolist()):
            true_s = job.clock.true_s(time_ns)
            present, boxes = job.traffic.at(true_s)
            drawing = renderer.draw([t.model for t in present], boxes, job.traffic.program.states(true_s))
            swing = 1 + 0.08 * float(np.sin(2 * np.pi * true_s / period_s + phase))
            writer.write(develop(drawing.image, _exposed(job.photometry, swing), rng), time_ns)
            seen = np.flatnonzero(drawing.in_view)
            rows.append(
                (
                    np.full(len(seen), time_ns, np.int64),
                    np.array([present[i].vehicle_id for i in seen], np.int64),
                    np.array([present[i].model.vehicle_class.number for i in seen], np.int64),
                    drawing.visible_boxes[seen],
                    drawing.amodal_boxes[seen],
                    drawing.visibility[seen],
                )
            )
            if number % 25 == 24:
                advance((number + 1) / len(job.frame_times_ns))
    columns = [np.concatenate(column) for column in zip(*rows, strict=True)]
    return CameraTruth(job.camera_id, _signal_regions(renderer, job), *columns)


def _exposed(photometry: Photometry, swing: float) -> Photometry:
    gain = round(photometry.gain * swing, 2)
    return Photometry(gain, photometry.gamma, photometry.tint, photometry.noise_sd, photometry.blur_px)


def _signal_regions(renderer: Renderer | WideRenderer, job: CameraJob) -> tuple[SignalRegion, ...]:
    """The largest head in view of each phase."""
    best: dict[str, tuple[float, float, float, float]] = {}
    for head in job.traffic.layout.signals:
        if not renderer.sees(head):
            continue
        uv, _ = job.camera.project(head.outline(0.05))
        x0, y0 = np.maximum(np.floor(uv.min(axis=0)), 0.0).tolist()
        x1, y1 = np.minimum(np.ceil(uv.max(axis=0)) + 1, [job.camera.width_px, job.camera.height_px]).tolist()
        if head.phase not in best or y1 - y0 > best[head.phase][3]:
            best[head.phase] = (x0, y0, x1 - x0, y1 - y0)
    return tuple(SignalRegion(id=f"phase-{phase}", region=region) for phase, region in sorted(best.items()))


# --- truth ----------------------------------------------------------------------------------
def _labels(
    options: SimulationOptions, jobs: Sequence[CameraJob], truths: Sequence[CameraTruth]
) -> Iterator[LabelledInstant]:
    """True boxes at the multiples of the label period that at least two recordings span."""
    reference = jobs[0].clock
    maps = [job.clock.map_to(reference) for job in jobs]
    spans = {
        job.camera_id: Span(*clock.to_reference_ns(job.frame_times_ns[[0, -1]]).tolist())
        for clock, job in zip(maps, jobs, strict=True)
    }
    shown = [_visibility_by_frame(job, truth) for job, truth in zip(jobs, truths, strict=True)]
    for time_ns in common_instants(spans, options.label_rate_hz).tolist():
        present, boxes = jobs[0].traffic.at(reference.true_s(time_ns))
        ids = [t.vehicle_id for t in present]
        visibility = {}
        for job, clock, by_frame in zip(jobs, maps, shown, strict=True):
            local_ns = int(clock.to_local_ns(time_ns))
            nearest = int(job.frame_times_ns[np.abs(job.frame_times_ns - local_ns).argmin()])
            recording = abs(nearest - local_ns) <= 2.5 * _NS_PER_S / options.fps
            visibility[job.camera_id] = np.array([by_frame.get((nearest, i), 0.0) if recording else 0.0 for i in ids])
        classes = np.array([t.model.vehicle_class.number for t in present], np.int64)
        yield LabelledInstant(Vehicles3D.of(time_ns, boxes, classes, np.array(ids, np.int64)), visibility)


def _visibility_by_frame(job: CameraJob, truth: CameraTruth) -> Mapping[tuple[int, int], float]:
    keys = zip(truth.times_ns.tolist(), truth.vehicle_ids.tolist(), strict=True)
    return dict(zip(keys, truth.visibility.tolist(), strict=True))


def _changes(job: CameraJob, truth: CameraTruth) -> Iterator[dict[str, str | int]]:
    named = {region.id for region in truth.signals}
    first, last = job.frame_times_ns[[0, -1]].tolist()
    for true_s, phase, before, after in job.traffic.program.changes(job.clock.true_s(first), job.clock.true_s(last)):
        if f"phase-{phase}" in named:
            yield {
                "camera_id": job.camera_id,
                "signal_id": f"phase-{phase}",
                "time_ns": job.clock.local_ns(true_s),
                "before": before,
                "after": after,
            }


def _write_truth(
    folder: Path, options: SimulationOptions, site: Site, jobs: Sequence[CameraJob], truths: Sequence[CameraTruth]
) -> None:
    (folder / "options.json").write_text(
        options.model_dump_json(indent=1, exclude={"workers"}) + "\n", encoding="utf-8"
    )
    write_clocks(folder / "clocks.json", Clocks({job.camera_id: job.clock.map_to(jobs[0].clock) for job in jobs}))
    mounted = {job.camera_id: job.camera for job in jobs}
    write_rig(folder / "rig.json", CameraRig(mounted, views_of_site(site, mounted)))
    changes = [change for job, truth in zip(jobs, truths, strict=True) for change in _changes(job, truth)]
    (folder / "changes.json").write_text(json.dumps(changes, indent=1) + "\n", encoding="utf-8")
    table = pa.concat_tables([_boxes_table(truth) for truth in truths])
    pq.write_table(table, folder / "boxes2d.parquet", compression="zstd")


def _boxes_table(truth: CameraTruth) -> pa.Table:
    columns: dict[str, object] = {
        "camera_id": [truth.camera_id] * len(truth.times_ns),
        "time_ns": truth.times_ns,
        "vehicle_id": truth.vehicle_ids,
        "class": truth.classes,
    }
    for name, boxes in (("visible", truth.visible_boxes), ("amodal", truth.amodal_boxes)):
        for i, side in enumerate(("x0", "y0", "x1", "y1")):
            columns[f"{name}_{side}"] = boxes[:, i]
    columns["visibility"] = truth.visibility
    return pa.table(columns)
