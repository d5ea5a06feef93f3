"""Which database a data folder belongs to: only that one may decide which of its files nobody needs any more."""

from __future__ import annotations

from sqlalchemy import select

from wibam_core.adapters.database import Database
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.models import DatabaseIdRow
from wibam_core.adapters.records import new_id
from wibam_core.adapters.site_store import SiteStore
from wibam_core.errors import Conflict


def claim_folder(database: Database, folder: DataFolder) -> None:
    """Tie a data folder to its database, once; later, make sure that the two belong together.

    A folder that is not tied yet is taken if it holds no files, or one that the database knows.

    Raises:
        Conflict: the folder belongs to another database.
    """
    mine = _database_id(database)
    theirs = folder.database_id()
    if theirs is None:
        there = folder.holds_bytes()
        if not there or there & SiteStore(database).known_file_ids():
            folder.belong_to(mine)
            return
    if theirs != mine:
        whose = "belongs to another database" if theirs is not None else "holds files that this database does not know"
        raise Conflict(
            f"the data folder {folder.root} {whose}",
            hint="Set WIBAM_DATABASE_URL to the database that it was used with, or choose another WIBAM_DATA_DIR.",
        )


def _database_id(database: Database) -> str:
    """The database's own id, made on first use."""
    with database.writing(exclusive=True) as session:
        found = session.scalar(select(DatabaseIdRow.id))
        if found is None:
            found = new_id("database")
            session.add(DatabaseIdRow(id=found))
        return found
