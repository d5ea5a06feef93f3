"""Recordings of several files

Revision ID: 0007
Revises: 0006
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

_CURRENT = sa.text("retired_at IS NULL")


def _index(columns: list[str]) -> None:
    with op.batch_alter_table("files", schema=None) as batch_op:
        batch_op.drop_index("uq_files_current", sqlite_where=_CURRENT, postgresql_where=_CURRENT)
        batch_op.create_index(
            "uq_files_current", columns, unique=True, sqlite_where=_CURRENT, postgresql_where=_CURRENT
        )


def upgrade() -> None:
    _index(["site_id", "purpose", "camera_id", "filename"])


def downgrade() -> None:
    op.execute(
        "UPDATE files SET retired_at = created_at WHERE retired_at IS NULL AND id NOT IN (SELECT MIN(id) FROM files "
        "WHERE retired_at IS NULL GROUP BY site_id, purpose, camera_id)"
    )
    _index(["site_id", "purpose", "camera_id"])
