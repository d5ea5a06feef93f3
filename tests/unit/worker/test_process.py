"""Stages as processes: what they may see, what they say, and that they are gone when they should be."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from wibam_core.adapters import confine
from worker.process import Done, Failed, LogLine, Message, Progress, StageProcess


def start(tmp_path: Path, code: str) -> StageProcess:
    return StageProcess.confined([sys.executable, "-c", code], home=tmp_path, cache=tmp_path, nice=3)


def listen(process: StageProcess, seconds: float = 20.0) -> list[Message]:
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


def wait_until(condition: object, seconds: float = 10.0) -> bool:
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

    def test_a_stage_has_no_network_where_the_system_lets_us(self, tmp_path: Path) -> None:
        allowed = subprocess.run(
            [sys.executable, "-c", "from wibam_core.adapters.confine import go_offline; exit(not go_offline())"]
        )
        if allowed.returncode:
            pytest.skip("this system lets no process leave its network")
        process = start(tmp_path, "import socket; print(socket.if_nameindex())")
        [line] = listen(process)
        process.close()
        assert line == LogLine("[(1, 'lo')]")

    def test_a_stage_still_writes_its_own_files(self, tmp_path: Path) -> None:
        process = start(tmp_path, "open('made', 'w').write('x'); import os; print(os.getuid(), os.stat('made').st_uid)")
        [line] = listen(process)
        process.close()
        assert line == LogLine(f"{os.getuid()} {os.getuid()}")

    def test_a_stage_is_polite_and_expendable(self, tmp_path: Path) -> None:
        before = os.nice(0)
        process = start(tmp_path, "import os; print(os.nice(0), open('/proc/self/oom_score_adj').read().strip())")
        [line] = listen(process)
        process.close()
        assert line == LogLine(f"{min(before + 3, 19)} 700")


class TestKilling:
    CHILD = (
        "import subprocess, sys, time; p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
    )

    def test_kill_takes_the_whole_group(self, tmp_path: Path) -> None:
        process = start(tmp_path, self.CHILD + "print(p.pid, flush=True); time.sleep(60)")
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
            tmp_path, "import signal, time; signal.signal(15, signal.SIG_IGN); print('x', flush=True); time.sleep(60)"
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

    def test_a_stage_dies_with_a_killed_worker(self, tmp_path: Path) -> None:
        worker = f"""
import sys, time
from pathlib import Path
from worker.process import StageProcess
home = Path({str(tmp_path)!r})
process = StageProcess.confined([sys.executable, "-c", "import time; time.sleep(60)"], home=home, cache=home, nice=0)
print(process.process.pid, flush=True)
time.sleep(60)
"""
        with subprocess.Popen([sys.executable, "-c", worker], stdout=subprocess.PIPE, text=True) as parent:
            assert parent.stdout is not None
            stage = int(parent.stdout.readline())
            assert wait_until(lambda: b"sleep" in Path(f"/proc/{stage}/cmdline").read_bytes())
            time.sleep(0.3)
            parent.kill()
        assert wait_until(lambda: not alive(stage))

    def test_memory_counts_children(self, tmp_path: Path) -> None:
        hog = "x = bytearray(80_000_000); print(1, flush=True); import time; time.sleep(60)"
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
