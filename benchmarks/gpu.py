"""How many images a second both networks see on a GPU, learning and detecting, and how busy it is meanwhile.

Fine-tuning is measured as `finetune` runs it (draw, augment, encode, forward, losses, backward, optimiser; the median
step, once all images were read), the small network in batches of 8 and 32, DLA-34 in the published ones of 80, with as
many images as fit where a batch does not. Beside it stand the bare network's forward and backward passes on prepared
input: what of a step is not theirs, the processor takes. Detecting is from images in memory to boxes in the world, the
small network with its second look. Busy is the mean of what `nvidia-smi` says every tenth of a second, of all work of a
row, reading the images included. Seconds are by the clock.

Without a GPU it runs on the processor, which tries the script and nothing else.

Run: python -m benchmarks.gpu [--device cuda] [--steps 50] [--images 256] [--small 8 32] [--dla34 80]
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from itertools import cycle, islice
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.training import MOMENTS, make_dataset, step_seconds
from wibam_core.models.frames import Frame
from wibam_core.models.network import predict
from wibam_core.models.weights import bundled
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.network import CenterTrack
from wibam_core.networks.registry import load_network
from wibam_core.placing import Decode
from wibam_core.synthetic.sampling import sample_views
from wibam_core.training.device import Precision
from wibam_core.training.finetune import SiteDataset
from wibam_core.training.trainable import TrainableNetwork

#: Images that networks detect in, px, different ones of them, and the first of their seeds.
SIZE_PX, DIFFERENT, SEED = (960, 540), 16, 900_001
#: Bare passes that are timed.
PASSES = 10
MIN_SCORE = 0.1


class Busy:
    """How busy the GPU is: shares of time in which it works, one every tenth of a second."""

    def __init__(self) -> None:
        self.shares: list[float] = []

    @property
    def text(self) -> str:
        return f"{100 * statistics.mean(self.shares):.0f} %" if self.shares else "–"


@contextmanager
def watched(device: torch.device) -> Iterator[Busy]:
    """Watch the GPU as long as the block lasts."""
    busy, ended = Busy(), threading.Event()

    def watch() -> None:
        command = ["nvidia-smi", "--query-gpu=utilization.gpu", "--format=csv,noheader,nounits", "-i", "0"]
        while not ended.wait(0.1):
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            busy.shares.append(float(done.stdout.split()[0]) / 100)

    watcher = threading.Thread(target=watch)
    if device.type == "cuda" and shutil.which("nvidia-smi"):
        watcher.start()
    try:
        yield busy
    finally:
        ended.set()
        if watcher.is_alive():
            watcher.join()


def network_of(kind: str) -> TrainableNetwork:
    """The small network as it ships, or DLA-34 with random weights, which are as fast as any."""
    return load_network(bundled("mono_small.safetensors")) if kind == "small" else CenterTrack(DLA34())


def bare_step_s(network: TrainableNetwork, batch: int, size_px: tuple[int, int], device: torch.device) -> float:
    """Seconds of one forward and backward pass of a batch of noise (batch, 3, H, W)."""
    module, precision = network.module.to(device).train(), Precision.of(device)
    images = torch.rand(batch, 3, size_px[1], size_px[0], device=device)
    images = images.contiguous(memory_format=torch.channels_last)

    def step() -> None:
        module.zero_grad(set_to_none=True)
        with precision.autocast():
            outputs = module(images)
        torch.stack([head.float().mean() for head in tensors_of(outputs)]).sum().backward()

    def steps(count: int) -> float:
        start = time.perf_counter()
        for _ in range(count):
            step()
        if device.type == "cuda":
            torch.cuda.synchronize()
        return (time.perf_counter() - start) / count

    steps(2)
    return steps(PASSES)


def tensors_of(outputs: object) -> list[Tensor]:
    """A network's heads, which one has as a mapping and the other as a dataclass."""
    if is_dataclass(outputs):
        return [getattr(outputs, field.name) for field in fields(outputs)]
    assert isinstance(outputs, dict)
    return list(outputs.values())


def input_px(network: TrainableNetwork) -> tuple[int, int]:
    """Width and height (px, a multiple of 32) of a 16:9 image as the network sees it."""
    width = network.long_side_px if isinstance(network, CenterTrack) else network.view_width_px
    return width, -(-width * 9 // 16 // 32) * 32


def trained(
    kind: str, batch: int, dataset: SiteDataset, steps: int, device: torch.device
) -> tuple[int, float, float, str]:
    """The batch that fits, seconds of a step and of its bare passes, and how busy the GPU is."""
    while True:
        network = network_of(kind)
        options = {"network": "small" if kind == "small" else "custom", "device": device.type, "batch_size": batch}
        try:
            with tempfile.TemporaryDirectory() as name, watched(device) as busy:
                step_s = step_seconds(network, dataset, steps, Path(name), time.perf_counter, **options)
            bare_s = bare_step_s(network_of(kind), batch, input_px(network), device)
            return batch, step_s, bare_s, busy.text
        except torch.OutOfMemoryError:
            if batch == 1:
                raise
            batch //= 2
            torch.cuda.empty_cache()


def detecting(kind: str, frames: list[Frame], device: torch.device) -> tuple[float, str]:
    """Images a second from images to boxes, and how busy the GPU is."""
    network = network_of(kind)
    network.module.to(device).eval()
    decode: Decode = "refined" if kind == "small" else "plane"
    list(predict(network, frames[:DIFFERENT], decode=decode, min_score=MIN_SCORE))
    with watched(device) as busy:
        start = time.perf_counter()
        list(predict(network, frames, decode=decode, min_score=MIN_SCORE))
        taken_s = time.perf_counter() - start
    return len(frames) / taken_s, busy.text


def main(given: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--instants", type=int, default=MOMENTS, help="of four images each, to learn from")
    parser.add_argument("--images", type=int, default=256, help="to detect in")
    parser.add_argument("--small", type=int, nargs="*", default=[8, 32], help="batches of the small network")
    parser.add_argument("--dla34", type=int, nargs="*", default=[80], help="batches of DLA-34")
    arguments = parser.parse_args(given)
    device = torch.device(arguments.device)
    print(torch.cuda.get_device_name(device) if device.type == "cuda" else "no GPU: the processor")
    print("fine-tuning: network, batch, images a second; of the bare network; busy")
    with tempfile.TemporaryDirectory() as name:
        dataset = make_dataset(Path(name) / "frames", arguments.instants)
        for kind, batches in (("small", arguments.small), ("dla34", arguments.dla34)):
            for asked in batches:
                batch, step_s, bare_s, busy = trained(kind, asked, dataset, arguments.steps, device)
                print(f"{kind:6}{batch:4}{batch / step_s:9.2f}{batch / bare_s:9.2f}  {busy}", flush=True)
    print("detecting: network, images a second, busy")
    different = [
        Frame(view.image, view.camera, "camera", number)
        for number, view in enumerate(sample_views(SEED, "site", min(DIFFERENT, arguments.images), SIZE_PX))
    ]
    frames = list(islice(cycle(different), arguments.images))
    for kind in ("small", "dla34"):
        rate, busy = detecting(kind, frames, device)
        print(f"{kind:6}{rate:9.2f}  {busy}", flush=True)


if __name__ == "__main__":
    main()
