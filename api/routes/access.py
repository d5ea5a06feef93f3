"""Keys, and who changed what. For administrators."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field

from api.bodies import BoundedJsonRoute
from api.paging import MadeDep, PageDep
from api.parameters import ONLY_KNOWN_PARAMETERS
from api.problems import documented
from api.services import ServicesDep
from wibam_core.jobs.access import ApiKey, AuditLine, Scope

router = APIRouter(prefix="/v1", tags=["access"], responses=documented(401), route_class=BoundedJsonRoute)
_MEANINGS = "; ".join(f"`{scope}`: {scope.meaning}" for scope in Scope)


class KeyIn(BaseModel):
    """A key to make."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(
        max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$", description="whose, or what for", examples=["camera van"]
    )
    scopes: list[Scope] = Field(min_length=1, max_length=10, description=_MEANINGS, examples=[["read", "upload"]])
    lifetime_days: float | None = Field(None, gt=0, le=3660, description="how long it works; left out: until revoked")


class KeyOut(BaseModel):
    """A key. Its secret is not kept."""

    id: str = Field(examples=["key_3f0c9a1be2d44c70"])
    name: str
    scopes: list[Scope]
    created_at: datetime
    expires_at: datetime | None
    last_used_at: datetime | None = Field(description="to the minute")
    revoked_at: datetime | None
    works: bool = Field(description="neither expired nor revoked")

    @classmethod
    def of(cls, key: ApiKey) -> KeyOut:
        return cls(
            id=key.id,
            name=key.name,
            scopes=sorted(key.scopes, key=list(Scope).index),
            created_at=datetime.fromtimestamp(key.created_at, UTC),
            expires_at=_time(key.expires_at),
            last_used_at=_time(key.last_used_at),
            revoked_at=_time(key.revoked_at),
            works=key.works(time.time()),
        )


class NewKeyOut(KeyOut):
    """A key that was just made."""

    secret: str = Field(description="to be sent as `Authorization: Bearer SECRET`; it is told this once")


class AuditLineOut(BaseModel):
    """A change that somebody made, or tried to."""

    id: int
    at: datetime
    who: str = Field(description="`token`, `page` (a signed-in browser) or the id of a key")
    what: str = Field(examples=["POST /v1/sites/site_3f0c9a1be2d44c70/jobs"])
    status: int = Field(description="of the answer", examples=[201])
    request_id: str = Field(description="as in the answer's `X-Request-ID` and in the service's log")
    address: str = Field(description="where the request came from; behind a proxy, the proxy's")

    @classmethod
    def of(cls, line: AuditLine) -> AuditLineOut:
        return cls(**{**line.__dict__, "at": datetime.fromtimestamp(line.at, UTC)})


@router.post("/keys", status_code=201, summary="Make a key", responses=documented(413, 422))
def create_key(body: KeyIn, services: ServicesDep) -> NewKeyOut:
    """For a person or program that is not to have the token of the service."""
    lifetime_s = None if body.lifetime_days is None else body.lifetime_days * 24 * 3600.0
    key, secret = services.keys.create(body.name, body.scopes, lifetime_s)
    return NewKeyOut(**KeyOut.of(key).model_dump(), secret=secret)


@router.get("/keys", summary="List keys", dependencies=[ONLY_KNOWN_PARAMETERS], responses=documented(422))
def list_keys(services: ServicesDep, page: PageDep, made: MadeDep) -> list[KeyOut]:
    """The newest first, with those that no longer work."""
    found = services.keys.keys(page.one_more, made=made, after=page.place)
    return [KeyOut.of(key) for key in page.cut(found, lambda key: (key.created_at, key.id))]


@router.delete("/keys/{key_id}", summary="Revoke a key", responses=documented(404))
def revoke_key(key_id: str, services: ServicesDep) -> KeyOut:
    """It opens nothing from now on. It stays in the list, since lines of the audit name it."""
    return KeyOut.of(services.keys.revoke(key_id))


@router.get("/audit", summary="Who changed what", dependencies=[ONLY_KNOWN_PARAMETERS], responses=documented(422))
def audit(
    services: ServicesDep,
    page: PageDep,
    made: MadeDep,
    who: Annotated[str | None, Query(max_length=80, description="`token`, `page` or the id of a key")] = None,
) -> list[AuditLineOut]:
    """A line for every change through the API, the newest first, kept for a year.

    Pieces of uploads are not told one by one.
    """
    last = page.after(int)
    found = services.audit.lines(before=None if last is None else int(last[0]), who=who, limit=page.one_more, made=made)
    return [AuditLineOut.of(line) for line in page.cut(found, lambda line: (line.id,))]


def _time(seconds: float | None) -> datetime | None:
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC)
