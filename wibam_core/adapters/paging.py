"""Pages of lists in the database: each begins after a place in the order, and is as fast however far down it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, or_
from sqlalchemy.orm import InstrumentedAttribute


@dataclass(frozen=True)
class Place:
    """Where an item is in a list that begins with the newest: when it was made (Unix seconds), and its id.

    It stays meaningful when the item itself is deleted.
    """

    created_at: float
    id: str


@dataclass(frozen=True)
class Span:
    """When items were made, in Unix seconds: from ``start`` on, before ``end``; None: no limit."""

    start: float | None = None
    end: float | None = None

    def holds(self, column: InstrumentedAttribute[float]) -> list[ColumnElement[bool]]:
        """Conditions on a column of times."""
        found: list[ColumnElement[bool]] = []
        if self.start is not None:
            found.append(column >= self.start)
        if self.end is not None:
            found.append(column < self.end)
        return found


#: No limit.
EVER = Span()


def newest_first(statement: Select[Any], row: Any, limit: int | None, after: Place | None) -> Select[Any]:
    """A page of what a statement selects, the newest first, those of one time by their ids.

    Args:
        statement: selects rows of ``row``.
        row: a table with the columns ``created_at`` and ``id``.
        limit: how many at most; None: all.
        after: only those that follow this place.
    """
    found = statement.order_by(row.created_at.desc(), row.id).limit(limit)
    if after is not None:
        older = row.created_at < after.created_at
        found = found.where(or_(older, and_(row.created_at == after.created_at, row.id > after.id)))
    return found
