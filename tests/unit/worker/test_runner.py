"""A worker's deliveries, with the real executor, the real database and a real recording."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from tests.builders import site_of
from tests.recordings import write_recording
from wibam_core.adapters.database import Database, sqlite_url
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.job_store import JobStore, StagePlan
from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.adapters.planning import plan_stages
from wibam_core.adapters.settings import StageLimits
from wibam_core.adapters.site_store import SiteStore, UploadRequest
from wibam_core.jobs.leases import LeasePolicy
from wibam_core.jobs.records import EventKind, Job, Purpose
from wibam_core.jobs.states import JobState, StageState
from wibam_core.stages.store import StageStore, sha256_of
from worker.runner import StageRunner

POLICY = LeasePolicy(duration_s=1.5, heartbeat_s=0.2, max_attempts=2)
LIMITS = StageLimits(memory_bytes=4_000_000_000, seconds=60.0)


@dataclass
class Service:
    """What a worker works on, in a folder of its own."""

    root: Path
    policy: LeasePolicy = POLICY

    def __post_init__(self) -> None:
        self.database = Database(sqlite_url(self.root / "wibam.db"))
        self.database.migrate()
        self.folder = DataFolder(self.root)
        self.sites = SiteStore(self.database)
        self.jobs = JobStore(self.database)
        self.leases = LeaseStore(self.database, self.policy)
        self.store = StageStore(self.folder.stages)
        self.dispatched: list[StageKey] = []

    def job(self, recording: Path, stages: int = 1) -> Job:
        """A job with the first stages of the real pipeline, on one short recording for both cameras."""
        site = self.sites.add_site(site_of())
        files = []
        for camera in site.site.camera_ids:
            request = UploadRequest(site.id, Purpose.RECORDING, camera, "x.mp4", recording.stat().st_size)
            upload = self.sites.add_upload(request, lifetime_s=60, quota_bytes=10**9)
            self.folder.upload(upload.id).write_bytes(recording.read_bytes())
            suffix = self.folder.finish(upload.id)
            files.append(self.sites.complete_upload(upload, suffix=suffix, sha256=sha256_of(recording)))
        options = {"preflight": {"min_overlap_s": 1.0}}
        plan: list[StagePlan] = plan_stages(site.site, options, files)[:stages]
        return self.jobs.create(site, options, files, plan)[0]

    def runner(self, limits: StageLimits = LIMITS, **values: object) -> StageRunner:
        return StageRunner(
            self.jobs,
            self.leases,
            self.folder,
            limits,
            self.policy,
            self.dispatched.extend,
            **values,  # type: ignore[arg-type]
        )


@pytest.fixture
def service(tmp_path: Path) -> Service:
    return Service(tmp_path / "data")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "x.mp4", width_px=640, height_px=360, seconds=1.5)


PREFLIGHT = "preflight"


def key(job: Job) -> StageKey:
    return StageKey(job.id, PREFLIGHT)


def failure(service: Service, job: Job) -> dict:
    error = service.jobs.job(job.id).error
    assert error is not None
    return dict(error)


class TestRunning:
    def test_a_stage_is_run_published_and_followed_by_the_next(self, service: Service, recording: Path) -> None:
        job = service.job(recording, stages=2)
        assert service.runner().run(key(job))
        stage = service.jobs.job(job.id).stage(PREFLIGHT)
        assert stage is not None
        assert stage.state is StageState.SUCCEEDED
        assert stage.summary is not None
        assert stage.summary["shortest_s"] == pytest.approx(1.5, abs=0.2)
        folder = service.store.find(PREFLIGHT, stage.hash)
        assert folder is not None
        assert set(json.loads((folder / "probe.json").read_text())) == set(job.site.camera_ids)
        assert service.dispatched == [StageKey(job.id, "sync")]
        assert "[preflight] done" in service.folder.log(job.id).read_text()
        kinds = {event.kind for event in service.jobs.events(job.id)[0]}
        assert kinds == {EventKind.JOB, EventKind.STAGE, EventKind.PROGRESS}

    def test_a_second_delivery_does_nothing(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        assert service.runner().run(key(job))
        before = service.jobs.events(job.id)
        assert not service.runner().run(key(job))
        assert service.jobs.events(job.id) == before

    def test_published_outputs_are_reused(self, service: Service, recording: Path) -> None:
        service.runner().run(key(service.job(recording)))
        again = service.job(recording)
        started = time.monotonic()
        service.runner().run(key(again))
        assert time.monotonic() - started < 1.0
        stage = service.jobs.job(again.id).stage(PREFLIGHT)
        assert stage is not None
        assert stage.state is StageState.REUSED
        assert stage.summary is not None
        assert stage.summary["shortest_s"] > 1

    def test_a_forced_stage_runs_although_its_outputs_are_there(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        service.runner().run(key(job))
        plan = [StagePlan(PREFLIGHT, job.stages[0].hash, ())]
        service.jobs.restart(job.id, job.options, plan, from_stage=PREFLIGHT)
        service.runner().run(key(job))
        assert service.jobs.job(job.id).stages[0].state is StageState.SUCCEEDED


class TestLeftovers:
    def test_of_killed_attempts_go_and_of_running_ones_stay(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        running = service.store.begin(PREFLIGHT, job.stages[0].hash)
        killed = service.store.begin(PREFLIGHT, "f" * 64)
        service.leases.claim(key(job), "somebody")
        service.store.sweep(service.leases.running_hashes)
        assert running.output.exists()
        assert not killed.output.exists()


class TestFailing:
    def test_a_stage_that_refuses_its_input_says_why(self, service: Service, tmp_path: Path) -> None:
        broken = tmp_path / "broken.mp4"
        broken.write_bytes(b"this is no video" * 100)
        job = service.job(broken)
        service.runner().run(key(job))
        error = failure(service, job)
        assert error["code"] == "unreadable_video"
        assert error["hint"]
        assert error["details"]["stage"] == PREFLIGHT
        assert list((service.folder.stages / ".partial").iterdir()) == []

    def test_a_killed_stage_is_a_crash_and_the_next_job_runs(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        killer = threading.Thread(target=_kill_the_stage_of, args=(os.getpid(),))
        killer.start()
        service.runner().run(key(job))
        killer.join()
        error = failure(service, job)
        assert error["code"] == "stage_crashed"
        assert "signal 9" in error["message"]
        assert "log_tail" in error["details"]
        following = service.job(recording)
        service.runner().run(key(following))
        assert service.jobs.job(following.id).state is JobState.SUCCEEDED

    def test_too_much_memory_is_named(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        service.runner(replace(LIMITS, memory_bytes=15_000_000)).run(key(job))
        assert failure(service, job)["code"] == "stage_out_of_memory"

    def test_too_much_time_is_named(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        service.runner(replace(LIMITS, seconds=0.01)).run(key(job))
        assert failure(service, job)["code"] == "stage_timed_out"

    def test_missing_outputs_of_an_earlier_stage_are_named(self, service: Service, recording: Path) -> None:
        job = service.job(recording, stages=2)
        service.runner().run(key(job))
        service.store.remove(PREFLIGHT, job.stages[0].hash)
        service.runner().run(StageKey(job.id, "sync"))
        error = failure(service, job)
        assert error["code"] == "stage_failed"
        assert "preflight" in error["hint"]


class TestStopping:
    def test_a_cancelled_job_stops_its_stage(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        worker = threading.Thread(target=service.runner().run, args=(key(job),))
        worker.start()
        _wait_for(lambda: service.jobs.job(job.id).state is JobState.RUNNING)
        assert service.jobs.cancel(job.id).state is JobState.CANCELLING
        worker.join(10)
        assert service.jobs.job(job.id).state is JobState.CANCELLED
        assert _stages_of(os.getpid()) == []

    def test_a_worker_that_is_asked_to_end_gives_its_stage_back(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        service.runner(stopping=lambda: True).run(key(job))
        stage = service.jobs.job(job.id).stages[0]
        assert stage.state is StageState.QUEUED
        assert service.dispatched == [key(job)]
        service.runner().run(key(job))
        assert service.jobs.job(job.id).state is JobState.SUCCEEDED

    def test_a_worker_that_lost_its_lease_publishes_nothing(self, service: Service, recording: Path) -> None:
        service.policy = LeasePolicy(duration_s=0.9, heartbeat_s=0.3, max_attempts=3)
        job = service.job(recording)
        slow = StageRunner(
            service.jobs,
            LeaseStore(service.database, LeasePolicy(duration_s=0.4, heartbeat_s=0.1)),
            service.folder,
            LIMITS,
            LeasePolicy(duration_s=60.0, heartbeat_s=20.0),  # it forgets its heartbeats
            service.dispatched.extend,
        )
        worker = threading.Thread(target=slow.run, args=(key(job),))
        worker.start()
        _wait_for(lambda: service.leases.reap() != [])
        worker.join(20)
        assert service.dispatched == []
        assert service.store.find(PREFLIGHT, job.stages[0].hash) is None
        assert service.runner().run(key(job))
        assert service.jobs.job(job.id).state is JobState.SUCCEEDED


def _wait_for(condition: object, seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline
        time.sleep(0.02)


def _stages_of(parent: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
            command = (stat.parent / "cmdline").read_bytes()
        except OSError:
            continue
        if int(fields[1]) == parent and b"wibam_core.stages.execute" in command:
            found.append(int(stat.parent.name))
    return found


def _kill_the_stage_of(parent: int) -> None:
    _wait_for(lambda: _stages_of(parent) != [])
    for pid in _stages_of(parent):
        os.kill(pid, signal.SIGKILL)
