"""The scripts that make the bundled networks: what they draw, and that they train."""

import functools
import itertools
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import IterableDataset

from wibam_core.models.detector2d import Detector2D
from wibam_core.models.export import export_detector2d
from wibam_core.networks.registry import load_network
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.pretraining import detector, monocular
from wibam_core.pretraining.common import Batch, PoolPlan, ViewPool, _Batches, batches
from wibam_core.pretraining.edge_refiner import CropBatches
from wibam_core.synthetic.sampling import Regime, RenderedView, sample_views

PLAN = PoolPlan(990_000, "ego", 60, 20, 2, (128, 96))


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def drawn(count: int, workers: int, seed: int = 0) -> list[Batch]:
    return list(batches(PLAN, monocular.augmented, count, 2, seed, workers))


def same(one: Batch, other: Batch) -> bool:
    return torch.equal(one.images, other.images) and torch.equal(one.targets.boxes3d, other.targets.boxes3d)


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_seed_gives_the_same_batches(workers: int) -> None:
    first, again, other = drawn(4, workers), drawn(4, workers), drawn(4, workers, seed=1)
    assert all(map(same, first, again))
    assert not any(map(same, first, other))
    assert not any(same(one, two) for one, two in itertools.combinations(first, 2))


def test_batches_of_a_later_step_are_those_that_an_uninterrupted_run_draws() -> None:
    through, later = drawn(4, 0), list(batches(PLAN, monocular.augmented, 4, 2, 0, 0, first=2))
    assert len(later) == 2
    assert all(map(same, through[2:], later))


@pytest.fixture
def quickly_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Views of one moment with noise in place of colours; as those that are rendered, each depends on its site's number
    and on how many were rendered of that before it."""
    rendered = functools.cache(lambda regime, size_px: list(sample_views(PLAN.seed, regime, 3, size_px)))

    def noise(seed: int, regime: Regime, count: int, size_px: tuple[int, int]) -> Iterator[RenderedView]:
        rng = np.random.default_rng(seed)
        for view in itertools.islice(itertools.cycle(rendered(regime, size_px)), count):
            yield replace(view, image=rng.integers(0, 256, view.image.shape, np.uint8))

    monkeypatch.setattr("wibam_core.pretraining.common.sample_views", noise)


def by_three(monkeypatch: pytest.MonkeyPatch, data: IterableDataset[Any]) -> list[Any]:
    """What three processes make of it, taken from them in turn as a data loader does, one after the other here."""
    parts = []
    for number in range(3):
        process = SimpleNamespace(id=number, num_workers=3)
        monkeypatch.setattr("wibam_core.pretraining.common.get_worker_info", lambda process=process: process)
        parts.append(list(data))
    turns = itertools.chain.from_iterable(itertools.zip_longest(*parts))
    return [batch for batch in turns if batch is not None]


@pytest.mark.usefixtures("quickly_rendered")
@pytest.mark.parametrize("first", [4, 6])
def test_several_processes_go_on_at_any_step_as_if_uninterrupted(monkeypatch: pytest.MonkeyPatch, first: int) -> None:
    """Also where each renders less than a site at a time: 5 views, and 5 of another one two steps later."""
    plan = replace(PLAN, images=45, shard=15)
    through, later = (by_three(monkeypatch, _Batches(plan, ViewPool.draw, 8, 2, 0, since)) for since in (0, first))
    assert len(through) == 8 and len(later) == 8 - first
    assert all(map(same, through[first:], later))


@pytest.mark.usefixtures("quickly_rendered")
def test_several_processes_cut_out_vehicles_at_any_step_as_if_uninterrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = replace(PLAN, regime="elevated", images=45, shard=15)
    through, later = (by_three(monkeypatch, CropBatches(plan, 8, 2, 0, since)) for since in (0, 4))
    assert len(through) == 8 and len(later) == 4
    assert all(torch.equal(one.images, two.images) for one, two in zip(through[4:], later, strict=True))


def test_of_ten_sites_some_have_varied_views() -> None:
    plan = replace(PLAN, regime="elevated", varied_of_ten=1)
    varied, plain = (next(iter(plan.views(first, 1))) for first in (0, 20))
    assert plain.image.shape == (96, 128, 3)
    assert varied.image.shape != plain.image.shape


def test_processes_render_different_sites_and_together_as_many_views() -> None:
    parts = [PLAN.part(number, 3) for number in range(3)]
    rendered = [range(part.seed, part.seed + part.images) for part in parts]
    assert [len(views) for views in rendered] == [20, 20, 20]
    assert all(one.stop <= two.start for one, two in itertools.pairwise(rendered))
    assert PLAN.part(0, 1) == PLAN


def test_a_pool_grows_as_planned() -> None:
    pool = ViewPool(replace(PLAN, images=40))
    sizes = []
    for step in range(6):
        pool.grow(step)
        sizes.append(len(pool))
    assert 0 < sizes[0] == sizes[1] < sizes[2] == sizes[5] <= 40
    view = pool.draw(np.random.default_rng(0))
    assert view.image.shape == (96, 128, 3)


@pytest.mark.parametrize("script", [monocular, detector])
@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_the_scripts_train(script: object, device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("there is no CUDA device here")
    words = ["--steps", "60", "--images", "20", "--batch", "2", "--checkpoint-every", "60", "--device", device]
    few = ["--views", "2", "--rendered", "160", "120"] if script is monocular else []
    monkeypatch.setattr(script, "WIDTH_PX", 128)
    monkeypatch.setattr(script, "HEIGHT_PX", 96)
    monkeypatch.setattr("sys.argv", ["script", "--out", str(tmp_path), *words, *few])
    script.main()  # type: ignore[attr-defined]
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [50, 60]
    assert all(np.isfinite(list(lines[0].values())))
    if script is detector:
        for name in ("start", "again"):
            torch.manual_seed(0)
            export_detector2d(Detector2D(), tmp_path / name)
        start, again, made = ((tmp_path / name).read_bytes() for name in ("start", "again", "detector2d.onnx"))
        assert start == again != made
        return
    torch.manual_seed(0)
    before, after = SmallNetwork().heads, load_network(tmp_path / "mono_small.safetensors").module.heads
    moved = [
        float((one - two).abs().max().detach())
        for one, two in zip(before.parameters(), after.parameters(), strict=True)
    ]
    assert min(moved) > 0
    assert max(moved) > 1e-3
