"""How the queue stands and what was counted, on both databases."""

from __future__ import annotations

import pytest

from tests.unit.adapters.world import World
from wibam_core.adapters.counters import Counted, Sight, Watch, count


def look(world: World) -> Sight:
    return Watch(world.database, lambda: world.time).look()


class TestQueue:
    def test_an_empty_one_has_no_age(self, world: World) -> None:
        sight = look(world)
        assert (sight.waiting, sight.running, sight.oldest_waiting_s, sight.jobs) == ({}, {}, 0.0, {})

    def test_stages_wait_from_when_they_are_due(self, world: World) -> None:
        job = world.job()
        world.time += 40
        assert (look(world).waiting, look(world).oldest_waiting_s) == ({"a": 1}, 40)
        claim = world.claim(job, "a")
        assert (look(world).waiting, look(world).running, look(world).oldest_waiting_s) == ({}, {"a": 1}, 0)
        world.time += 5
        world.leases.succeed(claim, {}, lambda: None)
        world.time += 2
        assert (look(world).waiting, look(world).oldest_waiting_s) == ({"b": 1, "c": 1}, 2)
        world.claim(job, "b")
        world.time += 1
        assert (look(world).waiting, look(world).oldest_waiting_s) == ({"c": 1}, 3)

    def test_announcing_a_stage_again_does_not_make_it_younger(self, world: World) -> None:
        world.job()
        world.time += 100
        assert world.leases.reap()
        assert look(world).oldest_waiting_s == 100


class TestCounts:
    def test_attempts_and_seconds_by_outcome(self, world: World) -> None:
        job = world.job()
        claim = world.claim(job, "a")
        world.time += 7
        world.leases.retry(claim, "no fault")
        claim = world.claim(job, "a")
        world.time += 5
        world.leases.succeed(claim, {}, lambda: None)
        counted = look(world).counted
        assert counted[Counted.SECONDS, "a", "retried"] == 7
        assert counted[Counted.SECONDS, "a", "succeeded"] == 5
        assert counted[Counted.ATTEMPTS, "a", "succeeded"] == 1

    def test_reused_stages_are_no_attempts(self, world: World) -> None:
        job = world.job()
        world.leases.succeed(world.claim(job, "a"), {}, lambda: None, reused=True)
        assert not [key for key in look(world).counted if key[0] is Counted.ATTEMPTS]

    def test_lost_workers(self, world: World) -> None:
        job = world.job()
        for lost in (1, 2):
            world.claim(job, "a")
            world.time += 31
            world.leases.reap()
            assert look(world).counted[Counted.LEASE_LOSSES, "a", ""] == lost
        assert look(world).jobs == {"failed": 1}

    def test_what_is_not_committed_is_not_counted(self, world: World) -> None:
        before = look(world).counted
        with pytest.raises(ZeroDivisionError), world.database.writing() as session:  # noqa: PT012
            count(session, Counted.UPLOADED_BYTES, 10.0)
            raise ZeroDivisionError
        assert look(world).counted == before
