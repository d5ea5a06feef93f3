"""Addresses of this service as its clients see them, behind a proxy too."""

from __future__ import annotations

import re

from fastapi import Request

_PREFIX = re.compile(r"(/[A-Za-z0-9._~-]+)+/?")


def address(request: Request, path: str) -> str:
    """A path of this service, with the prefix under which a proxy shows it.

    The proxy says it by ``X-Forwarded-Prefix``, or the server was started with a root path. There is never a host in
    it: whatever a client claims leads to where it came from.
    """
    forwarded = request.headers.get("x-forwarded-prefix", "").split(",")[0].strip()
    prefix = forwarded if _PREFIX.fullmatch(forwarded) else str(request.scope.get("root_path", ""))
    return prefix.rstrip("/") + path
