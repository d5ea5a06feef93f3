"""An empty, migrated database for each test: SQLite always, PostgreSQL where one answers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.databases import migrated
from tests.postgres import postgres_database
from tests.unit.adapters.world import World
from wibam_core.adapters.database import Database
from wibam_core.adapters.models import Base


@pytest.fixture(scope="session")
def on_postgresql() -> Iterator[Database]:
    """A migrated database of our own, dropped at the end."""
    with postgres_database() as url:
        database = Database(url)
        database.migrate()
        yield database
        database.close()


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    if request.param == "postgresql":
        database = request.getfixturevalue("on_postgresql")
        with database.writing() as session:
            for table in reversed(Base.metadata.sorted_tables):
                session.execute(table.delete())
        yield database
        return
    database = migrated(tmp_path / "wibam.db")
    yield database
    database.close()


@pytest.fixture
def world(database: Database) -> World:
    return World(database)
