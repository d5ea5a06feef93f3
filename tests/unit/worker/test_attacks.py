"""What a stage that was taken over could do: nothing beyond what it was given, where the system can hold it to that."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

import pytest

from worker import attacks
from worker.process import LogLine, StageProcess, stages_can_be_offline


def landlock_version() -> int:
    return int(ctypes.CDLL(None).syscall(444, None, ctypes.c_size_t(0), 1)) if sys.platform == "linux" else 0


needs_landlock = pytest.mark.skipif(landlock_version() < 6, reason="this kernel has no Landlock of version 6")


@needs_landlock
def test_no_attack_succeeds() -> None:
    held = attacks.kept_out()
    expected = dict.fromkeys(attacks.ATTACKS, True)
    if not stages_can_be_offline():
        expected |= {"reach_network": held["reach_network"]}
    if os.uname().machine not in ("x86_64", "aarch64"):
        expected |= {"reach_socket": held["reach_socket"]}
    assert held == expected


def test_every_attack_succeeds_where_nothing_confines(monkeypatch: pytest.MonkeyPatch) -> None:
    """The attacks themselves work: a program that is not walled in reads the file and reaches the sockets."""

    def free(program: list[str], *, home: Path, cache: Path, nice: int, reads: list[Path]) -> StageProcess:
        import subprocess

        return StageProcess(subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE))

    monkeypatch.setattr(StageProcess, "confined", free)
    held = attacks.kept_out()
    for name in ("read_upload", "write_data", "leave_link", "reach_network", "reach_socket", "signal_worker"):
        assert not held[name], name
    said = attacks.report(held)
    assert "SUCCEEDS  read a file of another job" in said and "people whom you" in said
    assert "nothing else" in attacks.report(dict.fromkeys(attacks.ATTACKS, True))


@needs_landlock
def test_what_is_given_can_be_used(tmp_path: Path) -> None:
    given, own, hidden = tmp_path / "given", tmp_path / "own", tmp_path / "hidden"
    for folder in (given, own, hidden):
        folder.mkdir()
        (folder / "file").write_text(folder.name)
    code = f"""
import os, pathlib, socket
print(pathlib.Path({str(given)!r}, "file").read_text())
own = pathlib.Path({str(own)!r})
(own / "new").mkdir()
(own / "file").rename(own / "new" / "moved")
with (own / "new" / "moved").open("r+") as moved:
    moved.truncate(1)
print((own / "new" / "moved").read_text(), sorted(os.listdir(own)))
a, b = socket.socketpair()
a.send(b"x")
print(b.recv(1))
for path, mode in (({str(given / "file")!r}, "w"), ({str(hidden / "file")!r}, "r")):
    try:
        open(path, mode)
    except PermissionError:
        print("refused")
"""
    home = tmp_path / "home"
    home.mkdir()
    process = StageProcess.confined(
        [sys.executable, "-c", code], home=home, cache=home, nice=0, reads=[given], writes=[own]
    )
    lines = []
    while not (process.ended and process.quiet):
        lines += [message.text for message in process.poll(0.1) if isinstance(message, LogLine)]
    process.close()
    assert lines == ["given", "o ['new']", "b'x'", "refused", "refused"]
