"""Which scope a request needs, and who made it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Final

from wibam_core.jobs.access import Scope

#: The API token, and a browser that has shown it: they may do everything.
TOKEN: Final = "token"
PAGE: Final = "page"
#: A browser with a link to one job, which it may read.
GUEST: Final = "guest"
SAFE = ("GET", "HEAD")
#: The header that names a request.
REQUEST_ID: Final = "X-Request-ID"
_ANY = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
#: The first line that fits decides; what fits none is the administrator's.
_RULES: tuple[tuple[tuple[str, ...], str, Scope], ...] = (
    (_ANY, r"/v1/(keys|audit)(/.*)?", Scope.ADMIN),
    (_ANY, r"/v1/uploads(/.*)?", Scope.UPLOAD),
    (_ANY, r"/v1/webhooks(/.*)?", Scope.RUN),  # their addresses may hold secrets
    (SAFE, r"/v1/.*|/metrics", Scope.READ),
    (_ANY, r"/v1/calibration/.*|/v1/(sites|jobs)/[^/]+/plan", Scope.READ),
    (_ANY, r"/v1/jobs/[^/]+/labels/evaluate", Scope.RUN),
    (_ANY, r"/v1/jobs/[^/]+/(labels|conflicts)/.*", Scope.UPLOAD),
    (_ANY, r"/v1/(sites|cameras)/[^/]+/jobs|/v1/models/[^/]+/runs(/.*)?", Scope.RUN),
    (_ANY, r"/v1/(sites|cameras)(/.*)?", Scope.UPLOAD),
    (_ANY, r"/v1/(jobs|models|runs)(/.*)?", Scope.RUN),
)
_COMPILED = tuple((methods, re.compile(pattern), scope) for methods, pattern, scope in _RULES)


def is_protected(method: str, path: str) -> bool:
    """Whether a request needs the token, or what stands in for it. What tus can do here is told to everybody."""
    return method != "OPTIONS" and (path.startswith("/v1/") or path == "/metrics")


def needed_scope(method: str, path: str) -> Scope:
    """What a request that `is_protected` takes."""
    for methods, pattern, scope in _COMPILED:
        if method in methods and pattern.fullmatch(path):
            return scope
    return Scope.ADMIN


@dataclass
class Visit:
    """What is known of a request.

    Attributes:
        request_id: names it in logs and problems.
        who: `TOKEN`, `PAGE`, `GUEST` or a key's id; empty while unknown.
        problem: the code of the problem that it was answered with; empty where there was none.
    """

    request_id: str
    who: str = ""
    problem: str = ""


#: Of the request that is being answered; None outside of one.
current_visit: ContextVar[Visit | None] = ContextVar("current_visit", default=None)
_STATE = "wibam.visit"


def begin_visit(scope: Any, visit: Visit) -> None:
    """Tie what is known to a request (an ASGI scope), and to all that is done for it."""
    scope[_STATE] = visit
    current_visit.set(visit)


def visit_of(scope: Mapping[str, Any]) -> Visit | None:
    """What is known of a request."""
    found: Visit | None = scope.get(_STATE)
    return found
