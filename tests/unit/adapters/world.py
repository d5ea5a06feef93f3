"""The stores of jobs on one database, with a small graph of stages and a clock."""

from __future__ import annotations

from dataclasses import dataclass, field

from wibam_core.adapters.database import Database
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.adapters.site_store import SiteStore, UploadRequest
from wibam_core.jobs.leases import Claim, LeasePolicy
from wibam_core.jobs.records import Job, Purpose, SiteRecord, StoredFile
from wibam_core.site import Site
from wibam_core.stages.graph import PlannedStage

CAMERA = {"id": "north", "width_px": 64, "height_px": 48}
SITE = Site.model_validate(
    {"name": "s", "cameras": [{**CAMERA, "calibration": {"kind": "homography", "correspondences": []}}]}
)
POLICY = LeasePolicy(duration_s=30.0, heartbeat_s=5.0, max_attempts=2, resend_s=60.0)


def plan(tag: str = "") -> list[PlannedStage]:
    shape = {"a": (), "b": ("a",), "c": ("a",), "d": ("b", "c")}
    return [PlannedStage(name, f"{name}{tag}".ljust(64, "0"), requires) for name, requires in shape.items()]


@dataclass
class World:
    """The stores on one database, with a clock that the test moves."""

    database: Database
    time: float = 1000.0
    site: SiteRecord = field(init=False)
    file: StoredFile = field(init=False)

    def __post_init__(self) -> None:
        self.sites = SiteStore(self.database, lambda: self.time)
        self.jobs = JobStore(self.database, lambda: self.time)
        self.leases = LeaseStore(self.database, POLICY, lambda: self.time)
        self.site = self.sites.add_site(SITE)
        request = UploadRequest(self.site.id, Purpose.RECORDING, "north", "n.mp4", 10)
        upload = self.sites.add_upload(request, lifetime_s=60, quota_bytes=100)
        self.file = self.sites.complete_upload(upload, suffix="", sha256="0" * 64)

    def job(self, tag: str = "", **values: object) -> Job:
        return self.jobs.create(self.site, {}, [self.file], plan(tag), **values)[0]  # type: ignore[arg-type]

    def claim(self, job: Job, stage: str, owner: str = "w1") -> Claim:
        claim = self.leases.claim(StageKey(job.id, stage), owner)
        assert claim is not None
        return claim

    def do(self, job: Job, stage: str) -> list[StageKey]:
        return self.leases.succeed(self.claim(job, stage), {"n": 1}, lambda: None)

    def states(self, job: Job) -> dict[str, str]:
        return {stage.name: stage.state.value for stage in self.jobs.job(job.id).stages}
