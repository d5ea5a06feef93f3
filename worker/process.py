"""A stage as an operating-system process: started confined, listened to, watched and, when need be, killed whole."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import wibam_core
from wibam_core.adapters import confine
from wibam_core.adapters.system_files import system_files
from wibam_core.adapters.threads import waiting
from wibam_core.documents.warnings import StageWarning
from wibam_core.stages.execute import StageRequest

#: What a stage may inherit. Everything else, the database's URL and the token's hash first of all, stays behind.
_INHERITED = ("PATH", "LANG", "LC_ALL", "TZ", "LD_LIBRARY_PATH", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VIRTUAL_ENV",
              "CUDA_VISIBLE_DEVICES", "NVIDIA_VISIBLE_DEVICES")  # fmt: skip
_TAIL_LINES = 30
_LONGEST_LINE = 1_000_000
_GRACE_S = 3.0


@dataclass(frozen=True)
class Progress:
    """A progress report of the stage."""

    fraction: float
    message: str
    figures: Mapping[str, float]


@dataclass(frozen=True)
class Warned:
    """The stage warns of something."""

    warning: StageWarning


@dataclass(frozen=True)
class Done:
    """The stage has finished."""

    summary: Mapping[str, Any]


@dataclass(frozen=True)
class Failed:
    """The stage gave up, and says why (`WibamError.to_dict`)."""

    error: Mapping[str, Any]


@dataclass(frozen=True)
class LogLine:
    """Something the stage, or a library in it, printed."""

    text: str


Message = Progress | Warned | Done | Failed | LogLine


@dataclass
class _Lines:
    """Bytes in, whole lines out; over-long ones are cut."""

    rest: bytes = b""

    def feed(self, data: bytes) -> list[str]:
        *lines, self.rest = (self.rest + data).split(b"\n")
        if len(self.rest) > _LONGEST_LINE:
            lines.append(self.rest)
            self.rest = b""
        return [line[:_LONGEST_LINE].decode("utf-8", "replace") for line in lines]

    def end(self) -> list[str]:
        rest, self.rest = self.rest, b""
        return [rest.decode("utf-8", "replace")] if rest else []


@dataclass
class StageProcess:
    """A running stage.

    Attributes:
        tail: the last lines of its log.
        quiet: the latest `poll` heard nothing at all.
    """

    process: subprocess.Popen[bytes]
    tail: deque[str] = field(default_factory=lambda: deque(maxlen=_TAIL_LINES))
    quiet: bool = False

    def __post_init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._lines = {stream: _Lines() for stream in (self._stdout, self._stderr)}
        for stream in self._lines:
            os.set_blocking(stream.fileno(), False)
            self._selector.register(stream, selectors.EVENT_READ)

    @classmethod
    def start(cls, request: StageRequest, *, home: Path, cache: Path, nice: int) -> StageProcess:
        """Run ``python -m wibam_core.stages.execute REQUEST``, confined to the files that the request names.

        Args:
            request: what to run, on what.
            home: a temporary folder for this run.
            cache: a folder that all runs may share for caches.
            nice: scheduling priority.
        """
        told = home / "request.json"
        told.write_text(request.model_dump_json())
        program = [sys.executable, "-P", "-m", "wibam_core.stages.execute", str(told)]
        return cls.confined(program, home=home, cache=cache, nice=nice, reads=request.reads, writes=request.writes)

    @classmethod
    def confined(
        cls,
        program: Sequence[str],
        *,
        home: Path,
        cache: Path,
        nice: int,
        reads: Sequence[Path] = (),
        writes: Sequence[Path] = (),
    ) -> StageProcess:
        """Run a program in a session of its own, without our secrets, offline where the system allows it.

        Of all files, where the system can hold it to that, it may read those beneath ``reads`` and write those beneath
        ``writes``, its home and the cache, beside what Python and its libraries need. It is killed when the thread that
        calls this ends.
        """
        shim = [sys.executable, "-I", "-S", confine.__file__, "--parent", str(os.getpid()), "--nice", str(nice)]
        given = [f"--read={path.resolve()}" for path in reads]
        given += [f"--write={path.resolve()}" for path in (*writes, home, cache)]
        process = subprocess.Popen(
            [*shim, "--offline", "--expendable", "--limited", *system_files(), *given, "--", *program],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            cwd=home,
            env=_environment(home, cache),
        )
        return cls(process)

    def poll(self, timeout_s: float) -> list[Message]:
        """What the stage has said since the last call; waits for at most ``timeout_s`` for something to come."""
        self.quiet = True
        if not self._selector.get_map():
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(timeout_s)
            return []
        messages: list[Message] = []
        for key, _ in self._selector.select(timeout_s):
            messages += self._read(key.fileobj)  # type: ignore[arg-type]
            self.quiet = False
        return messages

    @property
    def ended(self) -> bool:
        """The process has ended. `poll` until it is ``quiet`` to hear its last words."""
        return self.process.poll() is not None

    def memory_bytes(self) -> int:
        """Resident memory of the stage and of all processes that it has started. 0 where the system does not tell."""
        return session_memory_bytes(self.process.pid)

    def kill(self) -> None:
        """End the whole process group: politely first, for sure after a few seconds. Returns once it is gone."""
        self._signal(signal.SIGTERM)
        deadline = time.monotonic() + _GRACE_S
        while not self.ended and time.monotonic() < deadline:
            self.poll(0.1)
        self._signal(signal.SIGKILL)
        self.process.wait()

    def close(self) -> None:
        """End whatever still runs, and let go of the pipes."""
        self._signal(signal.SIGKILL)
        self.process.wait()
        with contextlib.suppress(ChildProcessError):
            while True:  # the stage's own children, where we adopted them
                os.waitpid(-self.process.pid, 0)
        self._selector.close()
        self._stdout.close()
        self._stderr.close()

    def _read(self, stream: IO[bytes]) -> list[Message]:
        data = os.read(stream.fileno(), 1 << 16)
        lines = self._lines[stream].feed(data) if data else self._lines[stream].end()
        if not data:
            self._selector.unregister(stream)
        if stream is self._stderr:
            self.tail.extend(lines)
            return [LogLine(line) for line in lines]
        return [_message(line) for line in lines]

    def _signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    @property
    def _stdout(self) -> IO[bytes]:
        assert self.process.stdout is not None
        return self.process.stdout

    @property
    def _stderr(self) -> IO[bytes]:
        assert self.process.stderr is not None
        return self.process.stderr


def stages_can_be_offline() -> bool:
    """Whether this system lets a stage leave its network."""
    return subprocess.run([sys.executable, "-I", "-S", confine.__file__, "--check-offline"]).returncode == 0


def session_memory_bytes(session_id: int) -> int:
    """Resident memory (bytes) of all processes of a session, from /proc; 0 where there is none."""
    page, total = os.sysconf("SC_PAGE_SIZE"), 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has just ended
        if int(fields[3]) == session_id:
            total += int(fields[21]) * page
    return total


def system_oom_kills() -> int:
    """How many processes the system has killed for lack of memory since it started; 0 where it does not tell."""
    try:
        lines = Path("/proc/vmstat").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("oom_kill ")), 0)


def _environment(home: Path, cache: Path) -> dict[str, str]:
    inherited = {name: os.environ[name] for name in _INHERITED if name in os.environ}
    return {
        **inherited,
        **waiting(os.environ),
        "HOME": str(home),
        "TMPDIR": str(home),
        "XDG_CACHE_HOME": str(cache),
        "MPLCONFIGDIR": str(cache / "matplotlib"),
        "PYTHONPATH": str(Path(wibam_core.__file__).resolve().parent.parent),
        "PYTHONUNBUFFERED": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def _message(line: str) -> Message:
    try:
        data = json.loads(line)
        match data["event"]:
            case "progress":
                figures = {str(k): float(v) for k, v in dict(data["figures"]).items()}
                return Progress(float(data["fraction"]), str(data["message"]), figures)
            case "warning":
                return Warned(StageWarning.model_validate(data["warning"]))
            case "done":
                return Done(dict(data["summary"]))
            case "failed":
                return Failed(dict(data["error"]))
    except (ValueError, KeyError, TypeError):
        pass
    return LogLine(line)
