"""Which data folder is the service's

Revision ID: 0009
Revises: 0008
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("database_id", schema=None) as batch_op:
        batch_op.add_column(sa.Column("folder_id", sa.String(length=64), nullable=True))


def downgrade() -> None:
    with op.batch_alter_table("database_id", schema=None) as batch_op:
        batch_op.drop_column("folder_id")
