"""How a browser is let in: signed passes of limited time, kept in cookies that no script can read."""

from __future__ import annotations

import hashlib
import hmac
import time
from collections.abc import Callable, Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Final

from wibam_core.errors import Unauthorised

#: The cookie of a browser that has shown the token.
SESSION_COOKIE: Final = "wibam_session"
#: What pages send with everything that changes something. A page of another site cannot: a browser asks us first
#: whether it may send such a header, and we never say that it may.
PAGE_HEADER: Final = "X-Wibam-Page"
SESSION_LIFETIME_S: Final = 7 * 24 * 3600.0
_SESSION = "session"


class Passes:
    """Makes and checks passes: ``<expiry>.<signature>`` for a subject. They end with the token that they rest on.

    Args:
        secret: known to the service alone.
        now: Unix seconds.
    """

    def __init__(self, secret: str, now: Callable[[], float] = time.time) -> None:
        self._key = hashlib.sha256(b"wibam passes:" + secret.encode()).digest()
        self._now = now

    def session(self) -> str:
        """A pass to everything."""
        return self._issue(_SESSION, SESSION_LIFETIME_S)

    def share(self, job_id: str, lifetime_s: float) -> str:
        """A pass to read one job and its results."""
        return self._issue(f"job:{job_id}", lifetime_s)

    def is_session(self, cookies: Mapping[str, str]) -> bool:
        """Whether a browser with these cookies has shown the token."""
        return self._holds(_SESSION, cookies.get(SESSION_COOKIE, ""))

    def may_read(self, job_id: str, cookies: Mapping[str, str]) -> bool:
        """Whether a browser with these cookies was given a link to the job that still works."""
        return self.is_share(job_id, cookies.get(share_cookie(job_id), ""))

    def is_share(self, job_id: str, value: str) -> bool:
        """Whether this is a pass of `share` that still works."""
        return self._holds(f"job:{job_id}", value)

    def remaining_s(self, value: str) -> float:
        """How long a pass still works."""
        return _expiry(value) - self._now()

    def _issue(self, subject: str, lifetime_s: float) -> str:
        expires = int(self._now() + lifetime_s)
        return f"{expires}.{self._signature(subject, expires)}"

    def _holds(self, subject: str, value: str) -> bool:
        expires = _expiry(value)
        expected = f"{expires}.{self._signature(subject, expires)}"
        return hmac.compare_digest(expected.encode(), value.encode()) and expires >= self._now()

    def _signature(self, subject: str, expires: int) -> str:
        return hmac.new(self._key, f"{subject}:{expires}".encode(), hashlib.sha256).hexdigest()


class ReportLinks:
    """Short-lived links by which a browser, which cannot send a token, opens one job's report.

    Args:
        secret: known to the service alone.
        lifetime_s: how long a link works.
        now: Unix seconds.
    """

    def __init__(self, secret: str, lifetime_s: float = 600.0, now: Callable[[], float] = time.time) -> None:
        self._key = hashlib.sha256(b"wibam report links:" + secret.encode()).digest()
        self._lifetime_s = lifetime_s
        self._now = now

    def sign(self, job_id: str) -> tuple[int, str]:
        """When the link expires (Unix seconds), and its signature."""
        expires = int(self._now() + self._lifetime_s)
        return expires, self._signature(job_id, expires)

    def verify(self, job_id: str, expires: int, signature: str) -> None:
        """Raises:
        Unauthorised: the link is too old, or was not made by us.
        """
        expected = self._signature(job_id, expires)
        if not hmac.compare_digest(expected.encode(), signature.encode()) or expires < self._now():
            raise Unauthorised("this link has expired", hint="Ask for a new one: GET /v1/jobs/{id}/report-link.")

    def _signature(self, job_id: str, expires: int) -> str:
        return hmac.new(self._key, f"{job_id}:{expires}".encode(), hashlib.sha256).hexdigest()


def share_cookie(job_id: str) -> str:
    """The cookie of a browser that was given a link to a job."""
    return f"wibam_share_{job_id}"


def parse_cookies(header: str) -> dict[str, str]:
    """The ``Cookie`` header; nothing where it is malformed."""
    try:
        return {name: morsel.value for name, morsel in SimpleCookie(header).items()}
    except CookieError:
        return {}


def _expiry(value: str) -> int:
    head = value.partition(".")[0]
    return int(head) if head.isascii() and head.isdecimal() and len(head) < 16 else 0
