"""Make the bundled 2D detector: training on elevated views of other simulated sites, 2D boxes alone.

python -m wibam_core.pretraining.detector --out build/pretrain_detector --steps 3000
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from wibam_core.geometry.boxes2d import image_iou
from wibam_core.geometry.torch_ops import giou
from wibam_core.models.detector2d import Detector2D
from wibam_core.models.export import export_detector2d
from wibam_core.models.frames import to_input
from wibam_core.models.peaks import cell_centres_px
from wibam_core.models.trunk import STRIDE
from wibam_core.pretraining.common import (
    Batch,
    PoolPlan,
    ViewPool,
    add_options,
    add_varied_options,
    batches,
    labelled,
    plain_camera,
    prepare,
    pretrain_as_asked,
    render,
)
from wibam_core.pretraining.exported import load_exported
from wibam_core.synthetic.sampling import RenderedView
from wibam_core.training.augment import compress, cut_out, jitter_colour, mirror, rewarp
from wibam_core.training.device import Precision
from wibam_core.training.electronics import degraded
from wibam_core.training.losses import focal_loss
from wibam_core.training.views import FloatArray, LabelledView

WIDTH_PX, HEIGHT_PX = 512, 288
RENDERED_PX = (544, 306)

TRAINING_SEED = 200_000
VALIDATION_SEED = 310_000

#: Focal length of the trained images against the rendered ones' at the same width.
_ZOOM = (0.75, 1.8)
#: Share of images that another camera, another hour and another recorder have spoilt.
_DEGRADED = 0.5

_BOX_WEIGHT = 2.0
_MIN_SCORE = 0.3
_MATCH_IOU = 0.5


def augmented(pool: ViewPool, rng: np.random.Generator) -> LabelledView:
    """A random view zoomed, shifted, flipped, recoloured, cut out and compressed, or degraded in more ways.

    The camera is not turned: boxes around warped boxes would be looser than boxes around warped vehicles.
    """
    view = pool.draw(rng)
    zoom = float(np.exp(rng.uniform(*np.log(_ZOOM))))
    camera = plain_camera(view.camera, WIDTH_PX, HEIGHT_PX, zoom)
    smaller = view.camera.width_px / (WIDTH_PX * zoom)
    if smaller > 1.2:  # what is made smaller must not flicker
        view = replace(view, image=np.asarray(cv2.GaussianBlur(view.image, (0, 0), 0.35 * smaller), np.uint8))
    shift = np.zeros((3, 3))
    shift[:2, 2] = rng.normal(0.0, [0.08 * WIDTH_PX, 0.08 * HEIGHT_PX])
    fill = rng.integers(0, 256, 3)
    view = rewarp(view, replace(camera, K=camera.K + shift), (int(fill[0]), int(fill[1]), int(fill[2])))
    if rng.random() < 0.5:
        view = mirror(view)
    if rng.random() < _DEGRADED:
        return replace(view, image=degraded(cut_out(view.image, rng), rng))
    image = cut_out(jitter_colour(view.image, rng), rng)
    return replace(view, image=compress(image, rng) if rng.random() < 0.3 else image)


def losses(network: Detector2D, batch: Batch) -> dict[str, Tensor]:
    """Focal loss of the heat and 1 − GIoU of the boxes at taught cells."""
    targets, device = batch.targets, batch.images.device
    with Precision.of(device).autocast():
        logits, log_ltrb = network(to_input(batch.images, device))
    heat = focal_loss(logits, targets.heat, targets.judged)
    distances = log_ltrb[targets.image, :, targets.cells[:, 1], targets.cells[:, 0]].clamp(-3.0, 5.0).exp()
    predicted = torch.cat([-distances[:, :2], distances[:, 2:]], dim=1)
    half = targets.box2d[:, 2:].exp() / 2
    wanted = torch.cat([targets.box2d[:, :2] - half, targets.box2d[:, :2] + half], dim=1)
    boxes = _BOX_WEIGHT * (1 - giou(predicted, wanted)).sum() / max(len(wanted), 1)
    return {"heat": heat, "boxes": boxes, "total": heat + boxes}


def detect(network: Detector2D, image: np.ndarray) -> FloatArray:
    """Boxes (N, 4) xyxy of one image of the input's size, without suppression of duplicates."""
    with torch.inference_mode():
        logits, log_ltrb = (maps.cpu() for maps in network(to_input(image[None], next(network.parameters()).device)))
        heat = logits.sigmoid().amax(dim=1)
        peak = (torch.nn.functional.max_pool2d(heat[:, None], 3, 1, 1)[:, 0] == heat) & (heat >= _MIN_SCORE)
        _, y, x = peak.nonzero(as_tuple=True)
        distances = log_ltrb[0, :, y, x].T.clamp(-3.0, 5.0).exp() * STRIDE
    centre = cell_centres_px(torch.stack([x, y], dim=1))
    return torch.cat([centre - distances[:, :2], centre + distances[:, 2:]], dim=1).double().numpy()


def measure_views(network: Detector2D, views: list[RenderedView]) -> dict[str, float]:
    """Recall and precision at IoU 0.5 and score 0.3, and the mean IoU of matches."""
    network.eval()
    wanted = found = matched = 0
    overlaps: list[float] = []
    for view in views:
        taught = labelled(view)
        predicted = detect(network, view.image)
        overlap = image_iou(predicted, taught.boxes2d)
        best = overlap.max(axis=0, initial=0.0)
        optional = image_iou(predicted, view.visible_boxes).max(axis=1, initial=0.0) >= 0.3
        hit = overlap.max(axis=1, initial=0.0) >= _MATCH_IOU
        wanted += len(best)
        matched += int((best >= _MATCH_IOU).sum())
        found += int((hit | ~optional).sum())
        overlaps += best[best >= _MATCH_IOU].tolist()
    return {
        "recall": round(matched / max(wanted, 1), 4),
        "precision": round(matched / max(found, 1), 4),
        "mean_iou": round(float(np.mean(overlaps)) if overlaps else 0.0, 4),
        "vehicles": wanted,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Train the bundled 2D detector on simulated elevated views.")
    parser.add_argument("--out", type=Path, default=Path("build/pretrain_detector"), help="folder for weights and log")
    add_options(parser, steps=3000, images=1200)
    add_varied_options(parser, varied=6)
    arguments = parser.parse_args()
    device = prepare(arguments)
    validation = render(VALIDATION_SEED, "elevated", 80, (WIDTH_PX, HEIGHT_PX))
    plan = PoolPlan.within(
        arguments.steps, TRAINING_SEED + arguments.seed, "elevated", arguments.images, arguments.shard, RENDERED_PX
    )
    plan = replace(plan, varied_of_ten=arguments.varied, near=arguments.near)
    network = Detector2D()
    if arguments.start:
        usual = np.stack([view.image for view in render(TRAINING_SEED - 20, "elevated", 20, (WIDTH_PX, HEIGHT_PX))])
        load_exported(arguments.start, network, to_input(usual, torch.device("cpu")))

    def checkpoint(averaged: Detector2D, step: int) -> dict[str, Any]:
        export_detector2d(averaged, arguments.out / "detector2d.onnx")
        return {"elevated": measure_views(averaged, validation)}

    data = partial(batches, plan, augmented, arguments.steps, arguments.batch, arguments.seed, arguments.workers)
    pretrain_as_asked(arguments, network, data, losses, checkpoint, device)


if __name__ == "__main__":
    main()
