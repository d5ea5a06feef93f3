"""Hand labels

Revision ID: 0008
Revises: 0007
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "label_versions",
        sa.Column("site_id", sa.String(length=64), nullable=False),
        sa.Column("footage", sa.String(length=64), nullable=False),
        sa.Column("label_set", sa.String(length=64), nullable=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("author", sa.String(length=100), nullable=False),
        sa.Column("saved_at", sa.Float(precision=53), nullable=False),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_label_versions_site_id_sites"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint(
            "site_id", "footage", "label_set", "time_ns", "version", name=op.f("pk_label_versions")
        ),
    )


def downgrade() -> None:
    op.drop_table("label_versions")
