from __future__ import annotations

from dataclasses import replace

import pytest

from wibam_core.adapters.database import Database
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.site_store import SiteStore, UploadRequest
from wibam_core.errors import Conflict, InputError, NotFound, QuotaExceeded
from wibam_core.jobs.records import Purpose, SiteRecord, StoredFile
from wibam_core.site import Site
from wibam_core.stages.graph import PlannedStage

CAMERA = {"width_px": 64, "height_px": 48, "calibration": {"kind": "homography", "correspondences": []}}
SITE = Site.model_validate({"name": "Jägerstraße", "cameras": [{"id": "north", **CAMERA}, {"id": "south", **CAMERA}]})


@pytest.fixture
def store(database: Database) -> SiteStore:
    return SiteStore(database, lambda: 1000.0)


@pytest.fixture
def site(store: SiteStore) -> SiteRecord:
    return store.add_site(SITE)


def recording(site: SiteRecord, camera: str = "north", length: int = 10) -> UploadRequest:
    return UploadRequest(site.id, Purpose.RECORDING, camera, "../../etc/passwd\0.mp4", length)


def send(store: SiteStore, request: UploadRequest) -> StoredFile:
    upload = store.add_upload(request, lifetime_s=60, quota_bytes=1000)
    return store.complete_upload(upload, suffix="", sha256="0" * 64)


def test_a_site_comes_back_as_it_was_given(store: SiteStore, site: SiteRecord) -> None:
    assert store.site(site.id) == site
    assert store.sites() == [site]
    with pytest.raises(NotFound):
        store.site("site_0000000000000000")


def test_a_newer_recording_takes_the_place_of_the_older(store: SiteStore, site: SiteRecord) -> None:
    first, other, second = (send(store, recording(site, c)) for c in ("north", "south", "north"))
    assert {file.id for file in store.files(site.id)} == {other.id, second.id}
    assert store.purge_files() == [first.id]


def test_files_that_a_job_needs_are_not_purged(store: SiteStore, site: SiteRecord, database: Database) -> None:
    file = send(store, recording(site))
    jobs = JobStore(database)
    job, _ = jobs.create(site, {}, [file], [PlannedStage("a", "h", ())])
    store.retire_file(site.id, file.id)
    assert store.files(site.id) == []
    assert store.purge_files() == []
    with pytest.raises(Conflict, match="1 job"):
        store.delete_site(site.id)
    jobs.cancel(job.id)
    jobs.delete(job.id, lambda name, hash: None)
    assert store.purge_files() == [file.id]


def test_deleting_a_site_tells_whose_bytes_may_go(store: SiteStore, site: SiteRecord) -> None:
    file = send(store, recording(site))
    upload = store.add_upload(recording(site, "south"), lifetime_s=60, quota_bytes=1000)
    assert set(store.delete_site(site.id)) == {file.id, upload.id}
    assert store.sites() == []
    with pytest.raises(NotFound):
        store.upload(upload.id)


def test_a_site_described_anew_keeps_the_files_of_its_cameras(store: SiteStore, site: SiteRecord) -> None:
    north, south = (send(store, recording(site, camera)) for camera in ("north", "south"))
    labels = send(store, replace(recording(site, ""), purpose=Purpose.LABELS))
    uploads = [store.add_upload(recording(site, c), lifetime_s=60, quota_bytes=1000) for c in ("north", "south")]
    renamed = Site.model_validate({"name": "Renamed", "cameras": [{"id": "north", **CAMERA}, {"id": "east", **CAMERA}]})
    assert store.replace_site(site.id, renamed) == replace(site, site=renamed)
    assert store.site(site.id).site == renamed
    assert {file.id for file in store.files(site.id)} == {north.id, labels.id}
    assert store.purge_files() == [south.id]
    assert store.upload(uploads[0].id) == uploads[0]
    with pytest.raises(NotFound):
        store.upload(uploads[1].id)
    with pytest.raises(NotFound):
        store.complete_upload(uploads[1], suffix="", sha256="0" * 64)
    with pytest.raises(NotFound):
        store.replace_site("site_0000000000000000", renamed)


def test_cameras_must_be_of_the_site(store: SiteStore, site: SiteRecord) -> None:
    with pytest.raises(InputError, match="no camera 'west'") as caught:
        store.add_upload(recording(site, "west"), lifetime_s=60, quota_bytes=1000)
    assert "north, south" in caught.value.hint
    with pytest.raises(InputError):
        store.add_upload(replace(recording(site), purpose=Purpose.LABELS), lifetime_s=60, quota_bytes=1000)


def test_the_quota_counts_what_is_stored_and_what_is_promised(store: SiteStore, site: SiteRecord) -> None:
    send(store, recording(site, length=40))
    store.add_upload(recording(site, "south", length=40), lifetime_s=60, quota_bytes=100)
    with pytest.raises(QuotaExceeded) as caught:
        store.add_upload(recording(site, length=21), lifetime_s=60, quota_bytes=100)
    assert caught.value.details == {"used_bytes": 80, "quota_bytes": 100}
    store.add_upload(recording(site, length=20), lifetime_s=60, quota_bytes=100)


def test_empty_files_are_refused() -> None:
    with pytest.raises(InputError, match="empty"):
        UploadRequest("s", Purpose.LABELS, "", "l.json", 0)


def test_uploads_expire_unless_they_advance(database: Database) -> None:
    now = [1000.0]
    store = SiteStore(database, lambda: now[0])
    site = store.add_site(SITE)
    idle = store.add_upload(recording(site), lifetime_s=60, quota_bytes=1000)
    busy = store.add_upload(recording(site, "south"), lifetime_s=60, quota_bytes=1000)
    now[0] += 50
    store.advance_upload(busy.id, 4, lifetime_s=60)
    now[0] += 20
    assert [upload.id for upload in store.expired_uploads()] == [idle.id]
    assert store.upload(busy.id).offset == 4


def test_migrating_twice_is_harmless(database: Database) -> None:
    database.migrate()
    assert SiteStore(database).sites() == []


def test_the_migrations_make_exactly_the_tables_of_the_models(database: Database) -> None:
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext

    from wibam_core.adapters.models import Base

    with database.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
