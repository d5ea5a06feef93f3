"""API keys in the database, by the digests of their secrets."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Collection

from sqlalchemy import select, update

from wibam_core.adapters import records
from wibam_core.adapters.database import Database
from wibam_core.adapters.models import ApiKeyRow
from wibam_core.adapters.paging import EVER, Place, Span, newest_first
from wibam_core.adapters.settings import token_digest
from wibam_core.errors import InputError, NotFound
from wibam_core.jobs.access import ApiKey, Scope

_SECONDS_BETWEEN_NOTES = 60.0
#: Every key begins so: a leaked one can be found in texts.
PREFIX = "wibam_"


class KeyStore:
    """Makes, finds and revokes keys.

    Args:
        database: migrated.
        now: Unix seconds.
    """

    def __init__(self, database: Database, now: Callable[[], float] = time.time) -> None:
        self._database = database
        self._now = now

    def create(self, name: str, scopes: Collection[Scope], lifetime_s: float | None = None) -> tuple[ApiKey, str]:
        """A new key, and its secret, which is told this once.

        Raises:
            InputError: it has no scope.
        """
        if not scopes:
            raise InputError("a key needs at least one scope", hint=f"Scopes are {', '.join(Scope)}.")
        secret = PREFIX + secrets.token_urlsafe(32)
        now = self._now()
        row = ApiKeyRow(
            id=records.new_id("key"),
            name=records.plain_text(name),
            scopes=sorted(scope.value for scope in set(scopes)),
            digest=token_digest(secret),
            created_at=now,
            expires_at=None if lifetime_s is None else now + lifetime_s,
        )
        with self._database.writing() as session:
            session.add(row)
            session.flush()
            return _key(row), secret

    def keys(self, limit: int | None = None, *, made: Span = EVER, after: Place | None = None) -> list[ApiKey]:
        """Keys, the newest first; those too that no longer work.

        Args:
            limit: how many at most; None: all.
            made: when they were made.
            after: only those that follow this place in the list.
        """
        wanted = newest_first(select(ApiKeyRow).where(*made.holds(ApiKeyRow.created_at)), ApiKeyRow, limit, after)
        with self._database.reading() as session:
            return [_key(row) for row in session.scalars(wanted)]

    def find(self, secret: str) -> ApiKey | None:
        """The key with this secret if it works, and note that it is used."""
        if not secret.startswith(PREFIX):
            return None
        now = self._now()
        with self._database.reading() as session:
            row = session.scalar(select(ApiKeyRow).where(ApiKeyRow.digest == token_digest(secret)))
        if row is None or not (key := _key(row)).works(now):
            return None
        if key.last_used_at is None or key.last_used_at < now - _SECONDS_BETWEEN_NOTES:
            with self._database.writing() as session:
                session.execute(update(ApiKeyRow).where(ApiKeyRow.id == key.id).values(last_used_at=now))
        return key

    def revoke(self, key_id: str) -> ApiKey:
        """Let a key work no more, from now on. Revoking it again changes nothing.

        Raises:
            NotFound: there is no such key.
        """
        with self._database.writing() as session:
            row = session.get(ApiKeyRow, key_id, with_for_update=True)
            if row is None:
                raise NotFound(f"there is no key {key_id}", hint="List the keys to see their ids.")
            if row.revoked_at is None:
                row.revoked_at = self._now()
            session.flush()
            return _key(row)


def _key(row: ApiKeyRow) -> ApiKey:
    scopes = frozenset(Scope(scope) for scope in row.scopes)
    return ApiKey(row.id, row.name, scopes, row.created_at, row.expires_at, row.last_used_at, row.revoked_at)
