"""What routes work with, made once an application."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from api.figures import Figures
from api.sessions import Passes, ReportLinks
from wibam_core.adapters.audit_store import AuditStore
from wibam_core.adapters.clip_store import ClipStore
from wibam_core.adapters.comparing import Comparing
from wibam_core.adapters.counters import Watch
from wibam_core.adapters.database import Database
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.glimpses import Glimpses
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.key_store import KeyStore
from wibam_core.adapters.label_store import LabelStore
from wibam_core.adapters.lease_store import LeaseStore
from wibam_core.adapters.model_keeping import ModelKeeper
from wibam_core.adapters.model_store import ModelStore
from wibam_core.adapters.queue import JobQueue, make_celery
from wibam_core.adapters.results import JobResults
from wibam_core.adapters.reuse import Reuse
from wibam_core.adapters.review_store import ReviewStore
from wibam_core.adapters.runs import Runs
from wibam_core.adapters.settings import ServiceSettings
from wibam_core.adapters.site_maps import SiteMaps
from wibam_core.adapters.site_store import SiteStore
from wibam_core.adapters.site_tracks import SiteTracks
from wibam_core.adapters.uploads import UploadService
from wibam_core.adapters.webhook_sending import WebhookSender
from wibam_core.adapters.webhook_store import WebhookStore
from wibam_core.stages.store import StageStore


@dataclass(frozen=True)
class Services:
    """The adapters, put together."""

    settings: ServiceSettings
    database: Database
    folder: DataFolder
    sites: SiteStore
    uploads: UploadService
    jobs: JobStore
    leases: LeaseStore
    queue: JobQueue
    reuse: Reuse
    results: JobResults
    labels: LabelStore
    stages: StageStore
    reviews: ReviewStore
    passes: Passes
    report_links: ReportLinks
    keys: KeyStore
    audit: AuditStore
    figures: Figures
    glimpses: Glimpses
    clips: ClipStore
    models: ModelStore
    keeper: ModelKeeper
    runs: Runs
    site_tracks: SiteTracks
    maps: SiteMaps
    comparing: Comparing
    webhooks: WebhookStore
    webhook_sender: WebhookSender

    @classmethod
    def connect(cls, settings: ServiceSettings) -> Services:
        """Nothing is opened yet: connections are made when they are first used."""
        folder = DataFolder(settings.data_dir)
        database = Database(settings.database_url)
        sites, jobs, models = SiteStore(database), JobStore(database), ModelStore(database)
        results, stages, glimpses = JobResults(folder.stages), StageStore(folder.stages), Glimpses()
        leases, webhooks = LeaseStore(database, settings.leases), WebhookStore(database)
        # with another token, what rested on the old one ends
        signing_secret = f"{folder.secret()}:{settings.token_sha256}"
        return cls(
            settings=settings,
            database=database,
            folder=folder,
            sites=sites,
            uploads=UploadService(
                sites, folder, quota_bytes=settings.upload_quota_bytes, lifetime_s=settings.upload_lifetime_s
            ),
            jobs=jobs,
            leases=leases,
            queue=JobQueue(make_celery(settings.broker_url)),
            reuse=Reuse(leases, folder, f"{socket.gethostname()}:{os.getpid()}:api"),
            results=results,
            labels=LabelStore(database),
            stages=stages,
            reviews=ReviewStore(database),
            passes=Passes(signing_secret),
            report_links=ReportLinks(signing_secret),
            keys=KeyStore(database),
            audit=AuditStore(database),
            figures=Figures(Watch(database).look),
            clips=ClipStore(database, settings.leases),
            glimpses=glimpses,
            models=models,
            keeper=ModelKeeper(models, jobs, sites, results, folder, glimpses),
            runs=Runs(models, jobs, sites, folder, stages),
            site_tracks=SiteTracks(database, jobs, results, folder),
            maps=SiteMaps(database, sites, folder, glimpses),
            comparing=Comparing(models, jobs, results, folder, glimpses),
            webhooks=webhooks,
            webhook_sender=WebhookSender(webhooks, settings.webhook_networks),
        )


def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


ServicesDep = Annotated[Services, Depends(_services)]
