"""Become another program, confined: ``python confine.py --parent PID [options] -- PROGRAM ARGUMENTS...``.

Run as a script, it imports next to nothing, so it costs a few milliseconds. Whatever it starts dies with the process
that asked for it, even if that one is killed. Options: ``--nice N``, ``--offline`` (no network, where the system
lets us), ``--expendable`` (the first to go when the machine runs out of memory).
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1
_CLONE_NEWUSER = 0x10000000
_CLONE_NEWNET = 0x40000000


def die_with_parent(parent_pid: int) -> None:
    """Be killed when the thread that started this process ends. Linux only; elsewhere nothing happens."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:  # it died before we asked
        os.kill(os.getpid(), signal.SIGKILL)


def go_offline() -> bool:
    """Leave every network behind, loopback too. Returns whether the system allowed it."""
    if sys.platform != "linux":
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_CLONE_NEWNET) == 0:
        return True
    user, group = os.getuid(), os.getgid()
    if libc.unshare(_CLONE_NEWUSER | _CLONE_NEWNET) != 0:
        return False
    for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
        with open(f"/proc/self/{name}", "w") as file:  # noqa: PTH123  # pathlib would triple the start-up time
            file.write(text)
    return True


def _be_expendable() -> None:
    try:
        with open("/proc/self/oom_score_adj", "w") as file:  # noqa: PTH123
            file.write("700")
    except OSError:
        pass  # not Linux: the system decides


def main(arguments: list[str]) -> None:
    """See the module's docstring."""
    split = arguments.index("--")
    options, program = arguments[:split], arguments[split + 1 :]
    if "--nice" in options:
        os.nice(int(options[options.index("--nice") + 1]))
    if "--expendable" in options:
        _be_expendable()
    if "--offline" in options:
        go_offline()  # before the parent-death signal: gaining a user namespace would clear it
    die_with_parent(int(options[options.index("--parent") + 1]))
    os.execv(program[0], program)


if __name__ == "__main__":
    main(sys.argv[1:])
