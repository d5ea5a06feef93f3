"""A worker whose disk is full, that is stopped or killed at a bad moment, and what it leaves."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import pytest
import sqlalchemy
from sqlalchemy.exc import DBAPIError

from tests.unit.worker.service import PREFLIGHT, Service, key, run_instead
from wibam_core.jobs.records import Job
from wibam_core.jobs.states import JobState, StageState
from wibam_core.stages.graph import PlannedStage
from worker.failures import is_full


@pytest.fixture
def service(tmp_path: Path) -> Service:
    return Service(tmp_path / "data")


@pytest.fixture
def job(service: Service, tmp_path: Path) -> Job:
    recording = tmp_path / "x.mp4"
    recording.write_bytes(b"nobody looks at it")
    return service.job(recording)


@pytest.fixture
def full(tmp_path: Path) -> DBAPIError:
    """What a real database says when there is no room for one more page."""
    engine = sqlalchemy.create_engine(f"sqlite:///{tmp_path / 'full.db'}")
    with engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA max_page_count = 2")
        connection.exec_driver_sql("CREATE TABLE t (x TEXT)")
        with pytest.raises(DBAPIError) as caught:
            connection.exec_driver_sql("INSERT INTO t VALUES (?)", ("x" * 100_000,))
    engine.dispose()
    return caught.value


def restart(service: Service, job: Job) -> None:
    """From the beginning, as a plan of one stage."""
    plan = [PlannedStage(PREFLIGHT, job.stages[0].hash, ())]
    service.jobs.restart(job.id, job.options, plan, from_stage=PREFLIGHT)


class TestFullDisk:
    def test_it_is_known_when_a_database_says_so(self, full: DBAPIError) -> None:
        assert is_full(full)
        assert not is_full(DBAPIError("", None, sqlite3.OperationalError("database is locked")))

    def test_a_log_that_cannot_be_opened_stops_no_work(
        self, service: Service, job: Job, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        service.folder.log(job.id).mkdir()
        run_instead(monkeypatch, "done()")
        assert service.runner().run(key(job))
        assert service.jobs.job(job.id).state is JobState.SUCCEEDED

    def test_a_database_without_room_is_named(
        self, service: Service, job: Job, monkeypatch: pytest.MonkeyPatch, full: DBAPIError
    ) -> None:
        refusals = [full, full]
        fail = service.leases.fail

        def refuse(*_: object, **__: object) -> None:
            raise full

        def fail_at_last(*arguments: object) -> object:
            if refusals:
                raise refusals.pop()
            return fail(*arguments)  # type: ignore[arg-type]

        monkeypatch.setattr(service.leases, "succeed", refuse)
        monkeypatch.setattr(service.leases, "fail", fail_at_last)
        run_instead(monkeypatch, "done()")
        assert service.runner().run(key(job))
        error = service.jobs.job(job.id).error
        assert error is not None
        assert error["code"] == "disk_full"
        assert error["hint"]


class TestMakingAnew:
    def test_a_stage_that_was_given_back_keeps_its_scratch(
        self, service: Service, job: Job, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        run_instead(monkeypatch, "done(found=os.listdir(request['scratch']))")
        service.runner().run(key(job))
        restart(service, job)
        run_instead(monkeypatch, "open(request['scratch'] + '/checkpoint', 'w').close(); print(1); time.sleep(600)")
        checkpoint = service.folder.stages / ".scratch" / f"{PREFLIGHT}-{job.stages[0].hash[:32]}" / "checkpoint"
        service.runner(stopping=checkpoint.exists).run(key(job))
        assert service.jobs.job(job.id).stages[0].state is StageState.QUEUED
        run_instead(monkeypatch, "done(found=os.listdir(request['scratch']))")
        service.runner().run(key(job))
        assert service.jobs.job(job.id).stages[0].summary == {"found": ["checkpoint"]}

    def test_a_death_before_the_removal_does_not_let_the_old_output_pass(
        self, service: Service, job: Job, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        run_instead(monkeypatch, "done(n=1)")
        service.runner().run(key(job))
        restart(service, job)
        claim = service.leases.claim(key(job), "killed")
        assert claim is not None
        with service.database.engine.begin() as connection:
            connection.execute(sqlalchemy.text("UPDATE stage_runs SET lease_expires_at = 0"))
        assert service.leases.reap() == [key(job)]
        run_instead(monkeypatch, "done(n=2)")
        service.runner().run(key(job))
        stage = service.jobs.job(job.id).stages[0]
        assert (stage.state, stage.summary) == (StageState.SUCCEEDED, {"n": 2})


class TestLeftovers:
    def test_a_stages_home_is_where_the_sweep_looks(
        self, service: Service, job: Job, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        run_instead(monkeypatch, "done(folders=[os.environ['HOME'], os.environ['TMPDIR'], os.getcwd()])")
        service.runner().run(key(job))
        summary = service.jobs.job(job.id).stages[0].summary
        assert summary is not None
        partial = service.folder.stages / ".partial"
        assert {Path(folder).parent for folder in summary["folders"]} == {partial}
        assert list(partial.iterdir()) == []

    def test_outputs_of_options_that_are_gone_are_removed(
        self, service: Service, job: Job, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        run_instead(monkeypatch, "done()")
        service.runner().run(key(job))
        old, new = job.stages[0].hash, "f" * 64
        assert service.store.find(PREFLIGHT, old) is not None
        service.jobs.restart(job.id, {}, [PlannedStage(PREFLIGHT, new, ())])
        service.runner().run(key(job))
        assert service.store.find(PREFLIGHT, old) is None
        assert json.loads((service.folder.stages / f"{PREFLIGHT}-{new[:32]}" / "manifest.json").read_text())
