"""Requests to one service: its problems come back as the errors that they were, and downloads whole or not at all."""

from __future__ import annotations

import base64
import hashlib
import ipaddress
import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

import httpx

from wibam_core.errors import ChecksumMismatch, ServiceUnavailable, WibamError

_PAGE = 200


class Connection:
    """Sends requests with the token.

    Args:
        url: of the service. No proxy is asked for a service on this machine.
        token: the API token.
        timeout_s: for one request without news.
    """

    def __init__(self, url: str, token: str, timeout_s: float) -> None:
        self._http = httpx.Client(
            base_url=url,
            headers={"Authorization": f"Bearer {token}"},
            timeout=timeout_s,
            follow_redirects=False,
            trust_env=not is_this_machine(httpx.URL(url).host),
        )

    def close(self) -> None:
        self._http.close()

    def address(self, path: str) -> str:
        """The whole address of a path that the service named."""
        return str(self._http.base_url.join(path))

    def request(self, method: str, path: str, **values: Any) -> httpx.Response:
        """One request; ``values`` as httpx takes them.

        Raises:
            ServiceUnavailable: there was no answer.
            WibamError: what the service says is wrong.
        """
        try:
            response = self._http.request(method, path, **values)
        except httpx.TransportError as error:
            reason = str(error) or type(error).__name__
            raise ServiceUnavailable(f"no answer from {self._http.base_url}: {reason}") from error
        _raise_for_problem(response)
        return response

    def json(self, method: str, path: str, **values: Any) -> Any:
        """As `request`; the JSON that is in the answer."""
        if "content" in values:
            values["headers"] = {**values.get("headers", {}), "Content-Type": "application/json"}
        return self.request(method, path, **values).json()

    def items(self, path: str, params: Mapping[str, Any] | None = None, most: int | None = None) -> list[Any]:
        """All items of a list, page by page.

        Args:
            path: of the list.
            params: of the query; what is None is left out.
            most: stop after so many; None: never.
        """
        given = {name: value for name, value in (params or {}).items() if value is not None}
        values = {"limit": min(most or _PAGE, _PAGE), **given}
        response = self.request("GET", path, params=values)
        found = list(response.json())
        while (most is None or len(found) < most) and (following := response.links.get("next")):
            # the address as the service sees itself may be another than ours: its query alone counts
            response = self.request("GET", path, params=httpx.URL(following["url"]).params)
            found += response.json()
        return found[:most]

    def download(
        self, path: str, target: Path, params: Mapping[str, Any] | None = None, timeout_s: float | None = None
    ) -> Path:
        """Fetch into a file, which appears only once it is whole and, where the service says its digest, right.

        Args:
            path: of the resource.
            target: the file, or a folder in which it gets the name that the service gives it.
            params: of the query.
            timeout_s: without news; None as for other requests.
        """
        partial = target / ".wibam.part" if target.is_dir() else target.with_name(target.name + ".part")
        digest = hashlib.sha256()
        timeout = httpx.USE_CLIENT_DEFAULT if timeout_s is None else timeout_s
        try:
            with self._http.stream("GET", path, params=dict(params or {}), timeout=timeout) as response:
                if response.is_error:
                    response.read()
                _raise_for_problem(response)
                if target.is_dir():
                    target = target / _filename(response)
                with partial.open("wb") as file:
                    for block in response.iter_bytes():
                        file.write(block)
                        digest.update(block)
        except httpx.TransportError as error:
            partial.unlink(missing_ok=True)
            raise ServiceUnavailable(f"the download of {path} broke off: {error}") from error
        announced = re.fullmatch(r"sha-256=:(.+):", response.headers.get("Repr-Digest", ""))
        if announced and base64.b64decode(announced[1]) != digest.digest():
            partial.unlink()
            raise ChecksumMismatch(f"{path} was damaged on its way", hint="Download it again.")
        partial.replace(target)
        return target


def _filename(response: httpx.Response) -> str:
    """What the service calls a download; never a path."""
    found = re.search(r'filename="([^"]+)"', response.headers.get("Content-Disposition", ""))
    return PurePath(found[1]).name if found else "download"


def is_this_machine(host: str) -> bool:
    """Whether a host is the machine that we are on, so that no proxy leads to it."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
    return address.is_loopback or address.is_unspecified


def _raise_for_problem(response: httpx.Response) -> None:
    if response.is_success:
        return
    try:
        body = response.json()
    except ValueError:
        body = {}
    if not isinstance(body, dict) or "code" not in body:
        body = _without_body(response.status_code)
    raise WibamError.from_dict(
        {
            "code": body["code"],
            "message": body.get("detail", ""),
            "hint": body.get("hint"),
            "details": body.get("details"),
        }
    )


def _without_body(status: int) -> dict[str, Any]:
    codes: Sequence[tuple[int, str]] = ((401, "unauthorised"), (404, "not_found"), (409, "conflict"), (423, "locked"))
    unavailable = status in (408, 502, 503, 504)
    code = dict(codes).get(status, "service_unavailable" if unavailable else "http_error")
    return {"code": code, "detail": f"the service answered with status {status}", "hint": ""}
