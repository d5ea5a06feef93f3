"""An empty, migrated database for each test: SQLite always, PostgreSQL where one answers."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy

from tests.unit.adapters.world import World
from wibam_core.adapters.database import Database, sqlite_url
from wibam_core.adapters.models import Base

_POSTGRES = os.environ.get("WIBAM_TEST_POSTGRES_URL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")


@pytest.fixture(scope="session")
def postgres_database() -> Iterator[Database]:
    """A PostgreSQL database of our own, dropped at the end."""
    admin = sqlalchemy.create_engine(_POSTGRES, isolation_level="AUTOCOMMIT", connect_args={"connect_timeout": 2})
    name = f"wibam_test_{secrets.token_hex(4)}"
    try:
        with admin.connect() as connection:
            connection.execute(sqlalchemy.text(f"CREATE DATABASE {name}"))
    except sqlalchemy.exc.OperationalError:
        pytest.skip("no PostgreSQL answers at WIBAM_TEST_POSTGRES_URL")
    except sqlalchemy.exc.ProgrammingError as error:
        pytest.skip(f"the role of WIBAM_TEST_POSTGRES_URL may make no database: {error.orig}")
    url = sqlalchemy.make_url(_POSTGRES).set(database=name).render_as_string(hide_password=False)
    database = Database(url)
    database.migrate()
    yield database
    database.close()
    with admin.connect() as connection:
        connection.execute(sqlalchemy.text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    if request.param == "postgresql":
        database = request.getfixturevalue("postgres_database")
        with database.writing() as session:
            for table in reversed(Base.metadata.sorted_tables):
                session.execute(table.delete())
        yield database
        return
    database = Database(sqlite_url(tmp_path / "wibam.db"))
    database.migrate()
    yield database
    database.close()


@pytest.fixture
def world(database: Database) -> World:
    return World(database)
