"""Sends what webhooks are told. A user names the address, so that it must not lead into the operator's own network.

The name is resolved once, each of its addresses is judged, and the connection goes to one that was judged, whatever the
name resolves to a moment later. Redirects are not followed, and no proxy is used.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import logging
import socket
import threading
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future
from urllib.parse import urlsplit

import httpx
from sqlalchemy.exc import SQLAlchemyError

from wibam_core import __version__
from wibam_core.adapters.webhook_store import Due, WebhookStore
from wibam_core.errors import InputError
from wibam_core.jobs.webhooks import Attempt, signed_headers

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
Address = ipaddress.IPv4Address | ipaddress.IPv6Address
_LOOK_EVERY_S = 1.0
#: So many are on their way at once, and about so many of one webhook: a receiver that lets each wait blocks no other.
#: Where eight or more do so, all others wait for one of them to be given up, after `_TIMEOUT_S` at most.
_AT_ONCE, _EACH_AT_ONCE = 32, 4
_MOST_URL = 2000
#: For the name. Resolvers ask the next name server after 5 s by default.
_LOOKUP_S = 10.0
#: For all that follows, however slowly the other side trickles.
_TIMEOUT_S = 15.0
_LEASE_S = 60.0
#: Their last 32 bits are an IPv4 address: NAT64 (RFC 6052), and "IPv4-compatible" ones (RFC 4291, 2.5.5.1).
_EMBEDDING = (ipaddress.IPv6Network("64:ff9b::/96"), ipaddress.IPv6Network("::/96"))
#: Of use inside a network alone, whatever `ipaddress` says: site-local ones (RFC 3879), its own NAT64 (RFC 8215).
_INSIDE = (ipaddress.IPv6Network("fec0::/10"), ipaddress.IPv6Network("64:ff9b:1::/48"))
_log = logging.getLogger(__name__)


class Refused(InputError):
    code = "address_refused"


def check_url(url: str, allowed: Sequence[Network]) -> str:
    """A webhook's address as it may be kept.

    Args:
        url: given by a user.
        allowed: networks that may be told beside the public ones.

    Raises:
        InputError: it is not an HTTP address without a user, or is longer than 2,000 characters.
        Refused: its host is an address that is not public.
    """
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
        known = parts.scheme in ("http", "https") and bool(host) and httpx.URL(url).host != ""
    except (ValueError, httpx.InvalidURL):
        known, host = False, None
    if not known or host is None or "@" in parts.netloc or len(url) > _MOST_URL or not url.isprintable() or " " in url:
        raise InputError(
            f"{url[:80]!r} is no address that can be told",
            hint="Give https://host/path or http://host/path, without a user and password.",
            field="url",
        )
    with contextlib.suppress(ValueError):  # a name, which is looked up when something is sent
        _check(ipaddress.ip_address(host), allowed)
    return url


def _check(address: Address, allowed: Sequence[Network]) -> None:
    """Raises:
    Refused: the address is not public, nor in a network that the operator allows.
    """
    inner: Address = address
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            inner = address.ipv4_mapped
        elif not (address.is_loopback or address.is_unspecified) and any(address in network for network in _EMBEDDING):
            inner = ipaddress.IPv4Address(int(address) & 0xFFFFFFFF)
        elif address.sixtofour is not None or address.teredo is not None:
            raise Refused(f"{address} leads through a tunnel", hint="Give a name or address that does not.")
    if any(inner in network for network in allowed if network.version == inner.version):
        return
    if not inner.is_global or inner.is_multicast or any(inner in network for network in _INSIDE):
        raise Refused(
            f"{address} is not a public address",
            hint="The service's operator can allow networks of their own: WIBAM_WEBHOOK_NETWORKS.",
        )


class WebhookSender:
    """Sends what is due, from a thread of its own. Any number may run at once, in any number of processes.

    Args:
        store: of the webhooks.
        allowed: networks that may be told beside the public ones.
    """

    def __init__(self, store: WebhookStore, allowed: Sequence[Network] = ()) -> None:
        self._store = store
        self._allowed = tuple(allowed)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin, or begin again after `stop`."""
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, name="webhooks", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Returns once what was being sent has ended, one way or the other."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=_LOOKUP_S + _TIMEOUT_S + 5.0)

    def send_due(self) -> int:
        """Try what is due, until nothing is; returns how many that was."""
        return asyncio.run(self._send(until_idle=True))

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                asyncio.run(self._send(until_idle=False))
            except SQLAlchemyError as error:  # what was sent is sent again: receivers know it by its id
                _log.warning("the database did not answer while webhooks were sent: %s", error)
            except Exception:  # whatever it was: the next look comes
                _log.exception("sending webhooks failed")
            self._stop.wait(_LOOK_EVERY_S)

    async def _send(self, until_idle: bool) -> int:
        """Send what is due beside what is on its way, so that nobody waits for another's receiver.

        The database, which may let one wait as long as a receiver may, is asked in other threads: whoever has answered
        meanwhile is heard.

        Args:
            until_idle: return once nothing is due nor on its way; else once somebody stops it.

        Returns:
            How many were sent, whatever became of them.
        """
        on_its_way: dict[asyncio.Task[None], str] = {}
        sent = 0
        fresh = httpx.Limits(max_keepalive_connections=0)
        async with httpx.AsyncClient(trust_env=False, follow_redirects=False, timeout=_TIMEOUT_S, limits=fresh) as http:
            while until_idle or not self._stop.is_set():
                busy = [hook for hook, count in Counter(on_its_way.values()).items() if count >= _EACH_AT_ONCE]
                room = _AT_ONCE - len(on_its_way)
                due = await asyncio.to_thread(self._store.take, room, _LEASE_S, _EACH_AT_ONCE, busy) if room else []
                sent += len(due)
                on_its_way |= {asyncio.create_task(self._send_one(http, one)): one.delivery.webhook_id for one in due}
                if not on_its_way:
                    if until_idle:
                        break
                    await asyncio.to_thread(self._stop.wait, _LOOK_EVERY_S)
                    continue
                done, _ = await asyncio.wait(on_its_way, timeout=_LOOK_EVERY_S, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    del on_its_way[task]
                    task.result()
            await asyncio.gather(*on_its_way)
        return sent

    async def _send_one(self, http: httpx.AsyncClient, due: Due) -> None:
        attempt = await self._attempt(http, due)
        await asyncio.to_thread(self._store.note, due, attempt)

    async def _attempt(self, http: httpx.AsyncClient, due: Due) -> Attempt:
        began, started = time.time(), time.monotonic()
        status, error = None, ""
        late = f"its name was not found within {_LOOKUP_S:g} s"
        try:
            async with asyncio.timeout(_LOOKUP_S):
                address = await self._address(httpx.URL(due.url))
            late = f"no answer within {_TIMEOUT_S:g} s"
            async with asyncio.timeout(_TIMEOUT_S):
                status = await self._post(http, due, address, int(began))
        except TimeoutError:
            error = late
        except Refused as refused:
            error = refused.message
        except Exception as trouble:  # whatever it was: it is this receiver's, and no other waits for it
            error = (str(trouble) or type(trouble).__name__)[:300]
        if status is not None and not 200 <= status < 300:
            error = f"answered with status {status}"
        return Attempt(began, status, error, round(time.monotonic() - started, 3))

    async def _address(self, url: httpx.URL) -> Address:
        """The first address of a URL's host, of which all have been judged."""
        found = await asyncio.wrap_future(_look_up(url.host))
        for address in found:
            _check(address, self._allowed)
        return found[0]

    async def _post(self, http: httpx.AsyncClient, due: Due, address: Address, now_s: int) -> int:
        url = httpx.URL(due.url)
        body = due.delivery.body.encode()
        headers = {
            "Host": url.netloc.decode("ascii"),
            "Content-Type": "application/json",
            "User-Agent": f"WIBAM/{__version__}",
            **signed_headers(due.secret, due.delivery.id, now_s, body),
        }
        pinned = url.copy_with(host=str(address))
        # certificates are checked against the name, not the address
        extensions = {"sni_hostname": url.host} if url.scheme == "https" else {}
        async with http.stream("POST", pinned, content=body, headers=headers, extensions=extensions) as response:
            return response.status_code  # what else it says interests nobody


def _look_up(host: str) -> Future[list[Address]]:
    """The addresses of a host. A lookup cannot be ended, so that each has a thread that nobody needs to wait for."""
    found: Future[list[Address]] = Future()
    found.set_running_or_notify_cancel()  # from now on it can no longer be cancelled, but be left alone

    def look() -> None:
        try:
            infos = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
            found.set_result([ipaddress.ip_address(str(info[4][0]).partition("%")[0]) for info in infos])
        except Exception as trouble:  # whatever it was: who waits for it learns it
            found.set_exception(trouble)

    threading.Thread(target=look, name="webhook lookup", daemon=True).start()
    return found
