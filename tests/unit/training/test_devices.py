"""Where training runs: the choice of a device, precisions, and several processes that are one."""

import zipfile
from pathlib import Path

import pytest
import torch
from torch import nn

from tests.site_dataset import tiny_site
from wibam_core.config import FinetuneConfig
from wibam_core.errors import InvalidOption
from wibam_core.models.trunk import TrunkShape
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.network import CenterTrack
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.small.network import SmallMonocular
from wibam_core.progress import silent
from wibam_core.training import distributed
from wibam_core.training.checkpoint import read_checkpoint, write_checkpoint
from wibam_core.training.dataset import site_views
from wibam_core.training.device import Precision, choose_device, choose_device_to_detect
from wibam_core.training.distributed import Ranks, usable_devices
from wibam_core.training.finetune import FinetuneResult, SiteDataset, finetune, finetune_on
from wibam_core.training.trainable import TrainableNetwork

CPU = torch.device("cpu")
TINY = TrunkShape(channels=(8, 8, 16, 16, 16), blocks=(0, 0, 0, 0), neck=8)

needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device here")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> SiteDataset:
    site = tiny_site(tmp_path_factory.mktemp("site"))
    views = site_views(site.instants, site.frames, site.lifts, site.rig)
    return SiteDataset(site.frames, site.rig, views[:9], views[9:])


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def options(**values: object) -> FinetuneConfig:
    return FinetuneConfig.model_validate(
        {"steps": 2, "steps_per_epoch": 1, "batch_size": 4, "learning_rate": 1e-2} | values
    )


def without_batch_statistics() -> SmallMonocular:
    """A network that normalises each image by itself: what it learns of an image does not depend on the batch."""
    torch.manual_seed(0)
    network = SmallNetwork(TINY)
    for module in list(network.modules()):
        for name, child in module.named_children():
            if isinstance(child, nn.BatchNorm2d):
                setattr(module, name, nn.GroupNorm(1, child.num_features))
    return SmallMonocular(network)


def weights(result: FinetuneResult) -> torch.Tensor:
    return torch.cat([value.flatten().double() for value in result.network.module.state_dict().values()])


def test_two_processes_with_half_a_batch_each_learn_what_one_learns(dataset: SiteDataset, tmp_path: Path) -> None:
    config = options(method="combined")
    exact = Precision(CPU, None)
    one, two = (
        finetune_on(count, exact, without_batch_statistics(), dataset, config, silent, tmp_path / str(count))
        for count in (1, 2)
    )
    start = torch.cat([value.flatten().double() for value in without_batch_statistics().module.state_dict().values()])
    assert float((weights(one) - start).abs().max()) > 5e-3
    assert float((weights(one) - weights(two)).abs().max()) < 1e-4
    assert [epoch.validation for epoch in one.epochs] == [
        pytest.approx(epoch.validation, rel=1e-4) for epoch in two.epochs
    ]


def test_one_device_takes_the_whole_batch_and_of_several_each_takes_a_part() -> None:
    assert Ranks(0, 1, CPU).share(5) == slice(0, 5)
    assert [Ranks(rank, 3, CPU).share(6) for rank in range(3)] == [slice(0, 2), slice(2, 4), slice(4, 6)]


def test_only_devices_that_the_batch_can_be_divided_among_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 4)
    assert [usable_devices(torch.device("cuda"), size) for size in (8, 6, 5)] == [4, 3, 1]
    assert usable_devices(CPU, 8) == 1
    monkeypatch.setattr(distributed, "_has_loopback", lambda: False)  # as in a worker's confined stage
    assert usable_devices(torch.device("cuda"), 8) == 1


def test_cuda_is_refused_where_there_is_none(
    dataset: SiteDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_device("auto") == choose_device("cpu") == CPU
    with pytest.raises(InvalidOption, match="no CUDA device"):
        finetune(without_batch_statistics(), dataset, options(device="cuda"), silent, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_the_device_of_detection_is_trainings_or_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    for there, expected in ((False, "cpu"), (True, "cuda")):
        monkeypatch.setattr(torch.cuda, "is_available", lambda there=there: there)
        assert [choose_device_to_detect(option).type for option in ("auto", "cpu", "cuda")] == [
            expected,
            "cpu",
            expected,
        ]


def test_a_checkpoint_of_a_gpu_is_read_onto_the_cpu(tmp_path: Path) -> None:
    """As it is written on a GPU: only the name of the device in the file's table is another."""
    write_checkpoint(tmp_path / "cpu.pt", {"weights": torch.arange(3.0)})
    with zipfile.ZipFile(tmp_path / "cpu.pt") as source, zipfile.ZipFile(tmp_path / "cuda.pt", "w") as written:
        for name in source.namelist():
            content = source.read(name)
            if name.endswith("/data.pkl"):
                assert content.count(b"\x03\0\0\0cpu") == 1
                content = content.replace(b"\x03\0\0\0cpu", b"\x06\0\0\0cuda:0")
            written.writestr(name, content)
    state = read_checkpoint(tmp_path / "cuda.pt")
    assert state is not None
    assert state["weights"].device == CPU
    assert state["weights"].tolist() == [0.0, 1.0, 2.0]


def test_the_scale_of_half_precision_survives_an_interruption(dataset: SiteDataset, tmp_path: Path) -> None:
    half, config = Precision(CPU, torch.float16), options(batch_size=1)
    whole = finetune_on(1, half, without_batch_statistics(), dataset, config, silent, tmp_path / "whole")
    state = read_checkpoint(tmp_path / "whole" / "checkpoint.pt")
    assert state is not None and state["scaler"]["scale"] > 0

    class Stop(Exception):
        pass

    def stop_in_the_second_epoch(fraction: float, message: str = "", **figures: float) -> None:
        if fraction == 1.0:
            raise Stop

    with pytest.raises(Stop):
        finetune_on(1, half, without_batch_statistics(), dataset, config, stop_in_the_second_epoch, tmp_path / "cut")
    resumed = finetune_on(1, half, without_batch_statistics(), dataset, config, silent, tmp_path / "cut")
    assert torch.equal(weights(whole), weights(resumed))


def test_without_the_instructions_a_processor_computes_in_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)
    assert Precision.of(CPU).dtype is None
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    assert Precision.of(CPU).dtype is torch.bfloat16


@needs_cuda
@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize("method", ["lifted", "paper"])
@pytest.mark.parametrize("kind", ["small", "custom"])
def test_trains_on_cuda(dataset: SiteDataset, tmp_path: Path, kind: str, method: str, dtype: torch.dtype) -> None:
    precision = Precision(choose_device("cuda"), dtype)
    config = options(method=method, network=kind, steps=20, steps_per_epoch=5, learning_rate=1e-3)
    torch.manual_seed(0)
    network: TrainableNetwork = CenterTrack(DLA34()) if kind == "custom" else SmallMonocular(SmallNetwork())
    result = finetune_on(1, precision, network, dataset, config, silent, tmp_path)
    assert result.epochs[-1].train["total"] < result.epochs[0].train["total"]
    assert {value.device for value in result.network.module.state_dict().values()} == {CPU}


@pytest.mark.skipif(torch.cuda.device_count() < 2, reason="there are not two CUDA devices here")
def test_trains_on_two_cuda_devices(dataset: SiteDataset, tmp_path: Path) -> None:
    torch.manual_seed(0)
    precision, config = Precision.of(choose_device("cuda")), options(network="custom")
    result = finetune_on(2, precision, CenterTrack(DLA34()), dataset, config, silent, tmp_path)
    assert not any(isinstance(module, nn.SyncBatchNorm) for module in result.network.module.modules())
