"""Stages whose outputs are there are settled without a worker."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.builders import AMBIGUOUS
from tests.unit.adapters.world import World, plan
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.reuse import Reuse
from wibam_core.jobs.states import JobState
from wibam_core.stages.store import StageStore


@pytest.fixture
def folder(tmp_path: Path) -> DataFolder:
    return DataFolder(tmp_path / "data")


@pytest.fixture
def reuse(world: World, folder: DataFolder) -> Reuse:
    return Reuse(world.leases, folder, "api")


def publish(folder: DataFolder, *names: str) -> None:
    store = StageStore(folder.stages)
    for planned in plan():
        if planned.name in names:
            store.publish(store.begin(planned.name, planned.hash), {"n": 7}, 1.0, [AMBIGUOUS])


def test_a_job_of_which_all_is_there_succeeds_at_once(world: World, reuse: Reuse, folder: DataFolder) -> None:
    publish(folder, *"abcd")
    job, due = world.jobs.create(world.site, {}, [world.file], plan())
    assert reuse.settle(due) == []
    done = world.jobs.job(job.id)
    assert done.state is JobState.SUCCEEDED
    assert set(world.states(job).values()) == {"reused"}
    assert all(stage.summary == {"n": 7} and stage.warnings == (AMBIGUOUS,) for stage in done.stages)
    assert folder.log(job.id).read_text().count("reused: ") == 4


def test_what_is_not_there_is_left_to_the_workers(world: World, reuse: Reuse, folder: DataFolder) -> None:
    publish(folder, "a", "c")
    job, due = world.jobs.create(world.site, {}, [world.file], plan())
    assert [key.stage for key in reuse.settle(due)] == ["b"]
    assert world.states(job) == {"a": "reused", "b": "queued", "c": "reused", "d": "pending"}
    assert world.claim(job, "b").attempt == 1


def test_what_is_to_be_made_anew_is_left_to_the_workers(world: World, reuse: Reuse, folder: DataFolder) -> None:
    publish(folder, *"abcd")
    job, due = world.jobs.create(world.site, {}, [world.file], plan())
    reuse.settle(due)
    _, due = world.jobs.restart(job.id, {}, plan(), from_stage="c")
    assert [key.stage for key in reuse.settle(due)] == ["c"]


def test_a_second_settling_does_nothing(world: World, reuse: Reuse, folder: DataFolder) -> None:
    publish(folder, *"abcd")
    job, due = world.jobs.create(world.site, {}, [world.file], plan())
    reuse.settle(due)
    before = world.jobs.events(job.id)
    reuse.settle(due)
    assert world.jobs.events(job.id) == before


def test_a_stage_that_somebody_has_is_not_touched(world: World, reuse: Reuse, folder: DataFolder) -> None:
    job, due = world.jobs.create(world.site, {}, [world.file], plan())
    claim = world.claim(job, "a")
    publish(folder, "a")
    reuse.settle(due)
    assert world.leases.heartbeat(claim).held
