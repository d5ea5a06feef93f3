"""Who changed what, and when: one line a change, kept for a year."""

from __future__ import annotations

import time
from collections.abc import Callable

from sqlalchemy import delete, select

from wibam_core.adapters.database import Database
from wibam_core.adapters.models import AuditRow
from wibam_core.adapters.paging import EVER, Span
from wibam_core.adapters.records import plain_text
from wibam_core.jobs.access import AuditLine

_KEPT_S = 366 * 24 * 3600.0


class AuditStore:
    """Writes and reads the lines.

    Args:
        database: migrated.
        now: Unix seconds.
    """

    def __init__(self, database: Database, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._now = now

    def write(self, who: str, what: str, status: int, request_id: str, address: str = "") -> None:
        """Add a line; see `AuditLine`."""
        with self._database.writing() as session:
            session.add(
                AuditRow(
                    at=self._now(),
                    who=plain_text(who)[:80],
                    what=plain_text(what)[:500],
                    status=status,
                    request_id=request_id,
                    address=plain_text(address)[:80],
                )
            )

    def lines(
        self, *, before: int | None = None, who: str | None = None, limit: int = 100, made: Span = EVER
    ) -> list[AuditLine]:
        """Lines, the newest first.

        Args:
            before: only lines with smaller ids.
            who: of this one alone.
            limit: how many at most.
            made: when.
        """
        wanted = select(AuditRow).where(*made.holds(AuditRow.at)).order_by(AuditRow.id.desc()).limit(limit)
        if before is not None:
            wanted = wanted.where(AuditRow.id < before)
        if who is not None:
            wanted = wanted.where(AuditRow.who == who)
        with self._database.reading() as session:
            return [
                AuditLine(row.id, row.at, row.who, row.what, row.status, row.request_id, row.address)
                for row in session.scalars(wanted)
            ]

    def tidy(self) -> None:
        """Drop lines older than a year."""
        with self._database.writing() as session:
            session.execute(delete(AuditRow).where(AuditRow.at < self._now() - _KEPT_S))
