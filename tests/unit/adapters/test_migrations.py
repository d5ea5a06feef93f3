"""What migrations make of rows that older versions have written."""

from __future__ import annotations

from pathlib import Path

import pytest
from alembic import command
from alembic.config import Config

from tests.unit.adapters.test_site_store import CAMERA
from wibam_core.adapters import database as database_module
from wibam_core.adapters.database import Database
from wibam_core.adapters.planning import plan_stages
from wibam_core.adapters.site_store import SiteStore, UploadRequest
from wibam_core.errors import MissingCamera
from wibam_core.jobs.records import Purpose, Upload
from wibam_core.site import Site

APART, COMPOSED = "Su\u0308d.mp4", "S\u00fcd.mp4"
UNLISTED = Site.model_validate({"name": "Jägerstraße", "cameras": [{"id": "north", **CAMERA}]})
LISTED = Site.model_validate({"name": "Jägerstraße", "cameras": [{"id": "north", **CAMERA, "recordings": [COMPOSED]}]})


def taken_back(database: Database, revision: str) -> None:
    config = Config()
    config.set_main_option("script_location", str(Path(database_module.__file__).parent / "migrations"))
    with database.engine.connect() as connection:
        config.attributes["connection"] = connection
        command.downgrade(config, revision)


def test_files_whose_names_keep_accents_apart_are_those_that_a_site_lists(database: Database) -> None:
    now = [1000.0]
    store = SiteStore(database, lambda: now[0])
    site = store.add_site(UNLISTED)

    def begun(name: str, purpose: Purpose = Purpose.RECORDING) -> Upload:
        now[0] += 1.0
        return store.add_upload(UploadRequest(site.id, purpose, "north", name, 10), lifetime_s=60, quota_bytes=1000)

    recording = store.complete_upload(begun(APART), suffix="", sha256="0" * 64)
    store.complete_upload(begun(COMPOSED, Purpose.FOOTAGE), suffix="", sha256="1" * 64)
    newer = store.complete_upload(begun(APART, Purpose.FOOTAGE), suffix="", sha256="2" * 64)
    unfinished = begun(APART)
    with pytest.raises(MissingCamera, match="was not uploaded"):
        plan_stages(LISTED, {}, store.files(site.id))
    taken_back(database, "0016")
    database.migrate()
    names = {file.id: file.filename for file in store.footage(site.id)}
    assert names == {recording.id: COMPOSED, newer.id: COMPOSED}
    assert plan_stages(LISTED, {}, store.files(site.id))
    store.replace_site(site.id, LISTED)
    assert store.upload(unfinished.id).filename == COMPOSED
    done = store.complete_upload(store.upload(unfinished.id), suffix="", sha256="3" * 64)
    assert {file.id for file in store.footage(site.id)} == {done.id, newer.id}
