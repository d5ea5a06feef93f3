"""Hand labels in the database: every version that somebody saved, with who and when."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session

from wibam_core.adapters import records
from wibam_core.adapters.database import Database
from wibam_core.adapters.models import LabelVersionRow, SiteRow
from wibam_core.documents.hand_labels import HandLabels
from wibam_core.errors import ChangedMeanwhile, NotFound


@dataclass(frozen=True)
class LabelSet:
    """Whose labels: of a site's footage, made under one name. Two people who label the same for comparison use two.

    Attributes:
        site_id: the site.
        footage: digest of its reference camera's recording, on whose clock the times are.
        name: of the set.
    """

    site_id: str
    footage: str
    name: str


@dataclass(frozen=True)
class LabelVersion:
    """Labels of one instant as they were saved; versions count from 1. ``saved_at`` is in Unix seconds."""

    version: int
    labels: HandLabels
    author: str
    saved_at: float


class LabelStore:
    """Nothing is overwritten: saving adds a version.

    Args:
        database: migrated.
        now: Unix seconds.
    """

    def __init__(self, database: Database, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._now = now

    def latest(self, of: LabelSet) -> list[LabelVersion]:
        """The newest version of every instant, in order of time."""
        newest = (
            select(LabelVersionRow.time_ns, func.max(LabelVersionRow.version).label("version"))
            .where(_mine(of))
            .group_by(LabelVersionRow.time_ns)
            .subquery()
        )
        same = (LabelVersionRow.time_ns == newest.c.time_ns) & (LabelVersionRow.version == newest.c.version)
        rows = select(LabelVersionRow).join(newest, same).where(_mine(of)).order_by(LabelVersionRow.time_ns)
        with self._database.reading() as session:
            return [_version(row) for row in session.scalars(rows)]

    def sets(self, site_id: str, footage: str) -> list[str]:
        """Names of the sets that hold something."""
        names = select(LabelVersionRow.label_set).where(
            LabelVersionRow.site_id == site_id, LabelVersionRow.footage == footage
        )
        with self._database.reading() as session:
            return sorted(session.scalars(names.distinct()))

    def versions(self, of: LabelSet, time_ns: int) -> list[LabelVersion]:
        """All versions of an instant, the oldest first."""
        rows = (
            select(LabelVersionRow)
            .where(_mine(of), LabelVersionRow.time_ns == time_ns)
            .order_by(LabelVersionRow.version)
        )
        with self._database.reading() as session:
            return [_version(row) for row in session.scalars(rows)]

    def newest(self, of: LabelSet, time_ns: int) -> LabelVersion | None:
        """The newest version of an instant, or None where nobody has labelled it."""
        with self._database.reading() as session:
            row = _newest(session, of, time_ns)
            return None if row is None else _version(row)

    def save(self, of: LabelSet, labels: HandLabels, author: str, based_on: int) -> LabelVersion:
        """Add a version. Saving again what is there already adds none: an answer may have got lost on its way.

        Args:
            of: whose labels.
            labels: all of the instant's.
            author: who made them.
            based_on: the version that they were made from; 0 where there was none.

        Raises:
            NotFound: the site is gone.
            ChangedMeanwhile: there is a newer version.
        """
        author = records.plain_text(author)
        with self._database.writing(exclusive=True) as session:
            if session.get(SiteRow, of.site_id) is None:
                raise NotFound(f"there is no site {of.site_id}", hint="It was deleted meanwhile.")
            row = _newest(session, of, labels.time_ns)
            if row is not None and row.author == author and HandLabels.model_validate_json(row.document) == labels:
                return _version(row)
            there = 0 if row is None else row.version
            if there != based_on:
                raise ChangedMeanwhile(
                    f"the instant was saved by {row.author if row is not None else 'nobody'} meanwhile, as version "
                    f"{there}; your labels were made from version {based_on}",
                    version=there,
                    author=row.author if row is not None else "",
                )
            added = LabelVersion(there + 1, labels, author, self._now())
            session.add(
                LabelVersionRow(
                    site_id=of.site_id,
                    footage=of.footage,
                    label_set=of.name,
                    time_ns=labels.time_ns,
                    version=added.version,
                    document=labels.model_dump_json(),
                    author=author,
                    saved_at=added.saved_at,
                )
            )
        return added


def _mine(of: LabelSet) -> ColumnElement[bool]:
    return (
        (LabelVersionRow.site_id == of.site_id)
        & (LabelVersionRow.footage == of.footage)
        & (LabelVersionRow.label_set == of.name)
    )


def _newest(session: Session, of: LabelSet, time_ns: int) -> LabelVersionRow | None:
    mine = select(LabelVersionRow).where(_mine(of), LabelVersionRow.time_ns == time_ns)
    return session.scalars(mine.order_by(LabelVersionRow.version.desc()).limit(1)).one_or_none()


def _version(row: LabelVersionRow) -> LabelVersion:
    return LabelVersion(row.version, HandLabels.model_validate_json(row.document), row.author, row.saved_at)
