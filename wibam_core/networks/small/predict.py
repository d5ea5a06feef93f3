"""Run the small network over frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.geometry.boxes2d import distinct
from wibam_core.geometry.pixels import resized_px
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.models.frames import Frame, prepare_camera, prepare_image
from wibam_core.models.peaks import DUPLICATE_IOU, Peaks, find_peaks, standing_apart
from wibam_core.models.second_look import Edges, SecondLook
from wibam_core.networks.small.architecture import SmallOutputs
from wibam_core.networks.small.decode import PeakValues, boxes2d_px, boxes3d, gather, gather_around, standard_deviations
from wibam_core.networks.small.reconcile import reconciled
from wibam_core.placing import Decode
from wibam_core.road_users import BODIES
from wibam_core.scene import Vehicles3D


@dataclass(frozen=True, eq=False)
class Maps:
    """What runs the small network, and what belongs to its maps.

    Attributes:
        run: prepared images (B, H, W, 3) uint8 to maps on the CPU.
        mean_sizes_m: (C, 3) mean length, width and height of each class, float32.
        numbers: (C,) index into `CLASSES` of each class.
        input_width_px: how wide images are when they are prepared.
    """

    run: Callable[[NDArray[np.uint8]], SmallOutputs]
    mean_sizes_m: Tensor
    numbers: NDArray[np.int64]
    input_width_px: int


def predict_each(
    maps: Maps, frames: Iterable[Frame], *, decodes: Sequence[Decode], min_score: float, batch_size: int
) -> Iterator[tuple[Vehicles3D, ...]]:
    """Detect vehicles, see `wibam_core.models.network.Network.predict_each`.

    Args:
        maps: of the network.
        frames: consumed as needed, at most ``batch_size`` in memory.
        decodes: how boxes are placed, see `wibam_core.networks.small.decode.boxes3d`.
        min_score: peaks below it are left out.
        batch_size: images per pass; images of one batch have equal prepared sizes.
    """
    look = SecondLook() if "refined" in decodes else None
    batch: list[Frame] = []
    images: list[NDArray[np.uint8]] = []
    for frame in frames:
        image = prepare_image(frame.image, maps.input_width_px)
        if batch and (len(batch) == batch_size or image.shape != images[0].shape):
            yield from _predict_batch(maps, batch, images, decodes, look, min_score)
            batch, images = [], []
        batch.append(frame)
        images.append(image)
    if batch:
        yield from _predict_batch(maps, batch, images, decodes, look, min_score)


def _predict_batch(
    maps: Maps,
    frames: list[Frame],
    images: list[NDArray[np.uint8]],
    decodes: Sequence[Decode],
    look: SecondLook | None,
    min_score: float,
) -> Iterator[tuple[Vehicles3D, ...]]:
    with torch.inference_mode():
        outputs = maps.run(np.stack(images))
        peaks = find_peaks(outputs.heat, min_score)
        prepared = [prepare_camera(frame.camera, maps.input_width_px) for frame in frames]
        cameras = CameraTensors.from_cameras(prepared, torch.float64)
        ways = [_placed(maps, outputs, peaks, frames, cameras, decode, look) for decode in decodes]
    yield from zip(*ways, strict=True)


def _placed(
    maps: Maps,
    outputs: SmallOutputs,
    peaks: Peaks,
    frames: list[Frame],
    cameras: CameraTensors,
    decode: Decode,
    look: SecondLook | None,
) -> list[Vehicles3D]:
    """The vehicles of each frame of a batch."""
    fits = decode in ("fitted", "refined")
    read = gather_around if fits else gather
    values = read(outputs, peaks.image, peaks.cells, peaks.classes)
    boxes = boxes3d(values, cameras, maps.mean_sizes_m, decode)
    kept = kept_peaks(peaks.image, boxes, boxes2d_px(values))
    values, boxes = values[kept], boxes[kept]
    sd = standard_deviations(values, boxes, cameras, decode)
    numbers = maps.numbers[values.classes.numpy()]
    if fits:
        edges = _edges(look, frames, cameras, values) if look is not None and decode == "refined" else None
        boxes, sd = reconciled(values, boxes, sd, cameras, torch.from_numpy(BODIES[numbers]), edges)
    scores = peaks.scores[kept].double().numpy()
    found = []
    for index, frame in enumerate(frames):
        mine = np.flatnonzero(values.image.numpy() == index)
        if fits:  # else places err by metres, and vehicles in a queue overlap
            mine = mine[standing_apart(boxes.numpy()[mine], numbers[mine])]
        found.append(
            Vehicles3D.of(
                frame.time_ns,
                boxes.numpy()[mine],
                classes=numbers[mine],
                scores=scores[mine],
                sd=sd.numpy()[mine],
                camera_id=frame.camera_id,
            )
        )
    return found


def _edges(look: SecondLook, frames: list[Frame], cameras: CameraTensors, values: PeakValues) -> Edges:
    """Edges of the vehicles of a batch after a second look at the frames' own pixels, px of the network's input."""
    native = torch.tensor([frame.image.shape[1::-1] for frame in frames], dtype=torch.float64)
    scale = (native / cameras.size)[values.image].repeat(1, 2)
    boxes = resized_px(boxes2d_px(values), scale)
    counts = values.image.bincount(minlength=len(frames)).tolist()  # peaks come image by image
    with ThreadPoolExecutor(max_workers=torch.get_num_threads()) as pool:
        of_images = (of.numpy() for of in boxes.split(counts))
        seen = list(pool.map(look.edges, (frame.image for frame in frames), of_images))
    px, sd_px = (torch.cat(of) for of in zip(*seen, strict=True))
    return Edges(resized_px(px, 1 / scale), sd_px / scale)


def kept_peaks(image: Tensor, boxes: Tensor, boxes2d: Tensor) -> Tensor:
    """Indices of the peaks whose boxes (N, 7) are finite, and no duplicates of a better one in the same image (N,)."""
    finite = boxes.isfinite().all(dim=1)
    kept = []
    for number in image.unique().tolist():
        mine = ((image == number) & finite).nonzero()[:, 0]
        kept.append(mine[torch.from_numpy(distinct(boxes2d[mine].numpy(), DUPLICATE_IOU))])
    return torch.cat(kept) if kept else image
