"""Who may do what: scopes, and the keys that carry them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Scope(StrEnum):
    """What a key lets its bearer do. ``ADMIN`` includes all others; of the others none includes another."""

    READ = "read"
    UPLOAD = "upload"
    RUN = "run"
    ADMIN = "admin"

    @property
    def meaning(self) -> str:
        """In a few words."""
        return _MEANINGS[self]


_MEANINGS = {
    Scope.READ: "look at sites, jobs and results",
    Scope.UPLOAD: "describe sites, send files, labels and reviews",
    Scope.RUN: "start, stop, share and delete jobs, runs, clips and models",
    Scope.ADMIN: "everything, keys too",
}


@dataclass(frozen=True)
class ApiKey:
    """A key, without its secret: the service keeps the secret's digest alone. Times are Unix seconds.

    Attributes:
        name: whose, or what for.
        expires_at: when it ends to work; None: never.
        last_used_at: to the minute; None: not yet.
        revoked_at: when it was taken back.
    """

    id: str
    name: str
    scopes: frozenset[Scope]
    created_at: float
    expires_at: float | None = None
    last_used_at: float | None = None
    revoked_at: float | None = None

    def works(self, now: float) -> bool:
        """Whether it opens anything."""
        return self.revoked_at is None and (self.expires_at is None or now < self.expires_at)

    def may(self, scope: Scope) -> bool:
        """Whether it has a scope, by itself or as an administrator's."""
        return scope in self.scopes or Scope.ADMIN in self.scopes


@dataclass(frozen=True)
class AuditLine:
    """One change that somebody made, or tried to.

    Attributes:
        who: "token", "page" for a signed-in browser, or a key's id.
        what: method and path.
        status: HTTP status of the answer.
        request_id: as in the service's log.
        address: of the peer, where it is known.
    """

    id: int
    at: float
    who: str
    what: str
    status: int
    request_id: str
    address: str
