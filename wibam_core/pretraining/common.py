"""What the pre-training scripts share: a pool of rendered views, a schedule, averaged weights, and a log."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from wibam_core.errors import NonFiniteLoss
from wibam_core.geometry.camera import Camera
from wibam_core.models.classes import ClassChannels
from wibam_core.networks.small.architecture import CLASS_NAMES
from wibam_core.networks.small.targets import Targets, encode
from wibam_core.pretraining.state import AveragedWeights, TrainingState
from wibam_core.scene import Vehicles3D
from wibam_core.synthetic.sampling import Regime, RenderedView, sample_views
from wibam_core.synthetic.varied_sampling import sample_varied_views
from wibam_core.training.device import Precision, choose_device
from wibam_core.training.views import LabelledView

#: Vehicles less visible or smaller than this are ignored: neither taught nor punished.
_MIN_VISIBILITY = 0.25
_MIN_SIDE_PX = 6.0

_JPEG_QUALITY = 95
#: So many rendered views in a row show one simulated site.
VIEWS_PER_SITE = 20

#: Name of the log in the folder of a script's outputs.
LOG = "log.jsonl"
#: And of what an interrupted run needs to go on.
STATE = "state.pt"

#: One in this many views without a vehicle is kept.
_KEPT_EMPTY = 5
_WARM_UP_STEPS = 200
_GRADIENT_CLIP = 5.0

#: Channel of each class in the networks that are made here; they are taught nothing else.
_CHANNEL_OF = ClassChannels.of("the bundled networks", CLASS_NAMES).channel_of

_NO_IMAGE = np.zeros((0, 0, 3), np.uint8)

Network = TypeVar("Network", bound=nn.Module)


class Movable(Protocol):
    """A batch: something that can be moved to a device."""

    def to(self: AnyBatch, device: torch.device) -> AnyBatch:
        """The same on ``device``."""


AnyBatch = TypeVar("AnyBatch", bound=Movable)


def is_taught(rendered: RenderedView) -> NDArray[np.bool_]:
    """(N,) which vehicles can be seen well enough to be learned from."""
    boxes = rendered.visible_boxes
    side = (boxes[:, 2:] - boxes[:, :2]).min(axis=1, initial=np.inf)
    return np.asarray((rendered.visibility >= _MIN_VISIBILITY) & (side >= _MIN_SIDE_PX))


def labelled(rendered: RenderedView) -> LabelledView:
    """A rendered view with its truth as labels."""
    boxes, taught = rendered.visible_boxes, is_taught(rendered)
    seen = (rendered.visibility > 0) & ~taught
    vehicles: Vehicles3D = rendered.vehicles
    return LabelledView(
        rendered.image,
        rendered.camera,
        boxes[taught],
        vehicles.classes[taught],
        vehicles.boxes[taught],
        np.ones(int(taught.sum())),
        np.ones(int(taught.sum()), bool),
        boxes[seen],
    )


def render(seed: int, regime: Regime, count: int, size_px: tuple[int, int]) -> list[RenderedView]:
    """Views of several sites, numbered from ``seed``."""
    views: list[RenderedView] = []
    while len(views) < count:
        number = min(VIEWS_PER_SITE, count - len(views))
        views += sample_views(seed + len(views), regime, number, size_px=size_px)
    return views


@dataclass(frozen=True)
class PoolPlan:
    """Which views to render, and when: ``shard`` views every ``steps_per_shard`` steps, up to ``images``.

    Of ten sites ``varied_of_ten`` have varied views (`wibam_core.synthetic.varied_sampling`), of their own size, for
    which ``near`` says how many show a vehicle from close by.
    """

    seed: int
    regime: Regime
    images: int
    shard: int
    steps_per_shard: int
    size_px: tuple[int, int]
    varied_of_ten: int = 0
    near: float = 0.0

    @classmethod
    def within(
        cls, steps: int, seed: int, regime: Regime, images: int, shard: int, size_px: tuple[int, int]
    ) -> PoolPlan:
        """All views are there after six tenths of the steps of a training."""
        return cls(seed, regime, images, shard, max(1, int(0.6 * steps) // -(-images // shard)), size_px)

    def due(self, step: int) -> int:
        """How many views are to be there at a step."""
        return min(self.images, (step // self.steps_per_shard + 1) * self.shard)

    def views(self, first: int, count: int) -> Iterable[RenderedView]:
        """So many views of one site, of which ``first`` were planned before."""
        if first // VIEWS_PER_SITE % 10 < self.varied_of_ten:
            return sample_varied_views(self.seed + first, count, near=self.near)
        return sample_views(self.seed + first, self.regime, count, size_px=self.size_px)

    def part(self, number: int, parts: int) -> PoolPlan:
        """What one of several processes renders: other sites than the others do, in the same time."""
        images, shard = (-(-count // parts) for count in (self.images, self.shard))
        sites = -(-images // VIEWS_PER_SITE)
        return replace(self, seed=self.seed + number * sites * VIEWS_PER_SITE, images=images, shard=shard)


class ViewPool:
    """Rendered views, kept as JPEG. Grows while training runs, so that training starts at once and stays seeded."""

    def __init__(self, plan: PoolPlan) -> None:
        self._plan = plan
        self._views: list[tuple[NDArray[np.uint8], LabelledView]] = []
        self._rendered = 0

    def __len__(self) -> int:
        return len(self._views)

    def grow(self, step: int) -> None:
        """Render the shards due at ``step``."""
        due = self._plan.due(step)
        while self._rendered < due:
            count = min(VIEWS_PER_SITE, due - self._rendered)
            for index, view in enumerate(map(labelled, self._plan.views(self._rendered, count))):
                if len(view.classes) or index % _KEPT_EMPTY == 0:
                    _, data = cv2.imencode(".jpg", view.image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
                    self._views.append((np.asarray(data, dtype=np.uint8), replace(view, image=_NO_IMAGE)))
            self._rendered += count

    def draw(self, rng: np.random.Generator) -> LabelledView:
        """A random view."""
        data, view = self._views[int(rng.integers(len(self._views)))]
        return replace(view, image=np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8))


#: A random view of a pool, augmented.
Draw = Callable[[ViewPool, np.random.Generator], LabelledView]


@dataclass(frozen=True, eq=False)
class Batch:
    """Images (B, H, W, 3) uint8 BGR, and what a network should say about them."""

    images: Tensor
    targets: Targets

    @classmethod
    def of(cls, views: list[LabelledView]) -> Batch:
        return cls(
            torch.from_numpy(np.stack([view.image for view in views])),
            encode([replace(view, classes=_CHANNEL_OF[view.classes]) for view in views]),
        )

    def to(self, device: torch.device) -> Batch:
        return self if device.type == "cpu" else Batch(self.images.to(device), self.targets.to(device))


class _Batches(IterableDataset[Batch]):
    """Of several processes, each draws every so many-th batch, from views that it renders itself."""

    def __init__(self, plan: PoolPlan, draw: Draw, count: int, batch_size: int, seed: int, first: int) -> None:
        self._plan, self._draw, self._count, self._batch_size = plan, draw, count, batch_size
        self._seed, self._first = seed, first

    def __iter__(self) -> Iterator[Batch]:
        plan, steps = share_of_processes(self._plan, self._count, self._first)
        pool = ViewPool(plan)
        for step in steps:
            pool.grow(step)  # at those before `first`, too: which views there are depends on the steps at which it grew
            if step >= self._first:
                rng = np.random.default_rng([self._seed, step])
                yield Batch.of([self._draw(pool, rng) for _ in range(self._batch_size)])


def batches(
    plan: PoolPlan, draw: Draw, count: int, batch_size: int, seed: int, workers: int = 0, first: int = 0
) -> Iterable[Batch]:
    """So many batches, seeded; ``workers`` processes render and draw them ahead of training, 0: none does.

    Other numbers of processes give other batches. Those before ``first`` are left out; the others are the same.
    """
    return ahead(_Batches(plan, draw, count, batch_size, seed, first), workers)


def share_of_processes(plan: PoolPlan, count: int, first: int) -> tuple[PoolPlan, range]:
    """What this one of several processes that make batches renders, and which of ``count`` batches it makes.

    Batches are taken from the processes in turn. So which share is a process's depends on ``first``, the first batch
    that is taken: each batch is always of the same share. Of the batches of this share those before it are given, too.
    """
    process = get_worker_info()
    number, processes = (process.id, process.num_workers) if process else (0, 1)
    share = (first + number) % processes
    return plan.part(share, processes), range(share, count, processes)


def ahead(data: IterableDataset[AnyBatch], workers: int) -> Iterable[AnyBatch]:
    """The same batches, made by so many processes ahead of what takes them; 0: made when they are taken."""
    if not workers:
        return data
    # a fork would inherit OpenCV's threads as they stand, and hang
    return DataLoader(
        data, None, num_workers=workers, prefetch_factor=4, worker_init_fn=_one_thread, multiprocessing_context="spawn"
    )


def _one_thread(worker: int) -> None:
    cv2.setNumThreads(1)


def plain_camera(camera: Camera, width_px: int, height_px: int, zoom: float) -> Camera:
    """A distortion-free camera at the same pose whose focal length, in image widths, is ``zoom`` times as long."""
    focal = camera.K[0, 0] * width_px / camera.width_px * zoom
    K = np.array([[focal, 0, (width_px - 1) / 2], [0, focal, (height_px - 1) / 2], [0, 0, 1]])
    return Camera(K, np.zeros(0), camera.T_world_cam, width_px, height_px)


@dataclass(frozen=True)
class Schedule:
    """AdamW with a short linear rise and a cosine fall to 1 % over ``steps``."""

    steps: int
    learning_rate: float
    log_every: int
    checkpoint_every: int

    def rate(self, step: int) -> float:
        rise = min(1.0, (step + 1) / min(_WARM_UP_STEPS, max(self.steps // 10, 1)))
        fall = 0.5 * (1 + math.cos(math.pi * step / self.steps))
        return self.learning_rate * rise * (0.01 + 0.99 * fall)


def pretrain(
    network: Network,
    data: Callable[[int], Iterable[AnyBatch]],
    schedule: Schedule,
    losses: Callable[[Network, AnyBatch], dict[str, Tensor]],
    checkpoint: Callable[[Network, int], dict[str, Any]],
    log_path: Path,
    clock: Callable[[], float],
    device: torch.device,
    state_path: Path | None = None,
) -> Network:
    """Train on ``device``, and return the averaged network, there.

    ``data`` gives a batch for each of the schedule's steps from a given one on; ``losses`` gives the parts and
    ``total`` for a batch on the device; ``checkpoint`` saves and measures the averaged network, and its figures go to
    the log, one JSON object per line. ``clock`` gives seconds from any origin, for the log. At each checkpoint all that
    training needs to go on is written to ``state_path``; where that is there already, training goes on from it, on a
    CPU equal to the bit as long as ``data`` gives the batches that an uninterrupted training would have had.
    """
    network = network.to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    network.train()
    averaged = AveragedWeights(network, 0.998)
    optimizer = torch.optim.AdamW(network.parameters(), lr=schedule.learning_rate, weight_decay=1e-3)
    scaler = Precision.of(device).scaler()
    started = clock()
    recent: dict[str, float] = {}
    state = TrainingState(network, averaged, optimizer, scaler)
    first = 0
    if state_path is not None and state_path.is_file():
        first, recent = state.restore(state_path, device)
    for step, batch in enumerate(data(first), first):
        parts = losses(network, batch.to(device))
        detached = torch.stack([part.detach().double() for part in parts.values()])
        values = dict(zip(parts, detached.tolist(), strict=True))
        if not math.isfinite(values["total"]):
            raise NonFiniteLoss(f"the loss is not finite at step {step}", step=step)
        for group in optimizer.param_groups:
            group["lr"] = schedule.rate(step)
        optimizer.zero_grad(set_to_none=True)
        scaler.scale(parts["total"]).backward()
        scaler.unscale_(optimizer)
        nn.utils.clip_grad_norm_(network.parameters(), _GRADIENT_CLIP)
        scaler.step(optimizer)
        scaler.update()
        averaged.update(network)
        for name, value in values.items():
            recent[name] = 0.98 * recent.get(name, value) + 0.02 * value
        done = step + 1
        record: dict[str, Any] = {"step": done, "seconds": round(clock() - started, 1)}
        if done % schedule.log_every == 0:
            append_log(log_path, record | {name: round(value, 4) for name, value in recent.items()})
        if done % schedule.checkpoint_every == 0 or done == schedule.steps:
            append_log(log_path, record | checkpoint(averaged.network, done))
            if state_path is not None:
                state.save(state_path, done, recent)
    return averaged.network


def add_options(parser: argparse.ArgumentParser, *, steps: int, images: int, batch: int = 8) -> None:
    """What can be chosen for any network."""
    parser.add_argument("--steps", type=int, default=steps)
    parser.add_argument("--images", type=int, default=images, help="views that are rendered in all")
    parser.add_argument("--shard", type=int, default=200, help="views that are rendered at a time")
    parser.add_argument("--batch", type=int, default=batch, help="images a step")
    parser.add_argument("--learning-rate", type=float, default=2e-3)
    parser.add_argument("--checkpoint-every", type=int, default=500, metavar="STEPS")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--workers", type=int, default=0, help="processes that render and draw; 0: training's own")
    parser.add_argument(
        "--resume", action="store_true", help="go on from what an interrupted run left in --out; options as in that"
    )
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="cpu")


def add_varied_options(parser: argparse.ArgumentParser, *, varied: int) -> None:
    """What can be chosen for networks that learn from varied views, too."""
    parser.add_argument(
        "--varied", type=int, default=varied, metavar="N", help="of ten sites, so many have varied views"
    )
    parser.add_argument("--near", type=float, default=0.0, help="share of varied cameras aimed at a vehicle close by")
    parser.add_argument("--start", type=Path, help="exported network of the same kind to go on from")


def prepare(arguments: argparse.Namespace) -> torch.device:
    """Seed torch, make the folder ``--out``, and choose the device, as the options say."""
    device = choose_device(arguments.device, "--device")
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)
    arguments.out.mkdir(parents=True, exist_ok=True)
    if not arguments.resume:
        (arguments.out / STATE).unlink(missing_ok=True)
    return device


def pretrain_as_asked(
    arguments: argparse.Namespace,
    network: Network,
    data: Callable[[int], Iterable[AnyBatch]],
    losses: Callable[[Network, AnyBatch], dict[str, Tensor]],
    checkpoint: Callable[[Network, int], dict[str, Any]],
    device: torch.device,
) -> Network:
    """`pretrain` by the options of `add_options`; the log goes to the folder ``--out``."""
    schedule = Schedule(arguments.steps, arguments.learning_rate, 50, arguments.checkpoint_every)
    log_path, state_path = arguments.out / LOG, arguments.out / STATE
    return pretrain(network, data, schedule, losses, checkpoint, log_path, time.monotonic, device, state_path)


def append_log(path: Path, record: dict[str, Any]) -> None:
    """Add one JSON object as a line."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(record) + "\n")
