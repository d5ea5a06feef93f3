"""Make the bundled monocular network: pre-training on street-level views alone.

    python -m wibam_core.pretraining.monocular --out build/pretrain --steps 4500

Street-level images are turned by virtual rotations and zooms of their cameras, so that the network meets pitched
cameras without ever seeing an elevated one. Elevated views are only ever measured on, never learned from or chosen by.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from wibam_core.models.frames import Frame, to_input
from wibam_core.models.network import predict
from wibam_core.networks.registry import read_card, save_network
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.small.losses import LossWeights, lifted_loss
from wibam_core.networks.small.network import SmallMonocular
from wibam_core.placing import Decode
from wibam_core.pretraining.common import (
    LOG,
    Batch,
    PoolPlan,
    ViewPool,
    add_options,
    append_log,
    batches,
    labelled,
    plain_camera,
    prepare,
    pretrain_as_asked,
    render,
)
from wibam_core.pretraining.validation import ViewResult, measure
from wibam_core.synthetic.sampling import RenderedView
from wibam_core.training.augment import compress, cut_out, jitter_colour, mirror, rewarp, turn_camera
from wibam_core.training.device import Precision
from wibam_core.training.views import LabelledView

#: Size of the images that are trained on: parts of images that are `INPUT_WIDTH_PX` wide.
WIDTH_PX, HEIGHT_PX = 512, 288
_MEASURED_PX = (640, 360)

TRAINING_SEED = 100_000
VALIDATION_SEED = 300_000
SITE_REPORT_SEED = 400_000

#: Ground corners under plane decoding mean nothing from 1.6 m up, where rays graze the ground.
WEIGHTS = LossWeights(corners=0.0)

_REPORT_RANGE_M = 40.0
_MIN_SCORE = 0.3


def augmented(pool: ViewPool, rng: np.random.Generator, zoom: tuple[float, float] = (0.85, 1.8)) -> LabelledView:
    """A random view through a random virtual camera, flipped, recoloured, cut out and compressed.

    ``zoom`` bounds the focal length of the trained images against the rendered ones' at the same width.
    """
    view = virtual_view(pool.draw(rng), rng, zoom)
    if rng.random() < 0.5:
        view = mirror(view)
    image = cut_out(jitter_colour(view.image, rng), rng)
    return replace(view, image=compress(image, rng) if rng.random() < 0.3 else image)


def virtual_view(view: LabelledView, rng: np.random.Generator, zoom: tuple[float, float]) -> LabelledView:
    """The view turned down as far as a randomly chosen vehicle stays in the image, zoomed and rolled a little."""
    camera = plain_camera(view.camera, WIDTH_PX, HEIGHT_PX, float(np.exp(rng.uniform(*np.log(zoom)))))
    down = left = 0.0
    if len(view.classes):
        box = view.boxes2d[rng.integers(len(view.classes))]
        ray = view.camera.undistort((box[:2] + box[2:]) / 2)
        half = np.arctan(HEIGHT_PX / 2 / camera.K[1, 1])
        if rng.random() < 0.75:
            down = float(rng.uniform(-0.03, max(np.arctan(ray[1]) + 0.92 * half, 0.0)))
        else:
            down = float(rng.normal(0.0, 0.03))
        left = float(-np.arctan(ray[0]) * rng.uniform(0.0, 0.8) * (rng.random() < 0.5) + rng.normal(0.0, 0.05))
    turned = turn_camera(camera, down, left, float(rng.normal(0.0, 0.03)))
    fill = rng.integers(0, 256, 3)
    return rewarp(view, replace(camera, T_world_cam=turned), (int(fill[0]), int(fill[1]), int(fill[2])))


def losses(network: SmallNetwork, batch: Batch) -> dict[str, Tensor]:
    """Parts and total for a batch, in mixed precision."""
    device = batch.images.device
    with Precision.of(device).autocast():
        outputs = network(to_input(batch.images, device))
    return lifted_loss(outputs, batch.targets, network.mean_sizes_m, WEIGHTS)


def measure_views(network: SmallNetwork, views: list[RenderedView], decode: Decode) -> dict[str, float]:
    """Figures within 40 m on rendered views."""
    frames = (Frame(view.image, view.camera, str(index), index) for index, view in enumerate(views))
    found = predict(SmallMonocular(network), frames, decode=decode, min_score=_MIN_SCORE)

    def results() -> Iterator[ViewResult]:
        for view, predicted in zip(views, found, strict=True):
            taught = labelled(view)
            centre = view.camera.centre_m[:2]

            def within(boxes: np.ndarray, limit: float, centre: np.ndarray = centre) -> np.ndarray:
                return boxes[np.linalg.norm(boxes[:, :2] - centre, axis=1) <= limit]

            wanted = within(taught.boxes3d, _REPORT_RANGE_M)
            yield ViewResult(within(predicted.boxes, _REPORT_RANGE_M), wanted, view.vehicles.boxes)

    return {name: round(value, 4) for name, value in measure(results()).items()}


def main() -> None:
    parser = argparse.ArgumentParser(description="Pre-train the bundled monocular network on street-level views.")
    parser.add_argument("--out", type=Path, default=Path("build/pretrain"), help="folder for weights and log")
    add_options(parser, steps=4500, images=3000)
    parser.add_argument("--views", type=int, default=80, help="views that are measured on, of each kind")
    parser.add_argument("--rendered", type=int, nargs=2, default=(704, 496), help="width and height, px")
    parser.add_argument("--zoom", type=float, nargs=2, default=(0.85, 1.8), help="of the trained against the rendered")
    parser.add_argument("--start", type=Path, help="weights to go on from; with --steps 0 they are only measured")
    arguments = parser.parse_args()
    device = prepare(arguments)
    start = arguments.start
    network = SmallMonocular.load(start, read_card(start)).module if start else SmallNetwork()
    validation = render(VALIDATION_SEED, "ego", arguments.views, _MEASURED_PX)
    site = render(SITE_REPORT_SEED, "site", arguments.views, _MEASURED_PX)
    plan = PoolPlan.within(
        arguments.steps,
        TRAINING_SEED + arguments.seed,
        "ego",
        arguments.images,
        arguments.shard,
        (arguments.rendered[0], arguments.rendered[1]),
    )

    def figures(averaged: SmallNetwork) -> dict[str, Any]:
        return {
            "ego_depth": measure_views(averaged, validation, "depth"),
            "ego_refined": measure_views(averaged, validation, "refined"),
            "site_plane": measure_views(averaged, site, "plane"),
            "site_depth": measure_views(averaged, site, "depth"),
            "site_refined": measure_views(averaged, site, "refined"),
        }

    def checkpoint(averaged: SmallNetwork, step: int) -> dict[str, Any]:
        save_network(SmallMonocular(averaged), arguments.out / "mono_small.safetensors")
        return figures(averaged)

    if arguments.steps == 0:
        append_log(arguments.out / LOG, figures(network.to(device)))
        return
    draw = partial(augmented, zoom=(arguments.zoom[0], arguments.zoom[1]))
    data = partial(batches, plan, draw, arguments.steps, arguments.batch, arguments.seed, arguments.workers)
    pretrain_as_asked(arguments, network, data, losses, checkpoint, device)


if __name__ == "__main__":
    main()
