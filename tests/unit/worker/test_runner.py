"""A worker's deliveries, with the real executor, the real database and a real recording."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.builders import AMBIGUOUS
from tests.recordings import write_recording
from tests.unit.worker.service import LIMITS, PREFLIGHT, Service, key, run_instead, wait_for
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.adapters.planning import plan_stages
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.artifacts.catalogue import PROBE
from wibam_core.jobs.leases import LeasePolicy
from wibam_core.jobs.records import EventKind, Job
from wibam_core.jobs.states import JobState, StageState
from wibam_core.stages.graph import PlannedStage
from wibam_core.video.encode import VideoWriter
from worker.runner import StageRunner
from worker.workplace import Workplace


@pytest.fixture
def service(tmp_path: Path) -> Service:
    return Service(tmp_path / "data")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "x.mp4", width_px=640, height_px=360, seconds=1.5)


def failure(service: Service, job: Job) -> dict:
    error = service.jobs.job(job.id).error
    assert error is not None
    return dict(error)


class TestRunning:
    def test_a_stage_is_run_published_and_followed_by_the_next(self, service: Service, recording: Path) -> None:
        job = service.job(recording, stages=3)
        assert service.runner().run(StageKey(job.id, "calibrate"))
        assert service.dispatched == []
        assert service.runner().run(key(job))
        stage = service.jobs.job(job.id).stage(PREFLIGHT)
        assert stage is not None
        assert stage.state is StageState.SUCCEEDED
        assert stage.summary is not None
        assert stage.summary["shortest_s"] == pytest.approx(1.5, abs=0.2)
        folder = service.store.find(PREFLIGHT, stage.hash)
        assert folder is not None
        assert set(ArtifactReader({"preflight": folder}).read(PROBE).cameras) == set(job.site.camera_ids)
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

    def test_published_outputs_are_reused(
        self, service: Service, recording: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        service.runner().run(key(service.job(recording)))
        again = service.job(recording)
        run_instead(monkeypatch, "sys.exit('it was run')")
        service.runner().run(key(again))
        stage = service.jobs.job(again.id).stage(PREFLIGHT)
        assert stage is not None
        assert stage.state is StageState.REUSED
        assert stage.summary is not None
        assert stage.summary["shortest_s"] > 1

    def test_a_forced_stage_runs_although_its_outputs_are_there(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        service.runner().run(key(job))
        plan = [PlannedStage(PREFLIGHT, job.stages[0].hash, ())]
        service.jobs.restart(job.id, job.options, plan, from_stage=PREFLIGHT)
        service.runner().run(key(job))
        assert service.jobs.job(job.id).stages[0].state is StageState.SUCCEEDED


class TestWarnings:
    def test_are_kept_logged_and_said_again_where_outputs_are_reused(self, service: Service, tmp_path: Path) -> None:
        recording = tmp_path / "gap.mp4"
        with VideoWriter(recording, 640, 360, 10.0) as writer:
            for number in range(40):
                if not 10 <= number < 25:
                    writer.write(np.full((360, 640, 3), number, np.uint8), number * 100_000_000)
        for state in (StageState.SUCCEEDED, StageState.REUSED):
            job = service.job(recording)
            service.runner().run(key(job))
            [stage] = service.jobs.job(job.id).stages
            assert stage.state is state
            said = [(warning.stage, warning.code) for warning in stage.warnings]
            cameras = len(job.site.cameras)  # which share the recording; each but the first is told so
            assert Counter(said) == {(PREFLIGHT, "recording_gap"): cameras, (PREFLIGHT, "same_recording"): cameras - 1}
            gap = next(warning for warning in stage.warnings if warning.code == "recording_gap")
            assert "no frame for 1.6 s" in gap.message
            assert f"warning: {gap.message}" in service.folder.log(job.id).read_text()
            last = service.jobs.events(job.id)[0][-2]
            assert [(PREFLIGHT, warning["code"]) for warning in last.data["warnings"]] == said

    def test_of_a_stage_that_fails_are_kept(
        self, service: Service, recording: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        job = service.job(recording)
        warned = {"event": "warning", "warning": AMBIGUOUS.model_dump()}
        failed = {"event": "failed", "error": {"code": "no_overlap", "message": "too short", "hint": ""}}
        run_instead(monkeypatch, f"print(json.dumps({warned!r})); print(json.dumps({failed!r})); sys.exit(1)")
        service.runner().run(key(job))
        [stage] = service.jobs.job(job.id).stages
        assert stage.state is StageState.FAILED
        assert stage.warnings == (AMBIGUOUS,)


class TestEarlierOutputs:
    def test_frames_that_are_there_are_not_read_again(self, service: Service, recording: Path, tmp_path: Path) -> None:
        """A restart with another rate leaves the old frames without a job: they stay until the new ones are made."""
        job = service.job(recording, stages=4, sync={"method": "none"})
        for stage in job.stages:
            assert service.runner().run(StageKey(job.id, stage.name))
        (old,) = service.store.root.glob("frames-*")
        options = {**job.options, "frames": {"rate_hz": 5.0}}
        service.jobs.restart(job.id, options, plan_stages(job.site, options, job.files)[:4])
        service.runner().run(key(service.job(write_recording(tmp_path / "other.mp4", width_px=640, height_px=360))))
        assert old.exists()
        for file in job.files:
            service.folder.file(file).write_bytes(b"no film")
        assert service.runner().run(StageKey(job.id, "frames"))
        stage = service.jobs.job(job.id).stage("frames")
        assert stage is not None
        assert (stage.state, stage.summary and stage.summary["instants"]) == (StageState.SUCCEEDED, 8)
        assert not old.exists()


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

    def test_a_killed_stage_is_a_crash_and_the_next_job_runs(
        self, service: Service, recording: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        job = service.job(recording)
        with monkeypatch.context() as patched:
            run_instead(patched, "os.kill(os.getpid(), 9)")
            service.runner().run(key(job))
            assert service.jobs.job(job.id).state is JobState.RUNNING
            assert service.dispatched == [key(job)], "it is tried once more"
            service.runner().run(key(job))
        assert service.dispatched == [key(job)]
        error = failure(service, job)
        assert error["code"] == "stage_crashed"
        assert "was killed by signal 9 (SIGKILL), in attempt 2" in error["message"]
        assert "log_tail" in error["details"]
        following = service.job(recording)
        service.runner().run(key(following))
        assert service.jobs.job(following.id).state is JobState.SUCCEEDED

    def test_a_stage_that_was_killed_once_ends_well(
        self, service: Service, recording: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        job = service.job(recording)
        run_instead(
            monkeypatch,
            "mark = os.path.join(request['scratch'], 'before')\n"
            "if os.path.exists(mark): done()\n"
            "else: open(mark, 'w').close(); os.kill(os.getpid(), 11)",
        )
        service.runner().run(key(job))
        [stage] = service.jobs.job(job.id).stages
        assert (stage.state, stage.attempts) == (StageState.QUEUED, 1)
        reasons = [event.data.get("reason") for event in service.jobs.events(job.id)[0]]
        assert "was killed by signal 11 (SIGSEGV)" in str(reasons[-1])
        service.runner().run(key(job))
        assert service.jobs.job(job.id).state is JobState.SUCCEEDED

    def test_too_much_memory_is_named(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        service.runner(replace(LIMITS, memory_bytes=1_000_000)).run(key(job))
        assert failure(service, job)["code"] == "stage_out_of_memory"

    def test_a_job_that_would_take_too_long_is_refused_once_its_recordings_are_known(
        self, service: Service, recording: Path
    ) -> None:
        job = service.job(recording, stages=3)
        strict = service.runner(replace(LIMITS, job_seconds=1e-3))
        assert strict.run(key(job))
        assert strict.run(StageKey(job.id, "calibrate"))
        error = failure(service, job)
        assert error["code"] == "too_costly"
        assert "h are allowed" in error["message"]
        assert "WIBAM_JOB_HOURS" in error["hint"]
        service.jobs.restart(job.id, job.options, plan_stages(job.site, job.options, job.files)[:3])
        service.runner().run(StageKey(job.id, "calibrate"))
        assert service.jobs.job(job.id).stages[1].state is not StageState.FAILED

    def test_too_much_time_is_named(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        service.runner(replace(LIMITS, seconds=1e-6)).run(key(job))
        assert failure(service, job)["code"] == "stage_timed_out"

    def test_many_times_what_was_expected_is_ended_and_said(self, service: Service, recording: Path) -> None:
        job = service.job(recording, stages=3)
        impatient = service.runner(replace(LIMITS, times_expected=1e-6, least_seconds=1e-6))
        impatient.run(key(job))
        assert service.jobs.job(job.id).stages[0].state is StageState.SUCCEEDED, "nothing is expected of the first one"
        impatient.run(StageKey(job.id, "calibrate"))
        error = failure(service, job)
        assert error["code"] == "stage_timed_out"
        assert "s were expected" in error["message"]
        assert "WIBAM_STAGE_TIMES_EXPECTED" in error["hint"]

    def test_missing_outputs_of_an_earlier_stage_are_named(self, service: Service, recording: Path) -> None:
        job = service.job(recording, stages=3)
        service.runner().run(key(job))
        service.runner().run(StageKey(job.id, "calibrate"))
        service.store.remove(PREFLIGHT, job.stages[0].hash)
        service.runner().run(StageKey(job.id, "sync"))
        error = failure(service, job)
        assert error["code"] == "stage_failed"
        assert "preflight" in error["hint"]


class TestStopping:
    def test_a_cancelled_job_stops_its_stage(
        self, service: Service, recording: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        job, started = service.job(recording), service.folder.cache / "started"
        run_instead(monkeypatch, f"open({str(started)!r}, 'w').write(str(os.getpid())); time.sleep(600)")
        worker = threading.Thread(target=service.runner().run, args=(key(job),))
        worker.start()
        wait_for(lambda: started.exists() and started.read_text() != "")
        assert service.jobs.cancel(job.id).state is JobState.CANCELLING
        worker.join(600)
        assert service.jobs.job(job.id).state is JobState.CANCELLED
        assert not Path("/proc", started.read_text()).exists()

    def test_a_worker_that_is_asked_to_end_gives_its_stage_back(self, service: Service, recording: Path) -> None:
        job = service.job(recording)
        service.runner(stopping=lambda: True).run(key(job))
        stage = service.jobs.job(job.id).stages[0]
        assert stage.state is StageState.QUEUED
        assert service.dispatched == [key(job)]
        service.runner().run(key(job))
        assert service.jobs.job(job.id).state is JobState.SUCCEEDED

    def test_a_worker_that_lost_its_lease_publishes_nothing(
        self, service: Service, recording: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        job, go_on = service.job(recording), tmp_path / "go on"
        forgetful = LeasePolicy(duration_s=6000.0, heartbeat_s=2000.0)  # it forgets its heartbeats
        slow = StageRunner(
            Workplace(service.jobs, service.folder, LIMITS, forgetful, "slow"),
            LeaseStore(service.database, LeasePolicy(duration_s=0.4, heartbeat_s=0.1)),
            service.dispatched.extend,
        )
        with monkeypatch.context() as patched:
            run_instead(patched, f"while not os.path.exists({str(go_on)!r}): time.sleep(0.02)\ndone()")
            worker = threading.Thread(target=slow.run, args=(key(job),))
            worker.start()
            wait_for(lambda: service.leases.reap() != [])
            go_on.touch()
            worker.join(600)
        assert service.dispatched == []
        assert service.store.find(PREFLIGHT, job.stages[0].hash) is None
        assert service.runner().run(key(job))
        assert service.jobs.job(job.id).state is JobState.SUCCEEDED
