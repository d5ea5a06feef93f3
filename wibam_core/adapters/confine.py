"""Become another program, confined: ``python confine.py --parent PID [options] -- PROGRAM ARGUMENTS...``.

Run as a script, it imports next to nothing, so it costs a few milliseconds. Whatever it starts dies with the process
that asked for it, even if that one is killed. Options: ``--nice N``, ``--offline`` (no network, where the system
lets us), ``--expendable`` (the first to go when the machine runs out of memory), ``--limited`` (no core dumps, no
endless file). ``python confine.py --check-offline`` tells by its exit code whether ``--offline`` would do anything.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys

_PR_SET_PDEATHSIG = 1
_PR_SET_DUMPABLE = 4
_PR_SET_CHILD_SUBREAPER = 36
_CLONE_NEWUSER = 0x10000000
_CLONE_NEWNET = 0x40000000
_LARGEST_FILE_BYTES = 1 << 40
_EXPENDABLE = 700


def die_with_parent(parent_pid: int) -> None:
    """Be killed when the thread that started this process ends. Linux only; elsewhere nothing happens."""
    if sys.platform != "linux":
        return
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent_pid:  # it died before we asked
        os.kill(os.getpid(), signal.SIGKILL)


def keep_secrets() -> None:
    """Let no other process of the same user read this one's memory and environment, nor those of its forks.

    Linux only; elsewhere nothing happens. A program that this process starts is readable again.
    """
    if sys.platform == "linux":
        _prctl(_PR_SET_DUMPABLE, 0)


def adopt_orphans() -> None:
    """Be the parent of whatever this process's children leave behind, instead of PID 1. Whoever calls this reaps them.

    Linux only; elsewhere nothing happens.
    """
    if sys.platform == "linux":
        _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def go_offline() -> bool:
    """Leave every network behind, loopback too. Returns whether the system allowed it; if not, nothing has changed."""
    if sys.platform != "linux":
        return False
    if _unshare(_CLONE_NEWNET):
        return True
    # Some systems let everybody have a user namespace, but nobody fill it in. That cannot be undone: a child tries.
    return _succeeds_in_a_child() and _enter_user_namespace()


def _enter_user_namespace() -> bool:
    user, group = os.getuid(), os.getgid()
    if not _unshare(_CLONE_NEWUSER | _CLONE_NEWNET):
        return False
    try:
        _write("/proc/self/setgroups", "deny")
        _write("/proc/self/uid_map", f"{user} {user} 1")
        _write("/proc/self/gid_map", f"{group} {group} 1")
    except OSError:
        return False
    return True


def _succeeds_in_a_child() -> bool:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = int(not _enter_user_namespace())
        finally:
            os._exit(code)
    return os.waitpid(child, 0)[1] == 0


def _be_expendable() -> None:
    path = "/proc/self/oom_score_adj"
    try:
        with open(path) as file:  # noqa: PTH123  # pathlib would triple the start-up time
            present = int(file.read())
        _write(path, str(max(present, _EXPENDABLE)))
    except OSError:
        pass  # not Linux: the system decides


def _be_limited() -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    largest = _LARGEST_FILE_BYTES if hard == resource.RLIM_INFINITY else min(_LARGEST_FILE_BYTES, hard)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))


def _prctl(option: int, value: int) -> None:
    ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0)


def _unshare(flags: int) -> bool:
    return bool(ctypes.CDLL(None, use_errno=True).unshare(flags) == 0)


def _write(path: str, text: str) -> None:
    with open(path, "w") as file:  # noqa: PTH123
        file.write(text)


def main(arguments: list[str]) -> None:
    """See the module's docstring."""
    if arguments == ["--check-offline"]:
        sys.exit(not go_offline())
    split = arguments.index("--")
    options, program = arguments[:split], arguments[split + 1 :]
    if "--nice" in options:
        os.nice(int(options[options.index("--nice") + 1]))
    if "--expendable" in options:
        _be_expendable()
    if "--limited" in options:
        _be_limited()
    if "--offline" in options:
        go_offline()  # before the parent-death signal: gaining a user namespace would clear it
    die_with_parent(int(options[options.index("--parent") + 1]))
    os.execv(program[0], program)


if __name__ == "__main__":
    main(sys.argv[1:])
