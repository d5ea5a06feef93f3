"""Leases are kept while the database answers, and given up in time when it does not. The clocks are the test's."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import sqlalchemy
from sqlalchemy import select

from tests.builders import corner_rig, site_of
from tests.databases import migrated
from wibam_core.adapters.database import Database
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.adapters.models import StageRow
from wibam_core.adapters.site_store import SiteStore
from wibam_core.jobs.leases import Claim, LeasePolicy
from wibam_core.stages.graph import PlannedStage
from worker import keeper as keeper_module
from worker.keeper import LeaseKeeper

POLICY = LeasePolicy(duration_s=600.0, heartbeat_s=0.02)


@dataclass
class Clock:
    now: float = 1000.0

    def __call__(self) -> float:
        return self.now

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def database(tmp_path: Path) -> Database:
    return migrated(tmp_path / "wibam.db")


@pytest.fixture
def leases(database: Database, clock: Clock) -> LeaseStore:
    return LeaseStore(database, POLICY, clock)


@pytest.fixture
def claim(database: Database, leases: LeaseStore) -> Claim:
    site = SiteStore(database).add_site(site_of(corner_rig(2)))
    job, _ = JobStore(database).create(site, {}, [], [PlannedStage("a", "h", ())])
    claim = leases.claim(StageKey(job.id, "a"), "w")
    assert claim is not None
    return claim


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 600.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_kept_lease_does_not_expire(database: Database, leases: LeaseStore, claim: Claim, clock: Clock) -> None:
    def expires() -> float | None:
        with database.reading() as session:
            return session.scalar(select(StageRow.lease_expires_at))

    with LeaseKeeper(leases, claim, POLICY) as keeper:
        for _ in range(3):
            clock.now += 0.9 * POLICY.duration_s
            wait_for(lambda: expires() == clock.now + POLICY.duration_s)
            assert leases.reap() == []
    assert not keeper.lost
    assert not keeper.unwanted


def test_a_cancelled_job_is_heard_of(database: Database, leases: LeaseStore, claim: Claim) -> None:
    with LeaseKeeper(leases, claim, POLICY) as keeper:
        JobStore(database).cancel(claim.job_id)
        wait_for(lambda: keeper.unwanted)
    assert not keeper.lost


def test_a_lease_that_somebody_else_has_is_lost(leases: LeaseStore, claim: Claim, clock: Clock) -> None:
    clock.now += 2 * POLICY.duration_s
    assert leases.reap() == [StageKey(claim.job_id, claim.stage)]
    with LeaseKeeper(leases, claim, POLICY) as keeper:
        wait_for(lambda: keeper.lost)


def test_a_lease_that_cannot_be_renewed_is_given_up_when_it_expires(
    database: Database,
    leases: LeaseStore,
    claim: Claim,
    clock: Clock,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(keeper_module, "time", clock)
    with database.engine.begin() as connection:
        connection.execute(sqlalchemy.text("ALTER TABLE stage_runs RENAME TO away"))
    with LeaseKeeper(leases, claim, POLICY) as keeper:
        clock.now += 0.9 * POLICY.duration_s
        wait_for(lambda: len(caplog.records) >= 3)
        assert not keeper.lost
        clock.now += 0.2 * POLICY.duration_s
        wait_for(lambda: keeper.lost)
