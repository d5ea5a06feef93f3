"""One training on several devices of one machine, a process for each.

A batch is drawn once, the same by every process; each runs the network on its share, and the maps of all shares are
exchanged, so that every process computes the loss of the whole batch, however that is normalised. Gradients reach each
process's own share alone: their sum over the processes is the gradient of that loss, as one device would give it.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import socket
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, distributed, nn

#: A process that hears nothing of the others for so long gives up.
_PATIENCE = timedelta(minutes=15)


@dataclass(frozen=True)
class Ranks:
    """The processes of a training, and which of them this is.

    Attributes:
        rank: number of this process. count: of all.
        device: of this process.
    """

    rank: int
    count: int
    device: torch.device

    @property
    def is_first(self) -> bool:
        """Whether this process validates, writes and reports."""
        return self.rank == 0

    def share(self, total: int) -> slice:
        """This process's part of a batch of ``total``, which is a multiple of `count`."""
        size = total // self.count
        return slice(self.rank * size, (self.rank + 1) * size)

    def synchronise(self, network: nn.Module) -> None:
        """Give all processes the first one's weights, and batch normalisation of the whole batch where it can be."""
        if self.count == 1:
            return
        for value in network.state_dict().values():
            distributed.broadcast(value, src=0)
        if self.device.type == "cuda":  # PyTorch has none for processors
            nn.SyncBatchNorm.convert_sync_batchnorm(network)

    def gather(self, maps: dict[str, Tensor]) -> dict[str, Tensor]:
        """Maps (b, C, h, w) of this process's share to those of the whole batch (count · b, C, h, w)."""
        if self.count == 1:
            return maps
        joined = {}
        for name, own in maps.items():
            parts = [torch.empty(own.shape, dtype=own.dtype, device=own.device) for _ in range(self.count)]
            distributed.all_gather(parts, own.detach().contiguous())
            parts[self.rank] = own
            joined[name] = torch.cat(parts)
        return joined

    def add_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Replace gradients by their sums over all processes."""
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        if self.count == 1 or not gradients:
            return
        flat = torch.cat([gradient.flatten() for gradient in gradients])
        distributed.all_reduce(flat)
        for gradient, total in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
            gradient.copy_(total.view_as(gradient))

    def from_first(self, value: float) -> float:
        """The first process's value."""
        if self.count == 1:
            return value
        told = torch.tensor(value, dtype=torch.float64, device=self.device)
        distributed.broadcast(told, src=0)
        return float(told)


def usable_devices(device: torch.device, batch_size: int) -> int:
    """How many devices of this kind to train on: all GPUs that are visible and that the batch can be divided among.

    Processes find each other over the loopback network. Where there is none, as in a worker's confined stages, one
    device is used.
    """
    if device.type != "cuda" or not _has_loopback():
        return 1
    return max(count for count in range(1, torch.cuda.device_count() + 1) if batch_size % count == 0)


def _has_loopback() -> bool:
    try:
        with (
            socket.create_server(("127.0.0.1", 0)) as server,
            socket.create_connection(server.getsockname(), timeout=1.0),
        ):
            return True
    except OSError:
        return False


@contextlib.contextmanager
def helpers(
    count: int, device: torch.device, rendezvous: Path, help_out: Callable[..., None], arguments: tuple[Any, ...]
) -> Iterator[Ranks]:
    """Start ``count`` − 1 processes that call ``help_out(ranks, *arguments)``; this one is the first of the ranks.

    They are ended with the context.

    Args:
        count: of processes in all, this one among them.
        device: cpu or cuda; each process gets a GPU of its own.
        rendezvous: a file by which they find each other; made anew.
        help_out: a function of a module.
        arguments: picklable.
    """
    rendezvous.unlink(missing_ok=True)
    context = multiprocessing.get_context("spawn")
    processes = []
    try:
        for rank in range(1, count):
            given = (rank, count, device.type, rendezvous, help_out, arguments)
            process = context.Process(target=_help, args=given, daemon=True)
            process.start()
            processes.append(process)
        yield _join(0, count, device.type, rendezvous)
    finally:
        for process in processes:
            process.kill()
            process.join()
        if distributed.is_initialized():
            distributed.destroy_process_group()


def _help(
    rank: int,
    count: int,
    device: str,
    rendezvous: Path,
    help_out: Callable[..., None],
    arguments: tuple[Any, ...],
) -> None:
    help_out(_join(rank, count, device, rendezvous), *arguments)


def _join(rank: int, count: int, device: str, rendezvous: Path) -> Ranks:
    own = torch.device("cuda", rank) if device == "cuda" else torch.device(device)
    if own.type == "cuda":
        torch.cuda.set_device(own)
    distributed.init_process_group(
        "nccl" if own.type == "cuda" else "gloo",
        init_method=rendezvous.absolute().as_uri(),
        rank=rank,
        world_size=count,
        timeout=_PATIENCE,
    )
    return Ranks(rank, count, own)
