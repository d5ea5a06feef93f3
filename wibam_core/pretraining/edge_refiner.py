"""Make the bundled edge refiner: 2D boxes against the still background of other simulated sites' elevated views.

python -m wibam_core.pretraining.edge_refiner --out build/edge_refiner --steps 5000 --images 4000 --workers 1
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional
from torch.utils.data import IterableDataset

from wibam_core.detection.background import UNKNOWN
from wibam_core.detection.crops import CROP_PX, Window, blob
from wibam_core.geometry.boxes2d import clipped_to_image
from wibam_core.geometry.pixels import resized_image
from wibam_core.models.edge_refiner import EdgeRefinerNetwork
from wibam_core.models.export import export_edge_refiner
from wibam_core.pretraining.common import (
    VIEWS_PER_SITE,
    PoolPlan,
    add_options,
    add_varied_options,
    ahead,
    is_taught,
    prepare,
    pretrain_as_asked,
    share_of_processes,
)
from wibam_core.pretraining.exported import load_exported
from wibam_core.synthetic.sampling import RenderedView
from wibam_core.training.augment import compress, jitter_colour
from wibam_core.training.device import Precision
from wibam_core.training.electronics import degraded
from wibam_core.training.views import FloatArray

#: Sizes of the recordings of one site after the other, in turn, but for varied views.
SIZES_PX = ((640, 360), (960, 540), (1280, 720))
TRAINING_SEED = 220_000
VALIDATION_SEED = 310_000
VALIDATION_VIEWS = 120
#: Share of crops that another camera, another hour and another recorder have spoilt, the background with the image.
_DEGRADED = 0.5

#: A patch is this many times as wide and as high as the true box, so that crops around wrong boxes lie within it.
_PATCH = 2.4
#: Patches are shrunk, across and down by itself, until that side of the true box is no longer: crops show no more
#: detail.
_BOX_PX = 80.0
#: How wrong the edges of the boxes are that the refiner learns to correct. Their standard deviation is a share of the
#: side, drawn for each box between 0 and the first number, and the second number in px, added in squares.
_EDGE_SD_SHARE, _EDGE_SD_PX = 0.12, 0.7
#: In this share of the boxes one edge is far off, by up to that share of the side.
_FAR_OFF, _FAR_SHARE = 0.15, 0.3
_WEIGHTS = {"edges": 20.0, "whole": 10.0, "scale": 0.1, "classes": 0.3}


@dataclass(frozen=True, eq=False)
class Patch:
    """A vehicle cut out: image, background and known (h, w, 7) uint8, the boxes (4,) xyxy of what is seen of it and of
    the whole of it, px of the patch, and its class."""

    pixels: NDArray[np.uint8]
    seen: FloatArray
    whole: FloatArray
    vehicle_class: int


@dataclass(frozen=True, eq=False)
class Crops:
    """B crops (B, 7, S, S), the edges (B, 4) of what is seen and of the whole in shares of the crop, classes (B,)."""

    images: Tensor
    seen: Tensor
    whole: Tensor
    classes: Tensor

    def to(self, device: torch.device) -> Crops:
        """The same on ``device``."""
        return Crops(*(getattr(self, field.name).to(device) for field in fields(self)))


def patches(plan: PoolPlan, first: int, count: int) -> list[Patch]:
    """The vehicles of ``count`` views of a plan, of which ``first`` were rendered before."""
    found: list[Patch] = []
    for done in range(0, count, VIEWS_PER_SITE):
        of_site = replace(plan, size_px=SIZES_PX[(first + done) // VIEWS_PER_SITE % len(SIZES_PX)])
        for view in of_site.views(first + done, min(VIEWS_PER_SITE, count - done)):
            found += [_patch(view, row) for row in np.flatnonzero(is_taught(view)).tolist()]
    return found


def validation_patches(varied: bool) -> list[Patch]:
    """The vehicles that trainings are measured on, of usual or of varied views."""
    plan = PoolPlan(
        VALIDATION_SEED, "elevated", VALIDATION_VIEWS, VALIDATION_VIEWS, 1, SIZES_PX[0], 10 if varied else 0
    )
    return patches(plan, 0, VALIDATION_VIEWS)


def _patch(view: RenderedView, row: int) -> Patch:
    box, whole = view.visible_boxes[row], view.amodal_boxes[row]
    centre, half = (box[:2] + box[2:]) / 2, _PATCH * (box[2:] - box[:2]) / 2 + 4
    height, width = view.image.shape[:2]
    x0, y0 = np.maximum(np.floor(centre - half), 0).astype(int).tolist()
    x1, y1 = np.minimum(np.ceil(centre + half) + 1, [width, height]).astype(int).tolist()
    share = np.minimum(1.0, _BOX_PX / (box[2:] - box[:2]))
    columns, rows = np.maximum(1, np.round(share * [x1 - x0, y1 - y0])).astype(int).tolist()
    parts = [resized_image(image[y0:y1, x0:x1], columns, rows) for image in (view.image, view.still)]
    known = np.full((rows, columns, 1), 255, np.uint8)
    before, after = Window(x0, y0, x1, y1), Window(0, 0, columns, rows)
    seen, all_of_it = (after.to_px(before.to_shares(edges)) for edges in (box, whole))
    return Patch(np.concatenate([*parts, known], axis=2), seen, all_of_it, int(view.vehicles.classes[row]))


def jittered(box: FloatArray, size_px: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """The box (4,) as a detector might give it, inside an image of the given width and height."""
    sides = np.tile(box[2:] - box[:2], 2)
    off = rng.normal(0.0, np.hypot(_EDGE_SD_PX, sides * rng.uniform(0.01, _EDGE_SD_SHARE)))
    if rng.random() < _FAR_OFF:
        edge = int(rng.integers(4))
        off[edge] = rng.uniform(-_FAR_SHARE, _FAR_SHARE) * sides[edge]
    moved = clipped_to_image(box + off, *size_px)
    return np.concatenate([np.minimum(moved[:2], moved[2:] - 2), moved[2:]])


def sample(patch: Patch, rng: np.random.Generator) -> tuple[NDArray[np.float32], FloatArray, FloatArray]:
    """A crop (7, S, S) around a wrong box, and the right edges (4,) of what is seen and of the whole vehicle, in
    shares of the crop."""
    height, width = patch.pixels.shape[:2]
    image, still, known = np.split(patch.pixels, [3, 6], axis=2)
    known = known.copy()
    if rng.random() < _DEGRADED:
        way = int(rng.integers(2**32))
        image = degraded(image, np.random.default_rng(way))
        still = degraded(still, np.random.default_rng(way), noise=False)
    else:
        both = jitter_colour(np.concatenate([image, still]), rng)
        image, still = both[:height].copy(), both[height:].copy()
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
    boxes = np.stack([patch.seen, patch.whole])
    if rng.random() < 0.5:
        image, still, known = (np.ascontiguousarray(part[:, ::-1]) for part in (image, still, known))
        boxes = np.stack([width - 1 - boxes[:, 2], boxes[:, 1], width - 1 - boxes[:, 0], boxes[:, 3]], axis=1)
    given = jittered(boxes[0], (width, height), rng)
    crops, windows = blob(image, np.dstack([still, known]), given[None])
    return crops[0], *windows[0].to_shares(boxes)


class CropBatches(IterableDataset[Crops]):
    """So many batches, seeded, those before ``first`` left out; of several processes, each makes every so many-th, of
    vehicles that it renders."""

    def __init__(self, plan: PoolPlan, count: int, batch_size: int, seed: int, first: int = 0) -> None:
        self._plan, self._count, self._batch_size, self._seed, self._first = plan, count, batch_size, seed, first

    def __iter__(self) -> Iterator[Crops]:
        plan, steps = share_of_processes(self._plan, self._count, self._first)
        pool: list[Patch] = []
        rendered = 0
        for step in steps:
            due = plan.due(step)
            if rendered < due:
                pool += patches(plan, rendered, due - rendered)
                rendered = due
            if step < self._first:
                continue
            rng = np.random.default_rng([self._seed, step])
            chosen = [pool[int(number)] for number in rng.integers(0, len(pool), self._batch_size)]
            crops, seen, whole = zip(*(sample(patch, rng) for patch in chosen), strict=True)
            yield Crops(
                torch.from_numpy(np.stack(crops)).contiguous(memory_format=torch.channels_last),
                torch.from_numpy(np.stack(seen).astype(np.float32)),
                torch.from_numpy(np.stack(whole).astype(np.float32)),
                torch.tensor([patch.vehicle_class for patch in chosen]),
            )


def losses(network: EdgeRefinerNetwork, batch: Crops) -> dict[str, Tensor]:
    """L1 of the edges, likelihood of the whole vehicle's errors under the scales, cross entropy of the classes."""
    with Precision.of(batch.images.device).autocast():
        maps, summary = network.features(batch.images)
    found = network.heads(maps.float(), summary.float())
    error = (found.whole - batch.whole).abs()
    parts = {
        "edges": (found.edges - batch.seen).abs().mean(),
        "whole": error.clamp(max=1.0).mean(),
        "scale": (error.detach() * torch.exp(-found.log_scale) + found.log_scale).mean(),
        "classes": functional.cross_entropy(found.classes, batch.classes),
    }
    weighted = {name: part * _WEIGHTS[name] for name, part in parts.items()}
    return {**weighted, "total": torch.stack(list(weighted.values())).sum()}


def measure(network: EdgeRefinerNetwork, found: list[Patch]) -> dict[str, Any]:
    """Errors of edges in shares of their box's side: before and after, of edges in sight and of hidden ones; the mean
    of the errors in expected ones; and the share of right classes."""
    rng = np.random.default_rng(5)
    before, after, whole, hidden, ratio, right = [], [], [], [], [], []
    network.eval()
    device = next(network.parameters()).device
    for patch in found:
        height, width = patch.pixels.shape[:2]
        given = jittered(patch.seen, (width, height), rng)
        crops, windows = blob(patch.pixels[..., :3], patch.pixels[..., 3:], given[None])
        with torch.inference_mode():
            said = network(torch.from_numpy(crops).to(device))
        sides = np.tile(patch.seen[2:] - patch.seen[:2], 2)
        edges, all_of_it = (windows[0].to_px(part[0].double().cpu().numpy()) for part in (said.edges, said.whole))
        after.append(np.abs(edges - patch.seen) / sides)
        whole.append(np.abs(all_of_it - patch.whole) / sides)
        before.append(np.abs(given - patch.seen) / sides)
        hidden.append(np.abs(patch.whole - patch.seen) > 0.02 * sides)
        scale = np.exp(said.log_scale[0].double().cpu().numpy()) * np.tile(windows[0].size, 2) / sides
        ratio.append(whole[-1] / scale)
        right.append(int(said.classes.argmax()) == patch.vehicle_class)
    behind, off = np.array(hidden), np.array(whole)
    return {
        "vehicles": len(found),
        "before_mean": round(float(np.mean(before)), 4),
        "after_mean": round(float(np.mean(after)), 4),
        "after_median": round(float(np.median(after)), 4),
        "hidden_share": round(float(behind.mean()), 4),
        "hidden_mean": round(float(off[behind].mean()), 4),
        "hidden_median": round(float(np.median(off[behind])), 4),
        "in_sight_mean": round(float(off[~behind].mean()), 4),
        "in_expected_errors": round(float(np.mean(ratio)), 3),
        "classes_right": round(float(np.mean(right)), 4),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Train the bundled edge refiner on simulated elevated views.")
    parser.add_argument("--out", type=Path, default=Path("build/edge_refiner"), help="folder for weights and log")
    add_options(parser, steps=5000, images=4000, batch=64)
    add_varied_options(parser, varied=6)
    arguments = parser.parse_args()
    device = prepare(arguments)
    validation = {"usual": validation_patches(False), "varied": validation_patches(True)}
    plan = PoolPlan.within(  # but for the size: `patches` lets sites take turns
        arguments.steps, TRAINING_SEED + arguments.seed, "elevated", arguments.images, arguments.shard, SIZES_PX[0]
    )
    plan = replace(plan, varied_of_ten=arguments.varied, near=arguments.near)
    network = EdgeRefinerNetwork()
    if arguments.start:
        rng = np.random.default_rng(arguments.seed)
        usual = patches(replace(plan, seed=TRAINING_SEED - VIEWS_PER_SITE, varied_of_ten=0), 0, VIEWS_PER_SITE)
        load_exported(arguments.start, network, torch.from_numpy(np.stack([sample(patch, rng)[0] for patch in usual])))

    def checkpoint(averaged: EdgeRefinerNetwork, step: int) -> dict[str, Any]:
        export_edge_refiner(averaged, arguments.out / "edge_refiner.onnx", CROP_PX)
        return {name: measure(averaged, found) for name, found in validation.items()}

    def data(first: int) -> Iterable[Crops]:
        return ahead(CropBatches(plan, arguments.steps, arguments.batch, arguments.seed, first), arguments.workers)

    pretrain_as_asked(arguments, network, data, losses, checkpoint, device)


if __name__ == "__main__":
    main()
