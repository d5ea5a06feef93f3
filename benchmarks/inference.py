"""What detecting vehicles in images costs beside the network alone, in torch and in ONNX Runtime.

Per way of running the small network: the time from images to boxes (resizing, network, duplicates, decoding) over the
network's own on prepared input, both in CPU time on one thread, without a second look at the vehicles ("fitted") and
with it ("refined"), which takes as much longer as there are vehicles; ONNX Runtime's over torch's; images per second.
Images are simulated, of the size that the service stores. All are timed in turn, round by round; printed is the median
of the rounds with its quartiles. `benchmarks/gpu.py` measures GPUs.

Run: python benchmarks/inference.py [--rounds 30] [--images 16] [--batch 8] [--weights FILE.safetensors]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.models.frames import Frame, prepare_image, to_input
from wibam_core.models.network import predict
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import load_network
from wibam_core.networks.small.network import SmallMonocular
from wibam_core.networks.small.onnx_network import OnnxNetwork
from wibam_core.placing import Decode
from wibam_core.synthetic.sampling import sample_views

SIZE_PX = (960, 540)
DECODES: tuple[Decode, ...] = ("fitted", "refined")
MIN_SCORE = 0.1
SEED = 900_001

Detector = SmallMonocular | OnnxNetwork


@dataclass(frozen=True)
class Way:
    """A network, what of it is the network alone, and the images as its input, in batches as it takes them."""

    name: str
    detector: Detector
    network: Callable[[Tensor], object]
    inputs: list[Tensor]

    def forward(self) -> None:
        """The network alone over all images."""
        with torch.inference_mode():
            for batch in self.inputs:
                self.network(batch)


def load_small(path: Path) -> SmallMonocular:
    network = load_network(path)
    assert isinstance(network, SmallMonocular), f"{path} holds another network"
    return network


def batches_of(frames: list[Frame], size: int, device: str, layout: torch.memory_format) -> list[Tensor]:
    prepared = [prepare_image(frame.image) for frame in frames]
    return [
        to_input(np.stack(prepared[start : start + size]), device).contiguous(memory_format=layout)
        for start in range(0, len(prepared), size)
    ]


def timed(work: Callable[[], object], clock: Callable[[], float]) -> float:
    start = clock()
    work()
    return clock() - start


def measure(
    ways: list[Way], frames: list[Frame], batch: int, rounds: int, clock: Callable[[], float]
) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Seconds (rounds,) of "forward", and to boxes by each of `DECODES`, over all images, by way."""
    taken: dict[str, dict[str, list[float]]] = {way.name: {name: [] for name in ("forward", *DECODES)} for way in ways}
    for number in range(rounds + 2):
        for way in ways:

            def boxes(decode: Decode, detector: Detector = way.detector) -> None:
                list(detector.predict_each(frames, decodes=(decode,), min_score=MIN_SCORE, batch_size=batch))

            seconds = {"forward": timed(way.forward, clock)}
            seconds |= {str(decode): timed(partial(boxes, decode), clock) for decode in DECODES}
            if number >= 2:  # the first rounds warm up
                for name, value in seconds.items():
                    taken[way.name][name].append(value)
    return {way: {name: np.array(values) for name, values in by.items()} for way, by in taken.items()}


def spread(values: NDArray[np.float64]) -> str:
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.3f} ({low:.3f} to {high:.3f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--images", type=int, default=16)
    parser.add_argument("--batch", type=int, default=8, help="images per pass")
    parser.add_argument("--weights", type=Path, default=bundled("mono_small.safetensors"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    frames = [
        Frame(view.image, view.camera, "camera", number)
        for number, view in enumerate(sample_views(SEED, "site", arguments.images, SIZE_PX))
    ]
    network = load_small(arguments.weights)
    exported = OnnxNetwork.of(network.onnx(), 1)
    channels_last = batches_of(frames, arguments.batch, "cpu", torch.channels_last)
    contiguous = batches_of(frames, arguments.batch, "cpu", torch.contiguous_format)
    ways = [
        Way("torch", network, network.module, channels_last),
        Way("ONNX Runtime", exported, exported, contiguous),
    ]
    taken = measure(ways, frames, arguments.batch, arguments.rounds, time.process_time)
    found = sum(map(len, predict(exported, frames, decode="fitted", min_score=MIN_SCORE)))
    size = "x".join(map(str, SIZE_PX))
    print(f"{len(frames)} images of {size} px, {found} vehicles found; 1 thread, batches of {arguments.batch}")
    for way, seconds in taken.items():
        for decode in DECODES:
            print(
                f"{way:<12}  images to boxes, {decode}, over the network alone:"
                f" {spread(seconds[decode] / seconds['forward'])};"
                f" images per CPU second: {spread(len(frames) / seconds[decode])}"
            )
    ratios = {name: spread(taken["ONNX Runtime"][name] / taken["torch"][name]) for name in ("forward", "fitted")}
    print(
        f"ONNX Runtime over torch: the network alone {ratios['forward']}, images to boxes, fitted, {ratios['fitted']}"
    )


if __name__ == "__main__":
    main()
