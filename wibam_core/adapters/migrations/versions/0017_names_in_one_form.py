"""Names of files with accents in Unicode's composed form (NFC), as sites list them

Revision ID: 0017
Revises: 0016
"""

from __future__ import annotations

import unicodedata

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

_LONGEST = 255
_FILES = sa.table(
    "files",
    *(sa.column(name, sa.String) for name in ("id", "site_id", "purpose", "camera_id", "filename")),
    *(sa.column(name, sa.Float) for name in ("created_at", "retired_at")),
)
_UPLOADS = sa.table("uploads", sa.column("id", sa.String), sa.column("filename", sa.String))


def upgrade() -> None:
    _retire_replaced()
    for table in (_FILES, _UPLOADS):
        for id_, name in op.get_bind().execute(sa.select(table.c.id, table.c.filename)).all():
            if _composed(name) != name:
                op.execute(sa.update(table).where(table.c.id == id_).values(filename=_composed(name)))


def downgrade() -> None:
    """The names stay: those that sites list have this form, too."""


def _retire_replaced() -> None:
    """Of current files whose names become the same, the newest takes the others' place, as an upload of that name."""
    columns = _FILES.c
    current = sa.select(_FILES).where(columns.retired_at.is_(None)).order_by(columns.created_at.desc(), columns.id)
    newest_at: dict[tuple[str, ...], float] = {}
    for row in op.get_bind().execute(current).all():
        place = (row.site_id, row.purpose, row.camera_id, _composed(row.filename))
        if place in newest_at:
            op.execute(sa.update(_FILES).where(columns.id == row.id).values(retired_at=newest_at[place]))
        else:
            newest_at[place] = row.created_at


def _composed(name: str) -> str:
    return unicodedata.normalize("NFC", name)[:_LONGEST]
