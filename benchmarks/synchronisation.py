"""How well clocks are found from lights, traffic and both, and whether their standard deviations are true.

    python benchmarks/synchronisation.py --sites 20

Sites are simulated as lamp states and detections, without pictures: four cameras of 25 to 50 frames per second that
were started up to 7 minutes apart, with drifts up to 1000 ppm. A camera sees each light change within a frame interval
and misses some. Boxes are those around the bodies of vehicles, with noise, misses and false ones; vehicles that nearer
ones cover are not seen, and the calibration that is used is not quite the true one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wibam_core.clocks import SignalChange
from wibam_core.errors import WibamError
from wibam_core.geometry.box3d import corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import Detections2D
from wibam_core.sync.offsets import SyncResult
from wibam_core.sync.paths import GroundPath, ground_paths
from wibam_core.sync.witnesses import synchronise
from wibam_core.synthetic.cameras import site_cameras
from wibam_core.synthetic.clocks import CameraClock
from wibam_core.synthetic.layout import PHASES, make_layout
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.traffic import Traffic, simulate_traffic

_SIZE_PX = (960, 540)


@dataclass(frozen=True)
class Options:
    """What is simulated.

    Attributes:
        sites: how many. seed: of the first. seconds: length of each recording.
        max_offset_s: recordings start at most so far apart. max_drift_ppm: of a clock.
        cycle_s: of the lights. jitter_s: by how much a green phase varies; 0: a fixed cycle. step_s: greens last for
            whole multiples of this; 0: for any time.
        rate_hz: frames a second that are searched for vehicles.
        missed: share of vehicles in a frame, and of light changes, that are not seen. false: false boxes a frame.
        noise_px, noise_share: standard deviation of an edge, in px and as a share of the box's side.
        rotation_deg, position_m: standard deviations of the calibration that is used, per axis.
    """

    sites: int = 20
    seed: int = 0
    seconds: float = 600.0
    max_offset_s: float = 420.0
    max_drift_ppm: float = 1000.0
    cycle_s: float = 60.0
    jitter_s: float = 0.0
    step_s: float = 0.0
    rate_hz: float = 5.0
    missed: float = 0.1
    false: float = 0.2
    noise_px: float = 0.7
    noise_share: float = 0.02
    rotation_deg: float = 0.1
    position_m: float = 0.05


@dataclass(frozen=True)
class Witness:
    """What one simulated camera says, and the truth of it."""

    clock: CameraClock
    fps: float
    span_s: tuple[float, float]
    changes: list[SignalChange]
    paths: list[GroundPath]


def simulated(options: Options, seed: int, *, with_traffic: bool = True) -> dict[str, Witness]:
    """One site."""
    rng = np.random.default_rng([seed, 71])
    layout = make_layout(seed)
    program = SignalProgram(cycle_s=options.cycle_s, offset_s=float(rng.uniform(0, options.cycle_s)))
    starts = rng.uniform(0, options.max_offset_s, 4)
    duration_s = options.seconds + options.max_offset_s + 2.0
    traffic = simulate_traffic(layout, seed, duration_s, program) if with_traffic else None
    cameras = site_cameras(layout, np.random.default_rng([seed, 72]), 4, _SIZE_PX, False, (6.0, 10.0))
    events = _events(program, options, starts.max() + options.seconds, rng)
    found = {}
    for k, camera in enumerate(cameras):
        fps = float(rng.choice([25.0, 29.97, 30.0, 50.0]))
        drift = float(rng.uniform(-1, 1)) * options.max_drift_ppm * 1e-6
        clock = CameraClock(float(starts[k]), drift, int(rng.uniform(0, 1 / fps) * 1e9))
        times_ns = clock.frame_times_ns(options.seconds, fps, np.ones(round(options.seconds * fps), bool))
        own = np.random.default_rng([seed, 73, k])
        changes = _seen_changes(f"cam{k + 1}", clock, times_ns, fps, events, options, own)
        paths: list[GroundPath] = []
        if traffic is not None:
            step = max(round(fps / options.rate_hz), 1)
            seen = list(_detections(f"cam{k + 1}", camera, clock, times_ns[::step], traffic, options, own))
            paths = ground_paths(seen, _misplaced(camera, options, own))
        found[f"cam{k + 1}"] = Witness(clock, fps, (times_ns[0] / 1e9, times_ns[-1] / 1e9), changes, paths)
    return found


def _events(
    program: SignalProgram, options: Options, until_s: float, rng: np.random.Generator
) -> list[tuple[float, str, str, str]]:
    """Light changes; the green phases of an actuated signal vary, all later changes move with them."""
    if not options.jitter_s:
        return program.changes(0.0, until_s)
    found, now_s = [], program.offset_s - options.cycle_s
    while now_s < until_s:
        for phase in PHASES:
            green_s = max(program.green_s + rng.uniform(-1, 1) * options.jitter_s, 4.0)
            green_s = round(green_s / options.step_s) * options.step_s if options.step_s else green_s
            steps = ((0.0, "red", "green"), (green_s, "green", "amber"), (green_s + 3.0, "amber", "red"))
            found += [(now_s + after_s, phase, before, after) for after_s, before, after in steps]
            now_s += green_s + program.amber_s + program.all_red_s
    return sorted(found)


def _seen_changes(
    camera_id: str,
    clock: CameraClock,
    times_ns: np.ndarray,
    fps: float,
    events: list[tuple[float, str, str, str]],
    options: Options,
    rng: np.random.Generator,
) -> list[SignalChange]:
    found = []
    for true_s, phase, before, after in events:
        local_ns = clock.local_ns(true_s)
        k = int(np.searchsorted(times_ns, local_ns))
        if 0 < k < len(times_ns) and rng.random() >= options.missed:
            middle, half = int(times_ns[k - 1] + times_ns[k]) // 2, round(0.5e9 / fps)
            found.append(SignalChange(camera_id, phase, middle, before, after, 0.9, half))
    return found


def _detections(
    camera_id: str,
    camera: Camera,
    clock: CameraClock,
    times_ns: np.ndarray,
    traffic: Traffic,
    options: Options,
    rng: np.random.Generator,
) -> Iterator[Detections2D]:
    far = np.array([camera.width_px, camera.height_px]) - 1.0
    for time_ns in times_ns.tolist():
        present, boxes = traffic.at(clock.true_s(time_ns))
        classes = np.array([t.model.vehicle_class.number for t in present], np.int64)
        image = np.zeros((len(boxes), 4))
        depth = np.full(len(boxes), -1.0)
        if len(boxes):
            uv, depths = camera.project(corners(boxes))
            image = np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)
            depth = depths.min(axis=1)
        image = np.concatenate([np.clip(image[:, :2], 0, far), np.clip(image[:, 2:], 0, far)], axis=1)
        sides = image[:, 2:] - image[:, :2]
        keep = (depth > 1.0) & (sides.min(axis=1, initial=np.inf) > 8) & (rng.random(len(boxes)) >= options.missed)
        for i in np.flatnonzero(keep):
            nearer = (depth > 0) & (depth < depth[i] - 1.0)
            keep[i] &= _covered(image[i], image[nearer]) < 0.5
        image, classes, sides = image[keep], classes[keep], sides[keep]
        sd = options.noise_px + options.noise_share * np.tile(sides, 2)
        image = image + sd * rng.standard_normal(image.shape)
        false = rng.poisson(options.false)
        corner = rng.uniform(0, far - 60, (false, 2))
        image = np.concatenate([image, np.concatenate([corner, corner + rng.uniform(20, 60, (false, 2))], axis=1)])
        classes = np.concatenate([classes, np.zeros(false, np.int64)])
        yield Detections2D(camera_id, time_ns, image, np.full(len(image), 0.8), classes)


def _covered(box: np.ndarray, others: np.ndarray) -> float:
    """The largest share of a box that one other covers."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    area = np.prod(np.maximum(high - low, 0.0), axis=1)
    return float(area.max(initial=0.0) / np.prod(box[2:] - box[:2]))


def _misplaced(camera: Camera, options: Options, rng: np.random.Generator) -> Camera:
    """The camera as a calibration has it: its pose is not quite the true one."""
    rvec, tvec = camera.T_cam_world.to_rvec_tvec()
    turned = SE3.from_rvec_tvec(np.radians(options.rotation_deg) * rng.standard_normal(3), np.zeros(3))
    moved = SE3.from_rvec_tvec(rvec, tvec + options.position_m * rng.standard_normal(3))
    return Camera(camera.K, camera.dist, (turned @ moved).inverse(), camera.width_px, camera.height_px)


def judged(result: SyncResult, witnesses: dict[str, Witness]) -> tuple[float, list[float], list[float]]:
    """Worst error of any two cameras (s), and error (s) and error over its sd of each against the reference.

    All in the middle of what all recordings share, or of what two do.
    """
    reference = witnesses[result.reference_id].clock
    middle_s = float(np.median([w.clock.true_s(round(1e9 * np.mean(w.span_s))) for w in witnesses.values()]))
    errors, scaled = [0.0], []
    for camera_id, witness in witnesses.items():
        if camera_id == result.reference_id:
            continue
        mapped_ns = int(result.clocks[camera_id].to_reference_ns(witness.clock.local_ns(middle_s)))
        error_s = (mapped_ns - reference.local_ns(middle_s)) / 1e9
        errors.append(error_s)
        scaled.append(error_s / result.sd_s(camera_id, witness.clock.local_ns(middle_s) / 1e9))
    return max(errors) - min(errors), errors[1:], scaled


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in vars(Options()).items():
        parser.add_argument("--" + name.replace("_", "-"), type=type(default), default=default)
    parser.add_argument("--witnesses", default="lights,traffic,both")
    arguments = vars(parser.parse_args())
    chosen = arguments.pop("witnesses").split(",")
    options = Options(**arguments)
    rows: dict[str, list[tuple[float, list[float], list[float]]]] = {name: [] for name in chosen}
    verdicts: dict[str, dict[str, int]] = {name: {"clear": 0, "ambiguous": 0, "refused": 0} for name in chosen}
    wrong = dict.fromkeys(chosen, 0)
    spent_s = dict.fromkeys(chosen, 0.0)
    for seed in range(options.seed, options.seed + options.sites):
        witnesses = simulated(options, seed, with_traffic=chosen != ["lights"])
        spans = {c: w.span_s for c, w in witnesses.items()}
        for name in chosen:
            began = time.process_time()
            try:
                result = synchronise(
                    spans,
                    "cam1",
                    changes={c: w.changes for c, w in witnesses.items()} if name != "traffic" else None,
                    paths={c: w.paths for c, w in witnesses.items()} if name != "lights" else None,
                )
            except WibamError as error:
                verdicts[name]["refused"] += 1
                print(f"site {seed} {name}: refused: {error.message}", flush=True)
                continue
            spent_s[name] += time.process_time() - began
            row = judged(result.result, witnesses)
            verdict = "ambiguous" if result.is_ambiguous else "clear"
            verdicts[name][verdict] += 1
            wrong[name] += verdict == "clear" and row[0] > 0.2
            if verdict == "clear":
                rows[name].append(row)
            print(
                f"site {seed} {name}: {verdict}, worst pair {1e3 * row[0]:.1f} ms, "
                f"errors over sd {' '.join(f'{x:.1f}' for x in row[2])}",
                flush=True,
            )
    print(
        f"{options}\n| witnesses | clear | ambiguous | refused | clear and wrong | worst pair ms: median, p90, max |"
        " within 2 sd: cameras, sites | CPU s a site |\n|---|---|---|---|---|---|---|---|"
    )
    for name in chosen:
        worst = 1e3 * np.array([row[0] for row in rows[name]] or [np.nan])
        scaled = np.abs(np.array([row[2] for row in rows[name]]).reshape(-1, 3))
        counts = verdicts[name]
        print(
            f"| {name} | {counts['clear']} | {counts['ambiguous']} | {counts['refused']} | {wrong[name]} | "
            f"{np.median(worst):.1f}, {np.percentile(worst, 90):.1f}, {worst.max():.1f} | "
            f"{(scaled < 2).sum()} of {scaled.size}, {(scaled < 2).all(axis=1).sum()} of {len(scaled)} | "
            f"{spent_s[name] / options.sites:.1f} |"
        )


if __name__ == "__main__":
    main()
