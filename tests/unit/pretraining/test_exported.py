"""Going on from an exported network, and from an interrupted run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import pytest
import torch
from torch import Tensor, nn

from wibam_core.errors import InvalidWeights
from wibam_core.models.detector2d import DETECTOR_SHAPE, Detector2D
from wibam_core.models.edge_refiner import EdgeRefinerNetwork
from wibam_core.models.export import export_detector2d, export_edge_refiner
from wibam_core.pretraining.common import Schedule, pretrain
from wibam_core.pretraining.exported import load_exported

CPU = torch.device("cpu")
Network = TypeVar("Network", bound=nn.Module)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture
def images() -> Tensor:
    return torch.rand(4, 3, 96, 128, generator=torch.Generator().manual_seed(1))


def settled(network: Network, inputs: Tensor) -> Network:
    """The network with a normalisation that is not the one it begins with, and that of these inputs."""
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.normal_(module.bias, 0.0, 0.3)
    network.train()
    for _ in range(60):
        network(inputs)
    return network.eval()


def test_an_exported_detector_computes_the_same_when_it_is_loaded_again(tmp_path: Path, images: Tensor) -> None:
    torch.manual_seed(0)
    network = settled(Detector2D(), images)
    export_detector2d(network, tmp_path / "detector.onnx")
    torch.manual_seed(9)
    again = Detector2D()
    load_exported(tmp_path / "detector.onnx", again, images)
    with torch.no_grad():
        expected = network(images)
        for training in (False, True):
            found = again.train(training)(images)
            for one, other in zip(found, expected, strict=True):
                assert torch.allclose(one, other, atol=1e-2)
    assert all(parameter.requires_grad for parameter in again.parameters())


def test_blocks_that_the_file_lacks_change_nothing_at_first(tmp_path: Path, images: Tensor) -> None:
    shape = replace(DETECTOR_SHAPE, blocks=(0, 1, 1, 1))
    torch.manual_seed(0)
    small = Detector2D(shape)
    small(images)
    export_detector2d(small, tmp_path / "detector.onnx")
    larger = Detector2D()
    load_exported(tmp_path / "detector.onnx", larger, images)
    with torch.no_grad():
        assert torch.allclose(larger.eval()(images)[0], small.eval()(images)[0], atol=2e-3)
    export_detector2d(larger, tmp_path / "larger.onnx")
    with pytest.raises(InvalidWeights, match="shape"):
        load_exported(tmp_path / "larger.onnx", Detector2D(shape), images)


def test_an_exported_edge_refiner_computes_the_same_when_it_is_loaded_again(tmp_path: Path) -> None:
    crops = torch.rand(16, 7, 32, 32, generator=torch.Generator().manual_seed(2))
    torch.manual_seed(0)
    network = settled(EdgeRefinerNetwork(), crops)
    export_edge_refiner(network, tmp_path / "refiner.onnx", 32)
    torch.manual_seed(9)
    again = EdgeRefinerNetwork()
    load_exported(tmp_path / "refiner.onnx", again, crops)
    with torch.no_grad():
        for one, other in zip(again.eval()(crops), network(crops), strict=True):
            assert torch.allclose(one, other, atol=1e-2)


@dataclass(frozen=True)
class Numbers:
    values: Tensor

    def to(self, device: torch.device) -> Numbers:
        return self


def test_an_interrupted_run_goes_on_equal_to_the_bit(tmp_path: Path) -> None:
    def data(first: int, last: int = 6) -> Iterable[Numbers]:
        for step in range(first, last):
            yield Numbers(torch.rand(8, 3, generator=torch.Generator().manual_seed(step)))

    def losses(network: nn.Module, batch: Numbers) -> dict[str, Tensor]:
        return {"total": (network(batch.values).sum(dim=1) - 1).square().mean()}

    def run(state: Path, last: int) -> dict[str, Tensor]:
        torch.manual_seed(0)
        network = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4), nn.Linear(4, 2))
        schedule = Schedule(6, 1e-2, 50, 2)
        done = pretrain(
            network, lambda first: data(first, last), schedule, losses, lambda *_: {}, tmp_path / "log", lambda: 0.0,
            CPU, state,
        )  # fmt: skip
        return done.state_dict()

    through = run(tmp_path / "through.pt", 6)
    stopped = run(tmp_path / "state.pt", 4)
    again = run(tmp_path / "state.pt", 6)
    assert all(torch.equal(through[name], again[name]) for name in through)
    assert not all(torch.equal(through[name], stopped[name]) for name in through)
