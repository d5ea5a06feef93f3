"""Stages as processes: what they may see, what they say, and that they are gone when they should be."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.builders import AMBIGUOUS
from wibam_core.adapters import confine
from worker.process import Done, Failed, LogLine, Message, Progress, StageProcess, Warned, stages_can_be_offline


def start(tmp_path: Path, code: str) -> StageProcess:
    return StageProcess.confined([sys.executable, "-c", code], home=tmp_path, cache=tmp_path, nice=3)


def listen(process: StageProcess, seconds: float = 600.0) -> list[Message]:
    messages: list[Message] = []
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        ended = process.ended
        messages += process.poll(0.1)
        if ended and process.quiet:
            break
    return messages


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def wait_until(condition: object, seconds: float = 600.0) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():  # type: ignore[operator]
            return True
        time.sleep(0.05)
    return False


class TestListening:
    def test_hears_progress_results_and_log_lines(self, tmp_path: Path) -> None:
        code = """
import json, sys
print(json.dumps({"event": "progress", "fraction": 0.5, "message": "half", "figures": {"loss": 2}}))
print("a library speaks")
print("to the log", file=sys.stderr)
print(json.dumps({"event": "done", "summary": {"n": 1}}), end="")
"""
        process = start(tmp_path, code)
        messages = listen(process)
        process.close()
        assert Progress(0.5, "half", {"loss": 2.0}) in messages
        assert LogLine("a library speaks") in messages
        assert LogLine("to the log") in messages
        assert Done({"n": 1}) in messages
        assert list(process.tail) == ["to the log"]
        assert process.process.returncode == 0

    def test_hears_warnings(self, tmp_path: Path) -> None:
        line = json.dumps({"event": "warning", "warning": AMBIGUOUS.model_dump()})
        process = start(tmp_path, f"print({line!r})")
        assert listen(process) == [Warned(AMBIGUOUS)]
        process.close()

    def test_hears_failures(self, tmp_path: Path) -> None:
        code = """print('{"event": "failed", "error": {"code": "no_overlap"}}'); raise SystemExit(1)"""
        process = start(tmp_path, code)
        assert listen(process) == [Failed({"code": "no_overlap"})]
        process.close()

    @pytest.mark.parametrize("line", ['{"event": "progress"}', '{"event": "done"}', "[]", '{"event": "x"}', "{"])
    def test_what_it_does_not_understand_is_a_log_line(self, tmp_path: Path, line: str) -> None:
        process = start(tmp_path, f"print({line!r})")
        assert listen(process) == [LogLine(line)]
        process.close()

    def test_a_flood_without_line_ends_does_not_pile_up(self, tmp_path: Path) -> None:
        process = start(tmp_path, "import sys; sys.stdout.write('x' * 5_000_000)")
        messages = listen(process)
        process.close()
        assert max(len(m.text) for m in messages if isinstance(m, LogLine)) <= 1_100_000
        assert sum(len(m.text) for m in messages if isinstance(m, LogLine)) > 4_000_000


class TestConfinement:
    def test_a_stage_inherits_no_secrets(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("WIBAM_DATABASE_URL", "postgresql://secret")
        monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
        process = start(
            tmp_path, "import os; print(sorted(os.environ), os.environ['HOME'], 'secret' in str(os.environ))"
        )
        [line] = listen(process)
        process.close()
        assert isinstance(line, LogLine)
        assert "WIBAM" not in line.text
        assert line.text.endswith(f"{tmp_path} False")

    def test_threads_of_a_stage_do_not_keep_their_cores_busy_to_wait(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """PyTorch is told before it loads, unless the administrator has said something else."""
        monkeypatch.delenv("GOMP_SPINCOUNT", raising=False)
        for said, heard in ((None, "2000"), ("7", "7")):
            if said:
                monkeypatch.setenv("GOMP_SPINCOUNT", said)
            process = start(tmp_path, "import os; print(os.environ['GOMP_SPINCOUNT'])")
            [line] = listen(process)
            process.close()
            assert isinstance(line, LogLine) and line.text == heard

    def test_a_stage_has_no_network_where_the_system_lets_us(self, tmp_path: Path) -> None:
        if not stages_can_be_offline():
            pytest.skip("this system lets no process leave its network")
        with socket.create_server(("127.0.0.1", 0)) as server:
            address = server.getsockname()
            socket.create_connection(address, 60.0).close()
            code = f"""
import socket
try:
    socket.create_connection({address!r}, 60.0)
    print("reached")
except OSError:
    print("cut off")
"""
            process = start(tmp_path, code)
            [line] = listen(process)
            process.close()
        assert line == LogLine("cut off")

    @pytest.mark.parametrize("refused", ["setgroups", "uid_map", "gid_map"])
    def test_a_stage_goes_on_as_it_was_where_user_namespaces_stay_empty(self, tmp_path: Path, refused: str) -> None:
        """As on machines where AppArmor restricts unprivileged user namespaces."""
        own = tmp_path / "own"
        own.touch(0o600)
        code = f"""
import json
import os
from wibam_core.adapters import confine
unshare, write = confine._unshare, confine._write
def refuse(path, text):
    if path.endswith({refused!r}):
        raise PermissionError(1, "not permitted", path)
    write(path, text)
confine._unshare = lambda flags: flags != confine._CLONE_NEWNET and unshare(flags)
confine._write = refuse
print(confine.go_offline(), os.getuid(), open({str(own)!r}, "r+").read())
"""
        result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert result.stdout.split() == ["False", str(os.getuid())], result.stderr

    def test_a_stage_still_writes_its_own_files(self, tmp_path: Path) -> None:
        process = start(tmp_path, "open('made', 'w').write('x'); import os; print(os.getuid(), os.stat('made').st_uid)")
        [line] = listen(process)
        process.close()
        assert line == LogLine(f"{os.getuid()} {os.getuid()}")

    def test_a_stage_is_polite_and_expendable(self, tmp_path: Path) -> None:
        nice, expendable = os.nice(0), int(Path("/proc/self/oom_score_adj").read_text())
        process = start(tmp_path, "import os; print(os.nice(0), open('/proc/self/oom_score_adj').read().strip())")
        [line] = listen(process)
        process.close()
        assert line == LogLine(f"{min(nice + 3, 19)} {max(expendable, 700)}")

    def test_what_is_more_expendable_already_stays_so(self) -> None:
        shim = [sys.executable, confine.__file__, "--parent", str(os.getpid()), "--expendable", "--"]
        program = [*shim, sys.executable, "-c", "print(open('/proc/self/oom_score_adj').read())"]
        code = f"import os; open('/proc/self/oom_score_adj', 'w').write('900'); os.execv({program[0]!r}, {program!r})"
        assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "900"

    def test_a_stage_dumps_no_core_and_writes_no_endless_file(self, tmp_path: Path) -> None:
        code = "import resource as r; print(r.getrlimit(r.RLIMIT_CORE), max(r.getrlimit(r.RLIMIT_FSIZE)) > 10**11)"
        process = start(tmp_path, code + "; print(r.RLIM_INFINITY in r.getrlimit(r.RLIMIT_FSIZE))")
        lines = listen(process)
        process.close()
        assert lines == [LogLine("(0, 0) True"), LogLine("False")]


class TestSecrets:
    """What the worker knows from its environment."""

    #: Root may read everything, so it becomes nobody first, and as readable as any program at its start.
    NO_PRIVILEGES = """
import ctypes, os, sys, time
if os.getuid() == 0:
    os.setgroups([]), os.setgid(65534), os.setuid(65534)
    ctypes.CDLL(None).prctl(4, 1, 0, 0, 0)
"""

    @pytest.mark.parametrize("kept", [False, True])
    def test_are_not_to_be_read_by_others_of_the_same_user(self, kept: bool) -> None:
        code = f"""
from wibam_core.adapters import confine
{self.NO_PRIVILEGES}
if {kept}:
    confine.keep_secrets()
print("ready", flush=True)
time.sleep(600)
"""
        reader = f"""
{self.NO_PRIVILEGES}
try:
    print(open(f"/proc/{{sys.argv[1]}}/environ").read())
except PermissionError:
    print("refused")
"""
        secret = {**os.environ, "PASSWORD": "abc"}
        with subprocess.Popen([sys.executable, "-c", code], env=secret, stdout=subprocess.PIPE) as holder:
            assert holder.stdout is not None
            assert holder.stdout.readline() == b"ready\n"
            read = subprocess.check_output([sys.executable, "-c", reader, str(holder.pid)], text=True)
            holder.kill()
        assert ("PASSWORD=abc" in read, read.strip() == "refused") == (not kept, kept)

    def test_the_worker_keeps_them_and_says_what_stages_can_reach(self, tmp_path: Path) -> None:
        settings = {"WIBAM_DATA_DIR": str(tmp_path), "WIBAM_BROKER_URL": "redis://r", "WIBAM_TOKEN_SHA256": "0" * 64}
        code = """
import ctypes, os
from worker import app, process
dumpable = lambda: ctypes.CDLL(None).prctl(3, 0, 0, 0, 0)
print(dumpable(), process.stages_can_be_offline(), flush=True)
if os.fork() == 0:
    print(dumpable(), flush=True)
    os._exit(0)
os.wait()
app.kept_out = lambda: {"reach_network": False, "mount": True}
app._say_what_stages_can_reach()
"""
        command = [sys.executable, "-c", code]
        result = subprocess.run(command, env={**os.environ, **settings}, capture_output=True, text=True)
        assert result.stdout.split() == ["0", str(stages_can_be_offline()), "0"], result.stderr
        assert "taken over from this: connect to a service on this machine\n" in result.stderr


class TestKilling:
    CHILD = (
        "import subprocess, sys, time; p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
    )

    def test_kill_takes_the_whole_group(self, tmp_path: Path) -> None:
        process = start(tmp_path, self.CHILD + "print(p.pid, flush=True); time.sleep(600)")
        while not (messages := process.poll(5.0)):
            pass
        [line] = messages
        assert isinstance(line, LogLine)
        grandchild = int(line.text)
        assert alive(grandchild)
        process.kill()
        assert process.ended
        assert wait_until(lambda: not alive(grandchild))
        process.close()

    def test_a_stage_that_ignores_sigterm_is_killed_all_the_same(self, tmp_path: Path) -> None:
        process = start(
            tmp_path, "import signal, time; signal.signal(15, signal.SIG_IGN); print('x', flush=True); time.sleep(600)"
        )
        while not process.poll(5.0):
            pass
        process.kill()
        assert process.process.returncode == -9
        process.close()

    def test_closing_takes_what_the_stage_left_behind(self, tmp_path: Path) -> None:
        process = start(tmp_path, self.CHILD + "print(p.pid)")
        [line] = listen(process)
        assert isinstance(line, LogLine)
        process.close()
        assert wait_until(lambda: not alive(int(line.text)))

    def test_adopted_orphans_are_reaped(self, tmp_path: Path) -> None:
        code = f"""
from pathlib import Path
from wibam_core.adapters import confine
from worker.process import StageProcess
confine.adopt_orphans()
home = Path({str(tmp_path)!r})
process = StageProcess.confined([{sys.executable!r}, "-c", {self.CHILD + "print(p.pid, flush=True)"!r}],
                                home=home, cache=home, nice=0)
while not (messages := process.poll(5.0)):
    pass
process.close()
print(Path("/proc", messages[0].text).exists())
"""
        assert subprocess.check_output([sys.executable, "-c", code], text=True) == "False\n"

    def test_a_stage_dies_with_a_killed_worker(self, tmp_path: Path) -> None:
        worker = f"""
import sys, time
from pathlib import Path
from worker.process import StageProcess
home = Path({str(tmp_path)!r})
stage = "import os, time; print(os.getpid(), flush=True); time.sleep(600)"
process = StageProcess.confined([sys.executable, "-c", stage], home=home, cache=home, nice=0)
while not (messages := process.poll(5.0)):
    pass
print(messages[0].text, flush=True)
time.sleep(600)
"""
        with subprocess.Popen([sys.executable, "-c", worker], stdout=subprocess.PIPE, text=True) as parent:
            assert parent.stdout is not None
            stage = int(parent.stdout.readline())
            assert alive(stage)
            parent.kill()
        assert wait_until(lambda: not alive(stage))

    def test_memory_counts_children(self, tmp_path: Path) -> None:
        hog = "x = bytearray(80_000_000); print(1, flush=True); import time; time.sleep(600)"
        process = start(tmp_path, f"import subprocess, sys; subprocess.run([sys.executable, '-c', {hog!r}])")
        while not process.poll(5.0):
            pass
        assert process.memory_bytes() > 80_000_000
        process.kill()
        process.close()


def test_the_shim_refuses_to_outlive_a_parent_that_is_gone_already() -> None:
    shim = [sys.executable, confine.__file__, "--parent", "1", "--", sys.executable, "-c", "print('alive')"]
    result = subprocess.run(shim, capture_output=True)
    assert result.returncode == -9
    assert result.stdout == b""
