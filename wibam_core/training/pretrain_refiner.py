"""Make the bundled edge refiner: 2D boxes against the still background of other simulated sites' elevated views.

python -m wibam_core.training.pretrain_refiner --out build/pretrain_refiner --steps 4000
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from wibam_core.detection.background import UNKNOWN
from wibam_core.detection.crops import CROP_PX, blob
from wibam_core.models.export import export_refiner2d
from wibam_core.models.refiner2d import Refiner2D
from wibam_core.training.augment import compress, jitter_colour
from wibam_core.training.device import Precision
from wibam_core.training.pretraining import Schedule, append_log, labelled, render
from wibam_core.training.views import FloatArray

SIZE_PX = (640, 360)
TRAINING_SEED = 220_000
VALIDATION_SEED = 310_000

#: A patch shows so many sides of the true box: room for crops around wrong ones.
_PATCH = 2.4
#: A detector's edges are off by a share of the side, drawn anew for each box up to this s.d., and by this many px.
_EDGE_SD_SHARE, _EDGE_SD_PX = 0.12, 0.7
_WEIGHTS = {"edges": 20.0, "scale": 0.1, "classes": 0.3}


@dataclass(frozen=True, eq=False)
class Patch:
    """A vehicle cut out: image, background and known (h, w, 7) uint8, its box (4,) xyxy in px of the patch, class."""

    pixels: NDArray[np.uint8]
    box: FloatArray
    vehicle_class: int


def patches(seed: int, count: int) -> list[Patch]:
    """The vehicles of ``count`` rendered views."""
    found = []
    for view in render(seed, "elevated", count, SIZE_PX):
        taught = labelled(view)
        known = np.full((*view.image.shape[:2], 1), 255, np.uint8)
        pixels = np.concatenate([view.image, view.still, known], axis=2)
        for box, vehicle_class in zip(taught.boxes2d, taught.classes.tolist(), strict=True):
            centre, half = (box[:2] + box[2:]) / 2, _PATCH * (box[2:] - box[:2]) / 2 + 4
            x0, y0 = np.maximum(np.floor(centre - half), 0).astype(int)
            x1, y1 = np.ceil(centre + half).astype(int) + 1
            found.append(Patch(pixels[y0:y1, x0:x1].copy(), box - [x0, y0, x0, y0], vehicle_class))
    return found


def jittered(box: FloatArray, size_px: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """The box (4,) as a detector might give it, inside an image of the given width and height."""
    sides = np.tile(box[2:] - box[:2], 2)
    off = rng.normal(0.0, np.hypot(_EDGE_SD_PX, sides * rng.uniform(0.01, _EDGE_SD_SHARE)))
    limits = np.tile(np.array(size_px, np.float64), 2) - 0.5
    moved = np.clip(box + off, -0.5, limits)
    return np.concatenate([np.minimum(moved[:2], moved[2:] - 2), moved[2:]])


def sample(patch: Patch, rng: np.random.Generator) -> tuple[NDArray[np.float32], FloatArray]:
    """A crop (7, 64, 64) around a wrong box, and the right edges (4,) in shares of the crop."""
    height, width = patch.pixels.shape[:2]
    image, still, known = np.split(patch.pixels, [3, 6], axis=2)
    both = jitter_colour(np.concatenate([image, still]), rng)
    image, still, known = both[:height].copy(), both[height:].copy(), known.copy()
    if rng.random() < 0.3:
        image = compress(image, rng)
    if rng.random() < 0.5:  # the light has changed since
        table = np.clip(np.arange(256)[:, None] * np.exp(rng.normal(0, 0.04, 3)) + rng.normal(0, 2.0), 0, 255)
        still = np.asarray(cv2.LUT(still, table.astype(np.uint8)[:, None, :]), np.uint8)
    kind = rng.random()
    if kind < 0.1:
        known[:] = 0
    elif kind < 0.3:  # something has always stood here, or has left a trace
        x0, y0 = rng.uniform(0, [width, height]).astype(int)
        w, h = np.maximum(rng.uniform(0.1, 0.7, 2) * [width, height], 1).astype(int)
        part = np.s_[y0 : y0 + h, x0 : x0 + w]
        if kind < 0.2:
            known[part] = 0
        else:
            still[part] = image[part]
    still[known[..., 0] == 0] = UNKNOWN
    box = patch.box
    if rng.random() < 0.5:
        image, still, known = (np.ascontiguousarray(part[:, ::-1]) for part in (image, still, known))
        box = np.array([width - 1 - box[2], box[1], width - 1 - box[0], box[3]])
    given = jittered(box, (width, height), rng)
    crops, windows = blob(image, still, known[..., 0], given[None])
    return crops[0], windows[0].to_shares(box)


def losses(network: Refiner2D, crops: Tensor, edges: Tensor, classes: Tensor) -> dict[str, Tensor]:
    """L1 of the edges, likelihood of their errors under the scales, cross entropy of the classes."""
    with Precision.of(torch.device("cpu")).autocast():
        maps, summary = network.features(crops)
    found, log_scale, logits = network.heads(maps.float(), summary.float())
    error = (found - edges).abs()
    parts = {
        "edges": error.mean(),
        "scale": (error.detach() * torch.exp(-log_scale) + log_scale).mean(),
        "classes": functional.cross_entropy(logits, classes),
    }
    weighted = {name: part * _WEIGHTS[name] for name, part in parts.items()}
    return {**weighted, "total": torch.stack(list(weighted.values())).sum()}


def measure(network: Refiner2D, found: list[Patch]) -> dict[str, float]:
    """Errors of edges in shares of their box's side, before and after, and the share of right classes."""
    rng = np.random.default_rng(5)
    before, after, right = [], [], []
    network.eval()
    for patch in found:
        height, width = patch.pixels.shape[:2]
        given = jittered(patch.box, (width, height), rng)
        image, still, known = np.split(patch.pixels, [3, 6], axis=2)
        crops, windows = blob(image, still, known[..., 0], given[None])
        with torch.inference_mode():
            edges, _, logits = network(torch.from_numpy(crops))
        sides = np.tile(patch.box[2:] - patch.box[:2], 2)
        after.append(np.abs(windows[0].to_px(edges[0].double().numpy()) - patch.box) / sides)
        before.append(np.abs(given - patch.box) / sides)
        right.append(int(logits.argmax()) == patch.vehicle_class)
    return {
        "vehicles": len(found),
        "before_mean": round(float(np.mean(before)), 4),
        "after_mean": round(float(np.mean(after)), 4),
        "after_median": round(float(np.median(after)), 4),
        "classes_right": round(float(np.mean(right)), 4),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Train the bundled edge refiner on simulated elevated views.")
    parser.add_argument("--out", type=Path, default=Path("build/pretrain_refiner"), help="folder for weights and log")
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--images", type=int, default=1000)
    parser.add_argument("--batch", type=int, default=48)
    parser.add_argument("--learning-rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)
    rng = np.random.default_rng(arguments.seed)
    arguments.out.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    validation = patches(VALIDATION_SEED, 80)
    pool = patches(TRAINING_SEED + arguments.seed, arguments.images)
    schedule = Schedule(arguments.steps, arguments.learning_rate, 200, 1000)
    network = Refiner2D().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(network.parameters(), lr=schedule.learning_rate, weight_decay=1e-3)
    recent: dict[str, float] = {}
    for step in range(schedule.steps):
        network.train()
        chosen = [pool[int(number)] for number in rng.integers(0, len(pool), arguments.batch)]
        drawn = [sample(patch, rng) for patch in chosen]
        parts = losses(
            network,
            torch.from_numpy(np.stack([crop for crop, _ in drawn])).contiguous(memory_format=torch.channels_last),
            torch.from_numpy(np.stack([edges for _, edges in drawn]).astype(np.float32)),
            torch.tensor([patch.vehicle_class for patch in chosen]),
        )
        for group in optimizer.param_groups:
            group["lr"] = schedule.rate(step)
        optimizer.zero_grad(set_to_none=True)
        parts["total"].backward()
        nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimizer.step()
        for name, part in parts.items():
            recent[name] = 0.98 * recent.get(name, float(part.detach())) + 0.02 * float(part.detach())
        done = step + 1
        record = {"step": done, "vehicles": len(pool), "seconds": round(time.monotonic() - started, 1)}
        if done % schedule.log_every == 0:
            append_log(arguments.out / "log.jsonl", record | {name: round(v, 4) for name, v in recent.items()})
        if done % schedule.checkpoint_every == 0 or done == schedule.steps:
            append_log(arguments.out / "log.jsonl", record | measure(network, validation))
            export_refiner2d(network, arguments.out / "refiner2d.onnx", CROP_PX)


if __name__ == "__main__":
    main()
