"""The events of jobs in real databases: replayed without gaps, and kept as long as they say something."""

from __future__ import annotations

import threading

from tests.unit.adapters.world import World, plan
from wibam_core.errors import StageCrashed
from wibam_core.jobs.leases import Claim
from wibam_core.jobs.records import EventKind


class TestEvents:
    def test_events_replay_without_gaps_and_tell_their_end(self, world: World) -> None:
        job = world.job()
        claim = world.claim(job, "a")
        world.leases.progress(claim, 0.5, "half", {"loss": 1.5})
        events, complete = world.jobs.events(job.id)
        assert [event.sequence for event in events] == list(range(1, len(events) + 1))
        assert not complete
        assert events[-1].kind is EventKind.PROGRESS
        assert events[-1].data == {
            "stage": "a",
            "fraction": 0.5,
            "message": "half",
            "figures": {"loss": 1.5},
            "job_remaining_s": None,
        }
        world.leases.fail(claim, StageCrashed("x"))
        later, complete = world.jobs.events(job.id, after=events[-1].sequence)
        assert later[0].sequence == events[-1].sequence + 1
        assert later[-1].data["state"] == "failed"
        assert complete
        part, complete = world.jobs.events(job.id, limit=2)
        assert len(part) == 2
        assert not complete

    def test_of_a_stage_that_has_ended_the_last_progress_stays(self, world: World) -> None:
        job = world.job()
        world.do(job, "a")
        first, second = world.claim(job, "b"), world.claim(job, "c")
        for n in range(5):
            world.leases.progress(first, n / 10, "", {})
            world.leases.progress(second, n / 20, "", {})
        before, _ = world.jobs.events(job.id)
        world.leases.succeed(first, {}, lambda: None)
        after, complete = world.jobs.events(job.id)
        assert not complete
        kept = [(e.data["stage"], e.data["fraction"]) for e in after if e.kind is EventKind.PROGRESS]
        assert kept == [("c", n / 20) for n in range(4)] + [("b", 0.4), ("c", 0.2)]
        gone = [event for event in before if event not in after]
        assert {event.kind for event in gone} == {EventKind.PROGRESS}
        # one who stopped reading at an event that is gone goes on after it, and nobody's number is given again
        later, _ = world.jobs.events(job.id, after=gone[1].sequence)
        assert later == [event for event in after if event.sequence > gone[1].sequence]
        assert [event.sequence for event in after if event not in before] == [before[-1].sequence + 1]

    def test_the_end_is_told_to_those_who_read_what_is_gone(self, world: World) -> None:
        job = world.job()
        claim = world.claim(job, "a")
        for n in range(3):
            world.leases.progress(claim, n / 3, "", {})
        read, _ = world.jobs.events(job.id, limit=4)
        world.leases.fail(claim, StageCrashed("x"))
        later, complete = world.jobs.events(job.id, after=read[-1].sequence)
        assert [event.kind for event in later] == [EventKind.PROGRESS, EventKind.STAGE, EventKind.JOB]
        assert complete
        world.jobs.restart(job.id, {}, plan())
        again = world.claim(job, "a")
        world.leases.progress(again, 0.9, "", {})
        world.leases.stopped(again)
        events, _ = world.jobs.events(job.id)
        assert [e.data["fraction"] for e in events if e.kind is EventKind.PROGRESS] == [0.9]

    def test_a_lost_lease_keeps_what_was_told(self, world: World) -> None:
        job = world.job()
        claim = world.claim(job, "a")
        for n in range(3):
            world.leases.progress(claim, n / 3, "", {})
        world.leases.release(claim)
        events, _ = world.jobs.events(job.id)
        assert len([event for event in events if event.kind is EventKind.PROGRESS]) == 3

    def test_concurrent_writers_leave_no_gap(self, world: World) -> None:
        job = world.job()
        world.do(job, "a")
        claims = [world.claim(job, "b", "w1"), world.claim(job, "c", "w2")]

        def report(claim: Claim) -> None:
            for n in range(20):
                world.leases.progress(claim, n / 20, "", {})

        threads = [threading.Thread(target=report, args=(claim,)) for claim in claims]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        events, _ = world.jobs.events(job.id)
        assert [event.sequence for event in events] == list(range(1, len(events) + 1))
        assert len([event for event in events if event.kind is EventKind.PROGRESS]) == 40
