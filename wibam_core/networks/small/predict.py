"""Run the small network over frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.geometry.boxes2d import distinct
from wibam_core.geometry.pixels import resized_px
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.models.frames import Frame, prepare_camera, prepare_image, to_input
from wibam_core.models.peaks import DUPLICATE_IOU, Peaks, find_peaks
from wibam_core.models.second_look import Edges, SecondLook
from wibam_core.networks.small.architecture import SmallNetwork, SmallOutputs
from wibam_core.networks.small.decode import PeakValues, boxes2d_px, boxes3d, gather, gather_around, standard_deviations
from wibam_core.networks.small.onnx_network import OnnxNetwork
from wibam_core.networks.small.reconcile import reconciled
from wibam_core.placing import Decode
from wibam_core.scene import Vehicles3D

#: The small network in torch, on any device, or in ONNX Runtime.
RunnableNetwork = SmallNetwork | OnnxNetwork


def predict(
    network: RunnableNetwork, frames: Iterable[Frame], *, decode: Decode, min_score: float, batch_size: int = 8
) -> Iterator[Vehicles3D]:
    """Detect vehicles: one `Vehicles3D` in the world per frame, in the frames' order.

    Args:
        network: torch's is put into evaluation mode, and runs on its own device. It sees images at its input width.
        frames: consumed as needed, at most ``batch_size`` in memory.
        decode: how boxes are placed, see `wibam_core.networks.small.decode.boxes3d`.
        min_score: peaks below it are left out.
        batch_size: images per pass; images of one batch have equal prepared sizes.
    """
    placed = predict_each(network, frames, decodes=(decode,), min_score=min_score, batch_size=batch_size)
    return (vehicles for (vehicles,) in placed)


def predict_each(
    network: RunnableNetwork,
    frames: Iterable[Frame],
    *,
    decodes: Sequence[Decode],
    min_score: float,
    batch_size: int = 8,
) -> Iterator[tuple[Vehicles3D, ...]]:
    """As `predict`, but boxes are placed in several ways while the network runs once: per frame a result of each."""
    look = SecondLook() if "refined" in decodes else None
    batch: list[Frame] = []
    images: list[NDArray[np.uint8]] = []
    for frame in frames:
        image = prepare_image(frame.image, network.input_width_px)
        if batch and (len(batch) == batch_size or image.shape != images[0].shape):
            yield from _predict_batch(network, batch, images, decodes, look, min_score)
            batch, images = [], []
        batch.append(frame)
        images.append(image)
    if batch:
        yield from _predict_batch(network, batch, images, decodes, look, min_score)


def _run(network: RunnableNetwork, images: NDArray[np.uint8]) -> SmallOutputs:
    """The maps of prepared images (B, H, W, 3), on the CPU."""
    if isinstance(network, OnnxNetwork):
        return network(to_input(images, layout=torch.contiguous_format))
    network.eval()
    outputs: SmallOutputs = network(to_input(images, network.mean_sizes_m.device))
    return SmallOutputs(**{name: values.cpu() for name, values in vars(outputs).items()})


def _predict_batch(
    network: RunnableNetwork,
    frames: list[Frame],
    images: list[NDArray[np.uint8]],
    decodes: Sequence[Decode],
    look: SecondLook | None,
    min_score: float,
) -> Iterator[tuple[Vehicles3D, ...]]:
    with torch.inference_mode():
        outputs = _run(network, np.stack(images))
        peaks = find_peaks(outputs.heat, min_score)
        sizes_m = network.mean_sizes_m.cpu()
        prepared = [prepare_camera(frame.camera, network.input_width_px) for frame in frames]
        cameras = CameraTensors.from_cameras(prepared, torch.float64)
        ways = [_placed(outputs, peaks, frames, cameras, sizes_m, decode, look) for decode in decodes]
    yield from zip(*ways, strict=True)


def _placed(
    outputs: SmallOutputs,
    peaks: Peaks,
    frames: list[Frame],
    cameras: CameraTensors,
    mean_sizes_m: Tensor,
    decode: Decode,
    look: SecondLook | None,
) -> list[Vehicles3D]:
    """The vehicles of each frame of a batch."""
    fits = decode in ("fitted", "refined")
    read = gather_around if fits else gather
    values = read(outputs, peaks.image, peaks.cells, peaks.classes)
    boxes = boxes3d(values, cameras, mean_sizes_m, decode)
    kept = kept_peaks(peaks.image, boxes, boxes2d_px(values))
    values, boxes = values[kept], boxes[kept]
    sd = standard_deviations(values, boxes, cameras, decode)
    if fits:
        edges = _edges(look, frames, cameras, values) if look is not None and decode == "refined" else None
        boxes, sd = reconciled(values, boxes, sd, cameras, edges)
    scores = peaks.scores[kept].double().numpy()
    found = []
    for index, frame in enumerate(frames):
        mine = np.flatnonzero(values.image.numpy() == index)
        found.append(
            Vehicles3D.of(
                frame.time_ns,
                boxes.numpy()[mine],
                classes=values.classes.numpy()[mine],
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
