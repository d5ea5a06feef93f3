"""A PostgreSQL database of a test's own, where a server answers."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import pytest
import sqlalchemy

_SERVER = os.environ.get("WIBAM_TEST_POSTGRES_URL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")


@cache
def _unanswered() -> bool:
    """Asked once for all tests: where packets are dropped, an answer is awaited for long."""
    probe = sqlalchemy.create_engine(_SERVER, connect_args={"connect_timeout": 120})
    try:
        probe.connect().close()
    except sqlalchemy.exc.OperationalError:
        return True
    finally:
        probe.dispose()
    return False


@contextmanager
def postgres_database() -> Iterator[str]:
    """The URL of an empty database, which is dropped at the end; the test is skipped where no server answers."""
    if _unanswered():
        pytest.skip("no PostgreSQL answers at WIBAM_TEST_POSTGRES_URL")
    admin = sqlalchemy.create_engine(_SERVER, isolation_level="AUTOCOMMIT", connect_args={"connect_timeout": 120})
    name = f"wibam_test_{secrets.token_hex(4)}"
    try:
        with admin.connect() as connection:
            connection.execute(sqlalchemy.text(f"CREATE DATABASE {name}"))
    except sqlalchemy.exc.ProgrammingError as error:
        pytest.skip(f"the role of WIBAM_TEST_POSTGRES_URL may make no database: {error.orig}")
    try:
        yield sqlalchemy.make_url(_SERVER).set(database=name).render_as_string(hide_password=False)
    finally:
        with admin.connect() as connection:
            connection.execute(sqlalchemy.text(f"DROP DATABASE {name} WITH (FORCE)"))
        admin.dispose()
