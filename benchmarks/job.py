"""What every stage of a job costs: seconds by the clock and of the CPU, peak memory, disk; beside the bare work.

Stages run one after the other, each as a process of its own, as a worker of the service runs them. Seconds are per
minute of footage (the shortest recording). Memory is the largest process's peak. The bare work is what a stage cannot
do without: libavcodec's decoding of the recordings (`sync` where there are signal regions, `frames`), and the passes of
the networks on prepared input, over as many images and crops as the stage shows them (`detect`, `predict`, `evaluate`).
It is timed on one thread, in the same run, networks on a sample of the passes; printed is what the stage's CPU time is
of it. What the output folder holds already is not run again, and has no row.

Run: python benchmarks/job.py SITE_DIR [--out FOLDER] [--until STAGE] [--set stage.option=value ...]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from wibam_core.artifacts.access import ArtifactReader
from wibam_core.artifacts.catalogue import DETECTIONS, FRAMES, PROBE, RIG, SEARCHED_INSTANTS, SPLIT
from wibam_core.cli.run import parse_options
from wibam_core.config import PipelineConfig
from wibam_core.scene import FrameSet
from wibam_core.stages.execute import StageRequest
from wibam_core.stages.graph import STAGES, PlannedStage, plan
from wibam_core.stages.runner import SiteFolder
from wibam_core.stages.store import StageStore

#: Passes of a network that are timed.
SAMPLE = 24
#: Crops that the edge refiner sees in one pass, and how often it looks at each box.
CROPS, LOOKS = 8, 2


@dataclass(frozen=True)
class Cost:
    """What one stage took: s by the clock, s of all its threads, bytes of memory at most, bytes on the disk."""

    wall_s: float
    cpu_s: float
    peak_bytes: int
    written_bytes: int


def run_stage(folder: SiteFolder, store: StageStore, config: PipelineConfig, planned: PlannedStage) -> Cost:
    """Run one stage as a process of its own, and publish what it makes.

    Raises:
        RuntimeError: it failed; the message is its last line.
    """
    attempt = store.begin(planned.name, planned.hash, planned.frame_hash)
    upstream = {stage.name: made for stage in planned_of(folder, config) if (made := folder.made(stage, store))}
    request = StageRequest.of(attempt, folder.site, config, folder.recordings, folder.assets, upstream)
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "request.json"
        path.write_text(request.model_dump_json())
        started = time.monotonic()
        command = [sys.executable, "-m", "wibam_core.stages.execute", str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            last = "".join(deque(process.stdout, maxlen=1))
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        wall_s = time.monotonic() - started
    if process.returncode != 0:
        store.discard(attempt)
        raise RuntimeError(f"{planned.name} failed: {last or process.returncode}")
    written = sum(file.stat().st_size for file in attempt.output.rglob("*") if file.is_file())
    store.publish(attempt, json.loads(last)["summary"], wall_s)
    return Cost(wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024, written)


def planned_of(folder: SiteFolder, config: PipelineConfig) -> tuple[PlannedStage, ...]:
    return plan(folder.site, config, folder.digests())


def cpu_s(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def decoding_s(folder: SiteFolder) -> dict[str, float]:
    """Camera -> CPU seconds in which libavcodec alone, on one thread, decodes its whole recording."""
    import av

    def decode(path: Path) -> None:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            stream.codec_context.thread_count = 1
            for packet in container.demux(stream):
                stream.decode(packet)

    return {camera_id: cpu_s(partial(decode, path)) for camera_id, path in folder.recordings.items()}


def onnx_pass_s(path: Path, shape: tuple[int, ...]) -> float:
    """CPU seconds of one pass of a network on one thread, on noise of this shape."""
    from wibam_core.models.onnx_session import open_session

    session = open_session(path, path.name, threads=1, hint="")
    name = session.get_inputs()[0].name
    values = np.random.default_rng(0).random(shape, dtype=np.float32)
    session.run(None, {name: values})
    return cpu_s(lambda: [session.run(None, {name: values}) for _ in range(SAMPLE)]) / SAMPLE


def monocular_pass_s(height_px: int, width_px: int) -> float:
    """CPU seconds of one image through the bundled 3D network in ONNX Runtime on one thread, 8 images a pass."""
    from wibam_core.models.weights import bundled
    from wibam_core.networks.registry import load_network
    from wibam_core.networks.small.network import SmallMonocular

    network = load_network(bundled("mono_small.safetensors"))
    assert isinstance(network, SmallMonocular), "the bundled network is of another family"
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "network.onnx"
        path.write_bytes(network.onnx())
        return onnx_pass_s(path, (8, 3, height_px, width_px)) / 8


def bare_s(folder: SiteFolder, made: ArtifactReader, config: PipelineConfig) -> dict[str, float]:
    """Stage -> CPU seconds of the work that it cannot avoid, of the stages that have such and were made."""
    from wibam_core.detection.centre import INPUT_WIDTH_PX
    from wibam_core.detection.crops import CROP_PX
    from wibam_core.detection.detector import BUNDLED
    from wibam_core.detection.edge_refiner import BUNDLED_EDGE_REFINER
    from wibam_core.geometry.pixels import resized_height_px

    bare: dict[str, float] = {}
    if made.has(FRAMES):
        decoding = decoding_s(folder)
        bare["frames"] = sum(decoding.values())
        bare["sync"] = sum(decoding[camera.id] for camera in folder.site.cameras if camera.signals)
    if not made.has(DETECTIONS) or config.detect.detector != "bundled":
        return bare
    store = made.read(FRAMES)
    height = max(resized_height_px(*store.size(id_), INPUT_WIDTH_PX) for id_ in store.camera_ids)
    shape = (1, 3, height + -height % 32, INPUT_WIDTH_PX)
    boxes = sum(len(found.boxes) for found in made.read(DETECTIONS).values())
    crop_s = onnx_pass_s(BUNDLED_EDGE_REFINER, (CROPS, 7, CROP_PX, CROP_PX)) / CROPS
    searched = images(made.read(SEARCHED_INSTANTS))
    bare["detect"] = onnx_pass_s(BUNDLED, shape) * searched
    if config.detect.refine != "off":
        bare["detect"] += crop_s * LOOKS * boxes
    if made.has(SPLIT) and made.has(RIG) and config.finetune.network == "small":
        image_s = monocular_pass_s(*shape[2:])
        tested = set(made.read(SPLIT).times_ns["test"])
        of_test = [instant for instant in store.frame_sets if instant.time_ns in tested]
        tracked = {instant.time_ns for instant in store.thinned(config.track.rate_hz)}
        bare["evaluate"] = image_s * images(of_test)  # the baseline; the fine-tuned network sees them before
        bare["predict"] = image_s * images([one for one in store.frame_sets if one.time_ns in tested | tracked])
    return bare


def images(instants: list[FrameSet]) -> int:
    return sum(len(instant.frame_times_ns) for instant in instants)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site_dir", type=Path)
    parser.add_argument("--out", type=Path, help="where outputs go; default: a folder that is removed at the end")
    parser.add_argument("--until", choices=list(STAGES), help="stop after this stage")
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.OPTION=VALUE")
    arguments = parser.parse_args()
    config = PipelineConfig.parse(parse_options(arguments.set))
    folder = SiteFolder.load(arguments.site_dir)
    with tempfile.TemporaryDirectory() as temporary:
        store = StageStore(arguments.out or Path(temporary))
        costs = {}
        stages = planned_of(folder, config)
        for planned in stages[: 1 + [stage.name for stage in stages].index(arguments.until or stages[-1].name)]:
            if folder.made(planned, store) is None:
                costs[planned.name] = cost = run_stage(folder, store, config, planned)
                print(f"{planned.name}: {cost.cpu_s:.1f} CPU-s, peak {cost.peak_bytes / 1e6:.0f} MB", flush=True)
        made = ArtifactReader({stage.name: path for stage in stages if (path := folder.made(stage, store))})
        report(costs, made, bare_s(folder, made, config))


def report(costs: dict[str, Cost], made: ArtifactReader, bare: dict[str, float]) -> None:
    cameras = made.read(PROBE).cameras
    minutes = min(info.duration_s for info in cameras.values()) / 60
    sizes = ", ".join(sorted({f"{i.width_px}x{i.height_px} px at {i.fps:.1f} fps" for i in cameras.values()}))
    print(f"{len(cameras)} cameras, {sizes}, {minutes:.2f} minutes; {len(os.sched_getaffinity(0))} cores")
    print(
        "per minute of footage: s by the clock, CPU-s; peak MB; MB written; CPU-s of the bare work, and the ratio to it"
    )
    for name, cost in costs.items():
        beside = f"{bare[name] / minutes:8.2f}  {cost.cpu_s / bare[name]:5.2f}" if bare.get(name) else ""
        print(
            f"{name:<10}{cost.wall_s / minutes:8.1f}{cost.cpu_s / minutes:9.1f}{cost.peak_bytes / 1e6:8.0f}"
            f"{cost.written_bytes / minutes / 1e6:9.1f}{beside}"
        )
    print(
        f"{'all':<10}{sum(c.wall_s for c in costs.values()) / minutes:8.1f}"
        f"{sum(c.cpu_s for c in costs.values()) / minutes:9.1f}"
        f"{max((c.peak_bytes for c in costs.values()), default=0) / 1e6:8.0f}"
        f"{sum(c.written_bytes for c in costs.values()) / minutes / 1e6:9.1f}"
    )


if __name__ == "__main__":
    main()
