"""Which database and which data folder belong together.

Only its own database may decide which of a folder's files nobody needs any more. And all processes of a service must
see one folder: a worker on another disk would fail users' jobs, since nothing that it is asked for is there.
"""

from __future__ import annotations

from sqlalchemy import select

from wibam_core.adapters.database import Database
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.models import DatabaseIdRow
from wibam_core.adapters.records import new_id
from wibam_core.adapters.site_store import SiteStore
from wibam_core.errors import Conflict


def claim_folder(database: Database, folder: DataFolder) -> None:
    """Tie a database and a data folder to each other, once; later, make sure that the two belong together.

    A folder that is not tied yet is taken if it holds no files, or one that the database knows; a database that is not
    tied yet takes it if it knows no files, or one that the folder holds.

    Raises:
        Conflict: the folder belongs to another database, or the database to another folder.
    """
    known = SiteStore(database).known_file_ids()
    there = folder.holds_bytes()
    with database.writing(exclusive=True) as session:  # services that start together do the same
        row = session.scalar(select(DatabaseIdRow))
        if row is None:
            row = DatabaseIdRow(id=new_id("database"))
            session.add(row)
        _check_database(folder, row.id, shares_files=bool(there & known), is_empty=not there)
        if row.folder_id is None:
            if known and not there & known:
                raise _other_folder(folder, None)
            row.folder_id = folder.folder_id() or new_id("folder")
            folder.be(row.folder_id)
        elif folder.folder_id() != row.folder_id:
            raise _other_folder(folder, row.folder_id)


def _check_database(folder: DataFolder, mine: str, *, shares_files: bool, is_empty: bool) -> None:
    theirs = folder.database_id()
    if theirs is None and (is_empty or shares_files):
        folder.belong_to(mine)
    elif theirs != mine:
        whose = "belongs to another database" if theirs is not None else "holds files that this database does not know"
        raise Conflict(
            f"the data folder {folder.root} {whose}",
            hint="Set WIBAM_DATABASE_URL to the database that it was used with, or choose another WIBAM_DATA_DIR.",
        )


def _other_folder(folder: DataFolder, folder_id: str | None) -> Conflict:
    instead = f" If that folder is lost and this one takes its place, write {folder_id} into {folder.root}/folder-id."
    return Conflict(
        f"the data folder {folder.root} is not the one in which this service's files are",
        hint="API and workers must see one folder, on whichever machines they run: mount the same one everywhere."
        + (instead if folder_id is not None else ""),
    )
