"""Leases are kept while the database answers, and given up in time when it does not."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import sqlalchemy

from tests.builders import corner_rig, site_of
from wibam_core.adapters.database import Database, sqlite_url
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.job_store import JobStore, StagePlan
from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.adapters.site_store import SiteStore
from wibam_core.jobs.leases import Claim, LeasePolicy
from worker.keeper import LeaseKeeper

POLICY = LeasePolicy(duration_s=0.6, heartbeat_s=0.1)


@pytest.fixture
def database(tmp_path: Path) -> Database:
    database = Database(sqlite_url(tmp_path / "wibam.db"))
    database.migrate()
    return database


@pytest.fixture
def leases(database: Database) -> LeaseStore:
    return LeaseStore(database, POLICY)


@pytest.fixture
def claim(database: Database, leases: LeaseStore) -> Claim:
    site = SiteStore(database).add_site(site_of(corner_rig(2)))
    job, _ = JobStore(database).create(site, {}, [], [StagePlan("a", "h", ())])
    claim = leases.claim(StageKey(job.id, "a"), "w")
    assert claim is not None
    return claim


def test_a_kept_lease_does_not_expire(leases: LeaseStore, claim: Claim) -> None:
    with LeaseKeeper(leases, claim, POLICY) as keeper:
        time.sleep(3 * POLICY.duration_s)
        assert leases.reap() == []
    assert not keeper.lost
    assert not keeper.unwanted


def test_a_cancelled_job_is_heard_of(database: Database, leases: LeaseStore, claim: Claim) -> None:
    with LeaseKeeper(leases, claim, POLICY) as keeper:
        JobStore(database).cancel(claim.job_id)
        time.sleep(3 * POLICY.heartbeat_s)
    assert keeper.unwanted
    assert not keeper.lost


def test_a_lease_that_cannot_be_renewed_is_given_up_when_it_expires(
    database: Database, leases: LeaseStore, claim: Claim
) -> None:
    with database.engine.begin() as connection:
        connection.execute(sqlalchemy.text("ALTER TABLE stage_runs RENAME TO away"))
    with LeaseKeeper(leases, claim, POLICY) as keeper:
        time.sleep(POLICY.duration_s / 2)
        assert not keeper.lost
        time.sleep(POLICY.duration_s)
    assert keeper.lost
