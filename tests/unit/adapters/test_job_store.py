"""Jobs, claims and leases in real databases: SQLite, and PostgreSQL where one answers."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Sequence

import pytest
from sqlalchemy import event

from tests.unit.adapters.world import POLICY, SITE, World, plan
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.lease_store import LostLease
from wibam_core.adapters.site_store import UploadRequest
from wibam_core.errors import Conflict, NotFound, StageCrashed
from wibam_core.jobs.records import EventKind, Job, Purpose
from wibam_core.jobs.states import JobState, StageState


class TestLife:
    def test_a_job_runs_through_its_graph(self, world: World) -> None:
        job, ready = world.jobs.create(world.site, {"x": 1}, [world.file], plan())
        assert [key.stage for key in ready] == ["a"]
        assert job.state is JobState.QUEUED
        assert [key.stage for key in world.do(job, "a")] == ["b", "c"]
        assert world.jobs.job(job.id).state is JobState.RUNNING
        assert world.do(job, "b") == []
        assert [key.stage for key in world.do(job, "c")] == ["d"]
        world.do(job, "d")
        done = world.jobs.job(job.id)
        assert done.state is JobState.SUCCEEDED
        assert done.options == {"x": 1}
        assert [file.id for file in done.recordings["north"]] == [world.file.id]
        assert all(stage.summary == {"n": 1} and stage.fraction == 1.0 for stage in done.stages)

    def test_a_failure_names_the_stage_and_waits_for_what_still_runs(self, world: World) -> None:
        job = world.job()
        world.do(job, "a")
        first, second = world.claim(job, "b"), world.claim(job, "c")
        world.leases.fail(first, StageCrashed("it broke", hint="mend it", x=1))
        assert world.jobs.job(job.id).state is JobState.RUNNING
        assert not world.leases.heartbeat(second).wanted
        world.leases.stopped(second)
        failed = world.jobs.job(job.id)
        assert failed.state is JobState.FAILED
        assert failed.error == {
            "code": "stage_crashed",
            "message": "it broke",
            "hint": "mend it",
            "details": {"x": 1, "stage": "b"},
        }
        assert world.states(job)["d"] == "pending"

    def test_summaries_that_databases_refuse_are_made_plain(self, world: World) -> None:
        job = world.job()
        world.leases.succeed(world.claim(job, "a"), {"nan": float("nan"), "text": "a\0b"}, lambda: None)
        assert world.jobs.job(job.id).stage("a").summary == {"nan": None, "text": "ab"}

    def test_unknown_jobs_are_not_found(self, world: World) -> None:
        for act in (world.jobs.job, world.jobs.cancel, world.jobs.events):
            with pytest.raises(NotFound):
                act("job_0000000000000000")


class TestClaims:
    def test_a_second_delivery_does_nothing(self, world: World) -> None:
        job = world.job()
        key = StageKey(job.id, "a")
        assert world.leases.claim(key, "w1") is not None
        assert world.leases.claim(key, "w2") is None
        assert world.leases.claim(key, "w1") is None

    def test_a_delivery_after_the_end_does_nothing(self, world: World) -> None:
        job = world.job()
        world.do(job, "a")
        assert world.leases.claim(StageKey(job.id, "a"), "w2") is None

    def test_a_delivery_for_what_is_gone_does_nothing(self, world: World) -> None:
        assert world.leases.claim(StageKey("job_0000000000000000", "a"), "w1") is None

    def test_of_many_workers_exactly_one_claims_each_stage(self, world: World) -> None:
        jobs = [world.job(str(n)) for n in range(4)]
        won: list[StageKey] = []
        start = threading.Barrier(4)

        def work(owner: str) -> None:
            start.wait()
            for job in jobs:
                if world.leases.claim(StageKey(job.id, "a"), owner) is not None:
                    won.append(StageKey(job.id, "a"))

        threads = [threading.Thread(target=work, args=(f"w{n}",)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert Counter(won) == Counter(StageKey(job.id, "a") for job in jobs)

    def test_equal_stages_of_two_jobs_run_one_after_the_other(self, world: World) -> None:
        first, second = world.job(), world.job()
        claim = world.claim(first, "a")
        assert world.leases.claim(StageKey(second.id, "a"), "w2") is None
        assert world.states(second)["a"] == "queued"
        ready = world.leases.succeed(claim, {}, lambda: None)
        assert StageKey(second.id, "a") in ready
        world.leases.succeed(world.claim(second, "a"), {}, lambda: None, reused=True)
        assert world.states(second)["a"] == "reused"


class TestLeases:
    def test_heartbeats_keep_a_lease(self, world: World) -> None:
        job = world.job()
        claim = world.claim(job, "a")
        for _ in range(10):
            world.time += 20.0
            assert world.leases.heartbeat(claim).held
            assert world.leases.reap() == []

    def test_an_expired_lease_is_given_to_another_and_fences_the_first(self, world: World) -> None:
        job = world.job()
        lost = world.claim(job, "a", "lost")
        world.time += 31.0
        assert world.leases.reap() == [StageKey(job.id, "a")]
        published: list[str] = []
        with pytest.raises(LostLease):
            world.leases.succeed(lost, {}, lambda: published.append("lost"))
        assert not world.leases.heartbeat(lost).held
        successor = world.claim(job, "a", "successor")
        assert successor.fence > lost.fence
        assert successor.attempt == 2
        for write in (
            lambda: world.leases.progress(lost, 0.5, "", {}),
            lambda: world.leases.fail(lost, StageCrashed("x")),
            lambda: world.leases.stopped(lost),
        ):
            with pytest.raises(LostLease):
                write()
        world.leases.succeed(successor, {}, lambda: published.append("successor"))
        assert published == ["successor"]

    def test_a_stage_that_kills_its_workers_fails_after_its_attempts(self, world: World) -> None:
        job = world.job()
        for _ in range(POLICY.max_attempts):
            world.claim(job, "a")
            world.time += 31.0
            world.leases.reap()
        failed = world.jobs.job(job.id)
        assert failed.state is JobState.FAILED
        assert failed.error is not None
        assert failed.error["code"] == "stage_crashed"

    def test_a_lost_stage_of_a_cancelled_job_is_not_started_again(self, world: World) -> None:
        job = world.job()
        world.claim(job, "a")
        assert world.jobs.cancel(job.id).state is JobState.CANCELLING
        world.time += 31.0
        assert world.leases.reap() == []
        assert world.jobs.job(job.id).state is JobState.CANCELLED

    def test_a_released_stage_can_be_taken_at_once_and_counts_no_attempt(self, world: World) -> None:
        job = world.job()
        assert world.leases.release(world.claim(job, "a")) == [StageKey(job.id, "a")]
        assert world.claim(job, "a", "w2").attempt == 1

    def test_a_lost_message_is_sent_again_now_and_then(self, world: World) -> None:
        job = world.job()
        world.time += 59.0
        assert world.leases.reap() == []
        world.time += 2.0
        assert world.leases.reap() == [StageKey(job.id, "a")]
        assert world.leases.reap() == []

    def test_after_a_restart_of_the_broker_everything_queued_is_sent_again(self, world: World) -> None:
        job = world.job()
        assert world.leases.reap(resend_all=True) == [StageKey(job.id, "a")]
        claim = world.claim(job, "a")
        assert world.leases.reap(resend_all=True) == []
        assert world.leases.running_hashes() == {job.stages[0].hash}
        world.leases.succeed(claim, {}, lambda: None)
        assert world.leases.running_hashes() == set()

    def test_a_failed_publication_leaves_the_stage_running(self, world: World) -> None:
        job = world.job()
        claim = world.claim(job, "a")

        def publish() -> None:
            raise OSError("disk")

        with pytest.raises(OSError, match="disk"):
            world.leases.succeed(claim, {}, publish)
        assert world.states(job)["a"] == "running"


class TestCancel:
    def test_a_waiting_job_is_cancelled_at_once(self, world: World) -> None:
        job = world.job()
        assert world.jobs.cancel(job.id).state is JobState.CANCELLED
        assert set(world.states(job).values()) == {"cancelled"}
        assert world.leases.claim(StageKey(job.id, "a"), "w1") is None

    def test_a_running_stage_hears_of_it_at_its_heartbeat(self, world: World) -> None:
        job = world.job()
        claim = world.claim(job, "a")
        world.jobs.cancel(job.id)
        beat = world.leases.heartbeat(claim)
        assert beat.held
        assert not beat.wanted
        world.leases.stopped(claim)
        assert world.jobs.job(job.id).state is JobState.CANCELLED

    def test_cancelling_twice_or_too_late_is_harmless(self, world: World) -> None:
        job = world.job()
        world.jobs.cancel(job.id)
        assert world.jobs.cancel(job.id).state is JobState.CANCELLED


class TestRestart:
    def finish(self, world: World, job: Job) -> None:
        for stage in "abcd":
            world.do(job, stage)

    def test_only_what_changed_runs_again(self, world: World) -> None:
        job = world.job()
        self.finish(world, job)
        changed = [*plan()[:2], *plan("x")[2:]]
        restarted, ready = world.jobs.restart(job.id, {"c": 1}, changed)
        assert [key.stage for key in ready] == ["c"]
        assert {s.name: s.state for s in restarted.stages} == {
            "a": StageState.SUCCEEDED,
            "b": StageState.SUCCEEDED,
            "c": StageState.QUEUED,
            "d": StageState.PENDING,
        }
        assert restarted.restarts == 1
        assert restarted.options == {"c": 1}

    def test_from_a_stage_on_everything_is_made_anew(self, world: World) -> None:
        job = world.job()
        self.finish(world, job)
        restarted, ready = world.jobs.restart(job.id, {}, plan(), from_stage="b")
        assert [key.stage for key in ready] == ["b"]
        assert {s.name for s in restarted.stages if s.forced} == {"b", "d"}

    def test_what_was_to_be_made_anew_and_was_not_still_is_after_another_restart(self, world: World) -> None:
        job = world.job()
        self.finish(world, job)
        world.jobs.restart(job.id, {}, plan(), from_stage="b")
        claim = world.claim(job, "b")
        assert world.leases.make_way(claim, lambda name, hash: None)
        world.leases.fail(claim, StageCrashed("it was killed"))
        restarted, _ = world.jobs.restart(job.id, {}, plan())
        assert {s.name for s in restarted.stages if s.forced} == {"d"}
        world.jobs.cancel(job.id)
        changed, _ = world.jobs.restart(job.id, {"d": 1}, [*plan()[:3], plan("x")[3]])
        assert not any(stage.forced for stage in changed.stages), "what has another address is made anyway"

    def test_with_nothing_to_redo_the_job_succeeds_again_at_once(self, world: World) -> None:
        job = world.job()
        self.finish(world, job)
        before, _ = world.jobs.events(job.id)
        world.time += 60.0
        restarted, ready = world.jobs.restart(job.id, {"same": 1}, plan())
        assert ready == []
        assert restarted.state is JobState.SUCCEEDED
        assert (restarted.restarts, restarted.options) == (1, {"same": 1})
        assert restarted.started_at == restarted.finished_at == world.time
        assert all(stage.summary == {"n": 1} for stage in restarted.stages)
        news, complete = world.jobs.events(job.id, after=before[-1].sequence)
        assert [(event.kind, event.data["state"]) for event in news] == [
            (EventKind.JOB, "queued"),
            (EventKind.JOB, "succeeded"),
        ]
        assert complete

    def test_a_failed_job_goes_on_where_it_failed(self, world: World) -> None:
        job = world.job()
        world.do(job, "a")
        old = world.claim(job, "b")
        world.leases.fail(old, StageCrashed("x"))
        _, ready = world.jobs.restart(job.id, {}, plan())
        assert [key.stage for key in ready] == ["b", "c"]
        assert world.jobs.job(job.id).error is None
        assert world.claim(job, "b").fence > old.fence

    def test_a_job_that_works_cannot_be_restarted_or_deleted(self, world: World) -> None:
        job = world.job()
        with pytest.raises(Conflict):
            world.jobs.restart(job.id, {}, plan())
        with pytest.raises(Conflict):
            world.jobs.delete(job.id, lambda name, hash: None)

    def test_outputs_that_another_job_works_with_are_not_made_anew(self, world: World) -> None:
        job = world.job()
        self.finish(world, job)
        world.job()
        with pytest.raises(Conflict, match="same stages"):
            world.jobs.restart(job.id, {}, plan(), from_stage="a")


class TestDelete:
    def test_outputs_go_with_the_last_job_that_refers_to_them(self, world: World) -> None:
        removed: list[str] = []
        first, second = world.job(), world.job()
        for job in (first, second):
            world.jobs.cancel(job.id)
        world.jobs.delete(first.id, lambda name, hash: removed.append(name))
        assert removed == []
        world.jobs.delete(second.id, lambda name, hash: removed.append(name))
        assert removed == ["a", "b", "c", "d"]
        assert world.jobs.jobs() == []


class TestCreate:
    def test_a_key_makes_one_job(self, world: World) -> None:
        first, _ = world.jobs.create(world.site, {"x": 1}, [world.file], plan(), "key")
        again, ready = world.jobs.create(world.site, {"x": 1}, [world.file], plan(), "key")
        assert again.id == first.id
        assert ready == []
        with pytest.raises(Conflict, match="other options"):
            world.jobs.create(world.site, {"x": 2}, [world.file], plan(), "key")

    def test_jobs_without_a_key_are_all_different(self, world: World) -> None:
        assert world.job().id != world.job().id

    def test_the_newest_comes_first(self, world: World) -> None:
        first = world.job()
        world.time += 1
        second = world.job()
        assert [job.id for job in world.jobs.jobs(world.site.id)] == [second.id, first.id]
        assert world.jobs.jobs("site_0000000000000000") == []


class TestQueries:
    """Lists take a constant number of queries, however long they are."""

    @staticmethod
    def queries(world: World, ask: Callable[[], Sequence[object]], length: int) -> int:
        statements: list[str] = []

        def note(_connection: object, _cursor: object, statement: str, *_: object) -> None:
            statements.append(statement)

        event.listen(world.database.engine, "before_cursor_execute", note)
        try:
            assert len(ask()) == length
        finally:
            event.remove(world.database.engine, "before_cursor_execute", note)
        return len([statement for statement in statements if statement.startswith("SELECT")])

    def test_of_jobs(self, world: World) -> None:
        world.job()
        one = self.queries(world, world.jobs.jobs, 1)
        jobs = [world.job(str(n)) for n in range(20)]
        assert self.queries(world, world.jobs.jobs, 21) == one == 4
        assert [job.id for job in world.jobs.jobs(limit=1)] == [world.jobs.jobs()[0].id]
        assert {job.id: job for job in world.jobs.jobs()}[jobs[3].id] == world.jobs.job(jobs[3].id)

    def test_of_sites_and_files(self, world: World) -> None:
        one = (
            self.queries(world, world.sites.sites, 1),
            self.queries(world, lambda: world.sites.files(world.site.id), 1),
        )
        for purpose in (Purpose.LABELS, Purpose.DETECTOR, Purpose.NETWORK):
            world.sites.add_site(SITE)
            request = UploadRequest(world.site.id, purpose, "", "x", 10)
            upload = world.sites.add_upload(request, lifetime_s=60, quota_bytes=100)
            world.sites.complete_upload(upload, suffix="", sha256="0" * 64)
        assert self.queries(world, world.sites.sites, 4) == one[0] == 1
        assert self.queries(world, lambda: world.sites.files(world.site.id), 4) == one[1] == 2
