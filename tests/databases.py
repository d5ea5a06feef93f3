"""SQLite databases with all tables, each a test's own."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

from wibam_core.adapters.database import Database, sqlite_url


def migrated(path: Path) -> Database:
    """An empty database in a new file, as the migrations make it."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    path.write_bytes(_empty())
    return Database(sqlite_url(path))


@functools.cache
def _empty() -> bytes:
    """What the migrations make, once for all tests: they take far longer than a copy."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "empty.db"
        database = Database(sqlite_url(path))
        database.migrate()
        database.close()
        return path.read_bytes()
