"""Which outputs go, and when: of stages that are made anew, and of those that no job names any more."""

from __future__ import annotations

import pytest

from tests.unit.adapters.world import World, plan
from wibam_core.adapters.lease_store import LostLease
from wibam_core.jobs.leases import Claim
from wibam_core.jobs.records import Job


def finished(world: World) -> Job:
    job = world.job()
    for stage in "abcd":
        world.do(job, stage)
    return job


class TestMakingAnew:
    """A forced stage's old outputs are removed once, by whoever comes first, and nobody works with them before."""

    @pytest.fixture
    def removed(self) -> list[str]:
        return []

    def restarted(self, world: World) -> Job:
        job = finished(world)
        return world.jobs.restart(job.id, {}, plan(), from_stage="b")[0]

    def make_way(self, world: World, claim: Claim, removed: list[str]) -> bool:
        return world.leases.make_way(claim, lambda name, hash: removed.append(name))

    def test_it_happens_once_although_the_stage_is_given_back(self, world: World, removed: list[str]) -> None:
        job = self.restarted(world)
        first = world.claim(job, "b")
        assert self.make_way(world, first, removed)
        world.leases.release(first)
        second = world.claim(job, "b")
        assert second.attempt == 1
        assert not self.make_way(world, second, removed)
        assert removed == ["b"]

    def test_it_is_made_up_for_when_a_worker_dies_before_it(self, world: World, removed: list[str]) -> None:
        job = self.restarted(world)
        world.claim(job, "b")
        world.time += 31.0
        world.leases.reap()
        second = world.claim(job, "b")
        assert second.attempt == 2
        assert self.make_way(world, second, removed)

    def test_a_worker_that_lost_its_lease_removes_nothing(self, world: World, removed: list[str]) -> None:
        job = self.restarted(world)
        lost = world.claim(job, "b")
        world.time += 31.0
        world.leases.reap()
        with pytest.raises(LostLease):
            self.make_way(world, lost, removed)
        assert removed == []

    def test_a_removal_that_fails_is_tried_again(self, world: World, removed: list[str]) -> None:
        claim = world.claim(self.restarted(world), "b")

        def refuse(name: str, hash: str) -> None:
            raise OSError("busy")

        with pytest.raises(OSError, match="busy"):
            world.leases.make_way(claim, refuse)
        assert self.make_way(world, claim, removed)

    def test_a_later_job_does_not_work_with_what_is_to_be_removed(self, world: World, removed: list[str]) -> None:
        forced, later = self.restarted(world), world.job()
        world.leases.succeed(world.claim(later, "a"), {}, lambda: None, reused=True)
        claim = world.claim(later, "b")
        assert self.make_way(world, claim, removed)
        world.leases.succeed(claim, {}, lambda: None)
        assert not self.make_way(world, world.claim(forced, "b"), removed)
        assert removed == ["b"]

    def test_a_restarted_job_looks_again_for_what_may_be_removed(self, world: World) -> None:
        first, second = finished(world), finished(world)
        world.jobs.restart(first.id, {}, plan(), from_stage="b")
        changed = [*plan()[:3], *plan("x")[3:]]
        _, ready = world.jobs.restart(second.id, {}, changed)
        assert [key.stage for key in ready] == ["b"]
        assert world.states(second) == {"a": "succeeded", "b": "queued", "c": "succeeded", "d": "pending"}

    def test_a_cancelled_wish_binds_nobody(self, world: World, removed: list[str]) -> None:
        world.jobs.cancel(self.restarted(world).id)
        later = world.job()
        world.do(later, "a")
        assert not self.make_way(world, world.claim(later, "b"), removed)


class TestUnnamedOutputs:
    def test_go_after_a_restart_with_other_options(self, world: World) -> None:
        job = finished(world)
        there = {(planned.name, planned.hash[:32]) for planned in plan()}
        removed: list[tuple[str, str]] = []
        world.jobs.drop_unnamed(there, lambda *address: removed.append(address))
        assert removed == []
        world.jobs.restart(job.id, {}, [*plan()[:2], *plan("x")[2:]])
        world.jobs.drop_unnamed(there, lambda *address: removed.append(address))
        assert removed == [(planned.name, planned.hash[:32]) for planned in plan()[2:]]

    def test_there_may_be_none(self, world: World) -> None:
        world.jobs.drop_unnamed([], lambda name, hash: None)
