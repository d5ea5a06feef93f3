"""The database: SQLite in WAL mode by default, PostgreSQL by URL."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import sqlalchemy
from alembic import command
from alembic.config import Config
from pydantic_core import from_json
from sqlalchemy import Connection, Engine, event, make_url
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session

from wibam_core.errors import ServiceUnavailable

_BUSY_TIMEOUT_MS = 15_000
# arbitrary numbers of our own, for PostgreSQL's advisory locks
_MIGRATION_LOCK = 0x5749_4241
_EXCLUSIVE_LOCK = 0x5749_4242
_ADVISORY_LOCK = sqlalchemy.text("SELECT pg_advisory_xact_lock(:key)")
_WRITE = "wibam_write"


class Database:
    """Connections to one database, and its two kinds of transaction.

    Args:
        url: an SQLAlchemy URL, ``sqlite:////absolute/path.db`` or ``postgresql+psycopg://...``.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.engine = _create_engine(url)

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """A transaction that sees one state of the database."""
        with Session(self.engine, expire_on_commit=False) as session, session.begin():
            yield session

    @contextmanager
    def writing(self, *, exclusive: bool = False) -> Iterator[Session]:
        """A transaction that may write. On SQLite it holds the write lock from its beginning, so it never deadlocks.

        Args:
            exclusive: no two such transactions overlap: for those that decide by what others have stored.
        """
        engine = self.engine.execution_options(**{_WRITE: True})
        with Session(engine, expire_on_commit=False) as session, session.begin():
            if exclusive and engine.dialect.name == "postgresql":
                session.execute(_ADVISORY_LOCK, {"key": _EXCLUSIVE_LOCK})
            yield session

    def migrate(self) -> None:
        """Bring the schema up to date. Processes that start together wait for each other.

        Raises:
            ServiceUnavailable: the database does not answer.
        """
        try:
            with _migration_lock(self.engine), self.engine.connect() as connection:
                config = Config()
                config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
                config.attributes["connection"] = connection
                command.upgrade(config, "head")
        except OperationalError as error:
            raise ServiceUnavailable(
                f"the database does not answer: {error.orig}", hint="Check WIBAM_DATABASE_URL, and that it runs."
            ) from error

    def ping(self) -> None:
        """Raises:
        ServiceUnavailable: the database does not answer.
        """
        try:
            with self.engine.connect() as connection:
                connection.execute(sqlalchemy.text("SELECT 1"))
        except OperationalError as error:
            raise ServiceUnavailable("the database does not answer", hint="Is it running?") from error

    def close(self) -> None:
        self.engine.dispose()


def sqlite_url(path: Path) -> str:
    """The URL of an SQLite file."""
    return f"sqlite:///{path.absolute()}"


def _create_engine(url: str) -> Engine:
    if make_url(url).get_backend_name() != "sqlite":
        return sqlalchemy.create_engine(
            url, json_deserializer=from_json, pool_pre_ping=True, pool_size=10, max_overflow=20
        )
    engine = sqlalchemy.create_engine(
        url, json_deserializer=from_json, connect_args={"timeout": _BUSY_TIMEOUT_MS / 1000}
    )
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # transactions are begun by `_begin_sqlite`, not by the driver
    cursor = connection.cursor()
    for pragma in (
        "journal_mode = WAL",
        "synchronous = NORMAL",
        "foreign_keys = ON",
        f"busy_timeout = {_BUSY_TIMEOUT_MS}",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    writes = connection.get_execution_options().get(_WRITE, False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


@contextmanager
def _migration_lock(engine: Engine) -> Iterator[None]:
    if engine.dialect.name == "sqlite":
        path = Path(str(engine.url.database) + ".migrate.lock")
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with path.open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        return
    with engine.connect() as connection:
        connection.execute(sqlalchemy.text("SELECT pg_advisory_lock(:key)"), {"key": _MIGRATION_LOCK})
        try:
            yield
        finally:
            connection.execute(sqlalchemy.text("SELECT pg_advisory_unlock(:key)"), {"key": _MIGRATION_LOCK})
