"""Networks as things of their own, and runs of them

Revision ID: 0012
Revises: 0011
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "trained_models",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("site_id", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("job_id", sa.String(length=64), nullable=True),
        sa.Column("stage_hash", sa.String(length=64), nullable=True),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("has_onnx", sa.Boolean(), nullable=False),
        sa.Column("has_usual", sa.Boolean(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("created_at", sa.Float(precision=53), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_trained_models")),
        sa.UniqueConstraint("site_id", "version", name=op.f("uq_trained_models_site_id_version")),
        sa.UniqueConstraint("job_id", "stage_hash", name=op.f("uq_trained_models_job_id_stage_hash")),
    )
    op.create_index(op.f("ix_trained_models_sha256"), "trained_models", ["sha256"])
    op.create_table(
        "site_tracks",
        sa.Column("job_id", sa.String(length=64), nullable=False),
        sa.Column("site_id", sa.String(length=64), nullable=False),
        sa.Column("stage_hash", sa.String(length=64), nullable=False),
        sa.Column("first_run_id", sa.String(length=64), nullable=False),
        sa.Column("model_id", sa.String(length=64), nullable=True),
        sa.Column("cameras", sa.JSON(), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("end_ns", sa.BigInteger(), nullable=False),
        sa.Column("states", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name=op.f("fk_site_tracks_job_id_jobs"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job_id", name=op.f("pk_site_tracks")),
    )
    op.create_index(op.f("ix_site_tracks_site_id"), "site_tracks", ["site_id"])
    for table in ("files", "uploads"):
        op.add_column(table, sa.Column("started_ns", sa.BigInteger(), nullable=True))
    op.add_column("jobs", sa.Column("kind", sa.String(length=16), nullable=False, server_default="training"))
    op.add_column("jobs", sa.Column("model_id", sa.String(length=64), nullable=True))
    op.add_column("jobs", sa.Column("continues", sa.String(length=64), nullable=True))


def downgrade() -> None:
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.drop_column("continues")
        batch_op.drop_column("model_id")
        batch_op.drop_column("kind")
    for table in ("uploads", "files"):
        with op.batch_alter_table(table, schema=None) as batch_op:
            batch_op.drop_column("started_ns")
    op.drop_index(op.f("ix_site_tracks_site_id"), table_name="site_tracks")
    op.drop_table("site_tracks")
    op.drop_index(op.f("ix_trained_models_sha256"), table_name="trained_models")
    op.drop_table("trained_models")
