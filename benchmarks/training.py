"""What fine-tuning costs beside the network itself: ratios of interleaved rounds, medians.

1. The multi-view loss (batch 16, 128 vehicles an image, 4 views each) against a DLA-34 step and against a loop over
   vehicles and views.
2. A whole training step of the small network (draw, augment, encode, forward, loss, backward, optimiser) against the
   bare network's forward and backward pass.
3. Making a batch (draw, augment, encode) against the step.
4. Peak memory at once and four times as many frames.

`benchmarks/gpu.py` measures GPUs.

Run: OMP_NUM_THREADS=1 python benchmarks/training.py [--rounds 7] [--parts loss step memory]
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from wibam_core.config import FinetuneConfig
from wibam_core.formats.framestore import FrameStore, FrameStoreWriter
from wibam_core.geometry.box3d import XY
from wibam_core.geometry.torch_ops import CameraTensors, corners, giou, tight_boxes, to_camera
from wibam_core.models.frames import INPUT_WIDTH_PX, to_input
from wibam_core.models.weights import bundled
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.registry import load_network
from wibam_core.networks.small.targets import encode
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, MultiViewVehicle, Vehicles3D
from wibam_core.synthetic.cameras import site_cameras
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.lighting import develop, sample_lighting, sample_photometry
from wibam_core.synthetic.render import Drawing, Renderer
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.traffic import simulate_traffic
from wibam_core.synthetic.trajectories import Trajectory
from wibam_core.training.batches import Batches
from wibam_core.training.dataset import ImageCache, site_views
from wibam_core.training.device import Precision
from wibam_core.training.finetune import SiteDataset, finetune
from wibam_core.training.multiview import NEAR_M, OtherCameras, OtherViews, multiview_loss
from wibam_core.training.trainable import TrainableNetwork

BATCH, SLOTS, VIEWS = 16, 128, 4
#: Input of the published DLA-34, and the part of it that is measured: cost is linear in pixels and images.
DLA_SIZE, DLA_MEASURED = (448, 800), (224, 416)
#: Vehicles that the loop is timed on; scaled up to the whole batch.
LOOP_VEHICLES = 16
#: Frames as the pipeline stores them.
FRAME_PX = (960, 540)
RATE_HZ = 2.5
#: Rendered moments of the site: a longer recording shows them again.
MOMENTS = 12
#: Measured steps and batches of a round.
STEPS = 10


# --- a site -------------------------------------------------------------------------------------
def make_dataset(folder: Path, instants: int, seed: int = 11) -> SiteDataset:
    """A rendered site with its true boxes as labels: four cameras without distortion. Moments repeat after a while."""
    rng = np.random.default_rng(seed)
    layout = make_layout(seed)
    rig = CameraRig({f"cam{k + 1}": c for k, c in enumerate(site_cameras(layout, rng, VIEWS, FRAME_PX))})
    lighting, photometry = sample_lighting(rng), sample_photometry(rng)
    renderers = {name: Renderer(layout, lighting, camera) for name, camera in rig.items()}
    program = SignalProgram()
    traffic = simulate_traffic(layout, seed, MOMENTS / RATE_HZ + 1, program)
    times = [round(step * 1e9 / RATE_HZ) for step in range(instants)]
    moments = []
    for time_ns in times[:MOMENTS]:
        present, boxes = traffic.at(time_ns * 1e-9)
        models, lamps = [one.model for one in present], program.states(time_ns * 1e-9)
        drawings = {name: renderer.draw(models, boxes, lamps) for name, renderer in renderers.items()}
        images = {name: develop(drawing.image, photometry, rng) for name, drawing in drawings.items()}
        moments.append((present, boxes, drawings, images))
    annotated, lifts = [], []
    with FrameStoreWriter(folder, 92) as writer:
        for number, time_ns in enumerate(times):
            present, boxes, drawings, images = moments[number % MOMENTS]
            for name, image in images.items():
                writer.add(name, time_ns, time_ns, image)
            annotated.append(_annotated(time_ns, present, boxes, drawings))
            classes = np.zeros(len(boxes), np.int64)
            ids = np.array([one.vehicle_id for one in present], np.int64)
            certain = np.full((len(boxes), 7), 0.05)
            lifts.append(Vehicles3D.of(time_ns, boxes, classes, ids, np.ones(len(boxes)), certain))
        writer.close()
    frames = FrameStore(folder)
    return SiteDataset(frames, rig, site_views(annotated, frames, lifts, rig), [])


def _annotated(
    time_ns: int, present: Sequence[Trajectory], boxes: np.ndarray, drawings: Mapping[str, Drawing]
) -> AnnotatedInstant:
    """What a perfect 2D detector and a perfect association would give."""
    detections: dict[str, Detections2D] = {}
    rows: list[dict[str, int]] = [{} for _ in present]
    for name, drawing in drawings.items():
        seen = np.flatnonzero(drawing.visibility > 0.3).tolist()
        for row, vehicle in enumerate(seen):
            rows[vehicle][name] = row
        classes = np.array([present[k].model.vehicle_class.number for k in seen], np.int64)
        detections[name] = Detections2D(name, time_ns, drawing.visible_boxes[seen], np.ones(len(seen)), classes)
    vehicles = tuple(
        MultiViewVehicle(k, one.vehicle_id, one.model.vehicle_class, *boxes[k][XY].tolist(), rows[k])
        for k, one in enumerate(present)
        if rows[k]
    )
    return AnnotatedInstant(time_ns, detections, vehicles)


# --- timing -------------------------------------------------------------------------------------
def medians(rounds: int, *works: Callable[[], float | None]) -> list[float]:
    """Median CPU seconds of each work over interleaved rounds, after one unmeasured; a work may time itself."""
    seconds: list[list[float]] = [[] for _ in works]
    for number in range(rounds + 1):
        for work, found in zip(works, seconds, strict=True):
            start = time.process_time()
            own = work()
            spent = time.process_time() - start if own is None else own
            if number:
                found.append(spent)
    return [statistics.median(found) for found in seconds]


def table(title: str, rows: Sequence[tuple[str, float, str, str]]) -> None:
    """Rows of (what, seconds, ratio, target)."""
    width = max(len(row[0]) for row in rows)
    print(f"\n{title}\n{'':{width}}  {'CPU ms':>10}  {'ratio':>8}  target")
    for what, seconds, ratio, target in rows:
        print(f"{what:{width}}  {seconds * 1e3:10.1f}  {ratio:>8}  {target}", flush=True)


# --- 1: the multi-view loss ---------------------------------------------------------------------
def loss_case(seed: int = 0) -> tuple[Tensor, OtherViews]:
    """Boxes of a full batch (N, 7), and a pair for each of them and each view."""
    rng = np.random.default_rng(seed)
    cameras = site_cameras(make_layout(seed), rng, VIEWS, (512, 288))
    n = BATCH * SLOTS
    places, sizes = rng.uniform(-25, 25, (n, 2)), rng.uniform([3.5, 1.6, 1.3], [11, 2.6, 3.2], (n, 3))
    boxes = np.column_stack([places, sizes[:, 2] / 2, sizes, rng.uniform(-np.pi, np.pi, n)])
    corner = rng.uniform([0, 60], [450, 250], (n * VIEWS, 2))
    given = np.concatenate([corner, corner + rng.uniform(15, 90, (n * VIEWS, 2))], axis=1)
    views = OtherViews(
        torch.arange(n).repeat_interleave(VIEWS),
        torch.arange(VIEWS).repeat(n),
        torch.tensor(given),
        CameraTensors.from_cameras(cameras, torch.float64),
    )
    return torch.tensor(boxes, requires_grad=True), views


def loop_loss(boxes: Tensor, views: OtherViews) -> Tensor:
    """`multiview_loss` one vehicle and one view at a time."""
    means = []
    for vehicle in range(len(boxes)):
        losses = []
        for pair in (views.vehicle == vehicle).nonzero()[:, 0]:
            camera, box = views.cameras[views.camera[pair][None]], boxes[vehicle][None]
            if to_camera(camera, corners(box))[..., 2].min() < NEAR_M:
                continue
            projected, in_view = tight_boxes(camera, box)
            if in_view:
                losses.append(1 - giou(projected[0], views.boxes[pair]))
        if losses:
            means.append(torch.stack(losses).mean())
    return torch.stack(means).mean()


def benchmark_loss(rounds: int) -> None:
    boxes, views = loss_case()
    part = slice(0, LOOP_VEHICLES * VIEWS)
    few_views = OtherViews(views.vehicle[part], views.camera[part], views.boxes[part], views.cameras)
    few = boxes[:LOOP_VEHICLES]
    assert torch.allclose(loop_loss(few, few_views), multiview_loss(few, few_views), atol=1e-6)
    network = DLA34().train()
    images = torch.rand(1, 3, *DLA_MEASURED)

    def step() -> None:
        network.zero_grad()
        torch.stack([head.square().mean() for head in network(images).values()]).sum().backward()

    vector, loop, dla = medians(
        rounds,
        lambda: torch.autograd.backward(multiview_loss(boxes, views)),
        lambda: torch.autograd.backward(loop_loss(boxes[:LOOP_VEHICLES], few_views)),
        step,
    )
    loop *= BATCH * SLOTS / LOOP_VEHICLES
    dla *= BATCH * DLA_SIZE[0] * DLA_SIZE[1] / (DLA_MEASURED[0] * DLA_MEASURED[1])
    table(
        f"Multi-view loss, forward and backward: batch {BATCH}, {SLOTS} vehicles an image, {VIEWS} views each",
        [
            ("multi-view loss", vector, "", ""),
            (f"DLA-34 step, scaled from 1 x {DLA_MEASURED}", dla, f"{vector / dla:.2%}", "<= 3 %"),
            (f"loop, scaled from {LOOP_VEHICLES} vehicles", loop, f"{loop / vector:.0f}x", ">= 100x"),
        ],
    )


# --- 2 and 3: the training step of the small network --------------------------------------------
def step_seconds(
    network: TrainableNetwork,
    dataset: SiteDataset,
    steps: int,
    scratch: Path,
    clock: Callable[[], float],
    /,
    **options: Any,
) -> float:
    """Median seconds of a training step, once every image is in the cache."""
    fill = -(-len(dataset.train) // FinetuneConfig(**options).batch_size)
    config = FinetuneConfig(steps=fill + steps, steps_per_epoch=fill + steps, **options)
    ends: list[float] = []
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        finetune(network, dataset, config, lambda f, m="", **k: ends.append(clock()), Path(folder))
    return statistics.median(np.diff(ends[fill - 1 : fill + steps]).tolist())


class BatchMaker:
    """Draws, augments and encodes batches as fine-tuning does."""

    def __init__(self, dataset: SiteDataset, scratch: Path) -> None:
        cache = ImageCache(scratch / "batches.npy", dataset.train, dataset.frames)
        self._batches = Batches(dataset.train, cache.view, FinetuneConfig())
        self._others = OtherCameras(dataset.rig)
        self._step = 0
        for number in range(len(dataset.train)):
            cache.view(number)

    def make(self) -> Tensor:
        """The images of a batch (8, 3, H, W)."""
        batch = self._batches.to_learn(self._step)
        self._step += 1
        encode(batch.views)
        self._others.of(batch.sources, batch.mirrored)
        return to_input(np.stack([view.image for view in batch.views]))


def benchmark_step(rounds: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        dataset = make_dataset(scratch / "frames", MOMENTS)
        maker = BatchMaker(dataset, scratch)
        images = maker.make()
        alone, trained = (load_network(bundled("mono_small.safetensors")) for _ in range(2))
        network = alone.module.train().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        precision = Precision.of(torch.device("cpu"))

        def bare() -> float:
            ends = [time.process_time()]
            for _ in range(STEPS):
                network.zero_grad(set_to_none=True)
                with precision.autocast():
                    outputs = network(images)
                torch.stack([getattr(outputs, f.name).mean() for f in fields(outputs)]).sum().backward()
                ends.append(time.process_time())
            return statistics.median(np.diff(ends).tolist())

        def whole() -> float:
            return step_seconds(trained, dataset, STEPS, scratch, time.process_time, device="cpu")

        def batches() -> None:
            for _ in range(STEPS):
                maker.make()

        step, network_alone, batch = medians(rounds, whole, bare, batches)
        batch /= STEPS
        table(
            f"Training step of the small network, batch {len(images)}, {images.shape[-1]}x{images.shape[-2]} px, "
            f"{precision.dtype or torch.float32}",
            [
                ("whole step", step, f"{step / network_alone:.2f}", "<= 1.10 of the bare network"),
                ("bare network, forward and backward", network_alone, "1.00", ""),
                ("draw, augment, encode a batch", batch, f"{batch / step:.1%}", "of the step; < 100 % with a loader"),
            ],
        )


# --- 4: memory ----------------------------------------------------------------------------------
def memory_of(instants: int) -> None:
    """Print peak and anonymous memory, MB, of a process that labels and prepares all frames."""
    with tempfile.TemporaryDirectory() as name:
        dataset = make_dataset(Path(name) / "frames", instants)
        maker = BatchMaker(dataset, Path(name))
        for _ in range(STEPS):
            maker.make()
        with Path("/proc/self/status").open(encoding="ascii") as file:
            kilobytes = dict(line.split(":", 1) for line in file)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(len(dataset.train), f"{peak:.0f}", f"{int(kilobytes['RssAnon'].split()[0]) / 1024:.0f}")


def benchmark_memory() -> None:
    print("\nMemory of labels and images, MB\nframes  images  peak RSS  anonymous")
    for instants in (60, 240):
        command = [sys.executable, __file__, "--memory-of", str(instants)]
        frames, peak, anonymous = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        raw = int(frames) * INPUT_WIDTH_PX**2 * FRAME_PX[1] / FRAME_PX[0] * 3 / 2**20
        print(f"{frames:>6}  {raw:6.0f}  {peak:>8}  {anonymous:>9}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--parts", nargs="+", choices=("loss", "step", "memory"), default=None)
    parser.add_argument("--memory-of", type=int, default=None, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    if arguments.memory_of is not None:
        memory_of(arguments.memory_of)
        return
    parts = arguments.parts or ("loss", "step", "memory")
    if "loss" in parts:
        benchmark_loss(arguments.rounds)
    if "step" in parts:
        benchmark_step(arguments.rounds)
    if "memory" in parts:
        benchmark_memory()


if __name__ == "__main__":
    main()
