"""What a worker works on, in a folder of its own, and stages that do what a test wants."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.builders import site_of
from tests.databases import migrated
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.adapters.planning import plan_stages
from wibam_core.adapters.settings import StageLimits
from wibam_core.adapters.site_store import SiteStore, UploadRequest
from wibam_core.jobs.leases import LeasePolicy
from wibam_core.jobs.records import Job, Purpose
from wibam_core.stages.execute import StageRequest
from wibam_core.stages.graph import PlannedStage
from wibam_core.stages.store import StageStore, sha256_of
from worker.process import StageProcess
from worker.runner import StageRunner
from worker.workplace import Workplace

POLICY = LeasePolicy(duration_s=600.0, heartbeat_s=0.2, max_attempts=2)
LIMITS = StageLimits(memory_bytes=4_000_000_000, seconds=600.0)
PREFLIGHT = "preflight"


@dataclass
class Service:
    """What a worker works on, in a folder of its own."""

    root: Path
    policy: LeasePolicy = POLICY

    def __post_init__(self) -> None:
        self.database = migrated(self.root / "wibam.db")
        self.folder = DataFolder(self.root)
        self.sites = SiteStore(self.database)
        self.jobs = JobStore(self.database)
        self.leases = LeaseStore(self.database, self.policy)
        self.store = StageStore(self.folder.stages)
        self.dispatched: list[StageKey] = []

    def job(self, recording: Path, stages: int = 1, **more: Mapping[str, object]) -> Job:
        """A job with the first stages of the real pipeline, on one short recording for both cameras."""
        site = self.sites.add_site(site_of())
        files = []
        for camera in site.site.camera_ids:
            request = UploadRequest(site.id, Purpose.RECORDING, camera, "x.mp4", recording.stat().st_size)
            upload = self.sites.add_upload(request, lifetime_s=60, quota_bytes=10**9)
            self.folder.upload(upload.id).write_bytes(recording.read_bytes())
            suffix = self.folder.finish(upload.id)
            files.append(self.sites.complete_upload(upload, suffix=suffix, sha256=sha256_of(recording)))
        options = {"preflight": {"min_overlap_s": 1.0}, **more}
        plan: list[PlannedStage] = plan_stages(site.site, options, files)[:stages]
        return self.jobs.create(site, options, files, plan)[0]

    def runner(self, limits: StageLimits = LIMITS, **values: object) -> StageRunner:
        at = Workplace(self.jobs, self.folder, limits, self.policy, "worker", **values)  # type: ignore[arg-type]
        return StageRunner(at, self.leases, self.dispatched.extend)


def key(job: Job) -> StageKey:
    return StageKey(job.id, PREFLIGHT)


def run_instead(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """From now on every stage is this program, with ``request`` what it is told and ``done(summary)`` its end."""
    prelude = """
import json, os, sys, time
request = json.load(open(sys.argv[1]))
def done(**summary):
    print(json.dumps({"event": "done", "summary": summary}), flush=True)
"""

    def start(request: StageRequest, *, home: Path, cache: Path, nice: int) -> StageProcess:
        told = home / "request.json"
        told.write_text(request.model_dump_json())
        program = [sys.executable, "-c", prelude + code, str(told)]
        return StageProcess.confined(
            program, home=home, cache=cache, nice=nice, reads=request.reads, writes=request.writes
        )

    monkeypatch.setattr(StageProcess, "start", start)


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 600.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)
