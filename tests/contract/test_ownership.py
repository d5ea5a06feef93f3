"""A data folder belongs to one database: with another, the service does not start, and removes nothing."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy

from tests.conftest import ROOT
from tests.service import live_api, settings_for
from wibam_core.adapters.database import Database, sqlite_url
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.models import DatabaseIdRow
from wibam_core.adapters.ownership import claim_folder
from wibam_core.errors import Conflict


@pytest.fixture
def used(tmp_path: Path) -> Path:
    """A data folder in which a service has kept a recording, long ago."""
    data = tmp_path / "data"
    with live_api(settings_for(data)) as api:
        api.upload(api.site(), b"a recording")
    for path in (data / "files").iterdir():
        os.utime(path, (0, 0))
    return data


@pytest.fixture
def other(tmp_path: Path) -> Iterator[Database]:
    database = Database(sqlite_url(tmp_path / "other.db"))
    database.migrate()
    yield database
    database.close()


def files(data: Path) -> list[str]:
    return [path.name for path in (data / "files").iterdir()]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_another_database_is_refused_before_anything_is_removed(used: Path, other: Database) -> None:
    before = files(used)
    with (
        pytest.raises(AssertionError, match="did not start"),
        live_api(settings_for(used, database_url=other.url)),
    ):
        pass
    assert files(used) == before
    with pytest.raises(Conflict, match="another database") as caught:
        claim_folder(other, DataFolder(used))
    assert "WIBAM_DATABASE_URL" in caught.value.hint


def test_its_own_database_goes_on(used: Path) -> None:
    with live_api(settings_for(used)) as api:
        api.services.uploads.tidy()
        assert len(files(used)) == 1


def test_a_folder_of_before_is_taken_by_the_database_that_knows_its_files(used: Path, other: Database) -> None:
    (used / "database-id").unlink()
    with pytest.raises(Conflict, match="does not know"):
        claim_folder(other, DataFolder(used))
    with live_api(settings_for(used)):
        assert (used / "database-id").is_file()


def test_a_lock_that_a_killed_service_left_is_nobodys_file(tmp_path: Path, other: Database) -> None:
    folder = DataFolder(tmp_path / "data")
    (folder.root / "uploads" / "file_0123456789abcdef.lock").touch()
    claim_folder(other, folder)
    assert folder.database_id() is not None


def test_a_new_folder_is_taken_and_private(tmp_path: Path, other: Database) -> None:
    folder = DataFolder(tmp_path / "new" / "data")
    assert stat.S_IMODE(folder.root.stat().st_mode) == 0o700
    claim_folder(other, folder)
    claim_folder(other, folder)
    assert folder.database_id() is not None


class TestAnotherDisk:
    def test_an_empty_folder_is_refused_where_the_service_has_one(self, used: Path, tmp_path: Path) -> None:
        own = Database(sqlite_url(used / "wibam.db"))
        with pytest.raises(Conflict, match="not the one in which this service's files are") as caught:
            claim_folder(own, DataFolder(tmp_path / "local"))
        assert "one folder" in caught.value.hint
        claim_folder(own, DataFolder(used))
        own.close()

    def test_one_that_takes_the_place_of_a_lost_one_is_taken_when_told_so(self, used: Path, tmp_path: Path) -> None:
        own, fresh = Database(sqlite_url(used / "wibam.db")), DataFolder(tmp_path / "fresh")
        with pytest.raises(Conflict) as caught:
            claim_folder(own, fresh)
        (folder_id,) = re.findall("folder_[0-9a-f]{16}", caught.value.hint)
        (fresh.root / "folder-id").write_text(folder_id)
        claim_folder(own, fresh)
        own.close()

    def test_of_a_service_of_before_the_folder_with_its_files_is_the_one(self, used: Path, tmp_path: Path) -> None:
        own = Database(sqlite_url(used / "wibam.db"))
        (used / "folder-id").unlink()
        with own.writing() as session:
            session.execute(sqlalchemy.update(DatabaseIdRow).values(folder_id=None))
        with pytest.raises(Conflict, match="not the one"):
            claim_folder(own, DataFolder(tmp_path / "local"))
        claim_folder(own, DataFolder(used))
        assert (used / "folder-id").is_file()
        own.close()

    def test_a_worker_on_it_does_not_start(self, used: Path, tmp_path: Path) -> None:
        settings = settings_for(tmp_path / "local", database_url=sqlite_url(used / "wibam.db"))
        celery = [sys.executable, "-m", "celery", "--app", "worker.app", "worker", "--concurrency", "1"]
        environment = {**os.environ, **settings.to_environment(), "PYTHONPATH": str(ROOT)}
        ended = subprocess.run(celery, env=environment, capture_output=True, text=True, timeout=600, cwd=tmp_path)
        assert ended.returncode == 1
        assert "not the one in which this service's files are" in ended.stderr
