"""Become another program, confined: ``python confine.py --parent PID [options] -- PROGRAM ARGUMENTS...``.

Run as a script, it imports next to nothing, so it costs a few milliseconds. Whatever it starts dies with the process
that asked for it, even if that one is killed. Options: ``--nice N``, ``--offline`` (no network, where the system
lets us), ``--expendable`` (the first to go when the machine runs out of memory), ``--limited`` (no core dumps, no
endless file, no more privileges than it has), ``--memory-gb N`` (GiB of its own, beyond which it is given none, where
the system counts them), ``--program=PATH``, ``--read=PATH``, ``--list=PATH`` and ``--write=PATH``
(each any number of times): of all files, the program may run, read, list and write those beneath these paths alone, and
make files and folders, but no links; no process but its own children is within its reach, nor is a Unix socket
(Landlock and seccomp, where the system has them). ``python confine.py --check-offline`` tells by its exit code whether
``--offline`` would do anything.
"""

from __future__ import annotations

import ctypes
import errno
import os
import resource
import signal
import stat
import struct
import sys

_PR_SET_PDEATHSIG = 1
_PR_SET_DUMPABLE = 4
_PR_SET_CHILD_SUBREAPER = 36
_CLONE_NEWUSER = 0x10000000
_CLONE_NEWNET = 0x40000000
_PR_CAPBSET_DROP = 24
_PR_SET_SECCOMP = 22
_PR_SET_NO_NEW_PRIVS = 38
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


def _bound_memory(most_gb: int) -> None:
    """Address space that a process asks for itself; programs and libraries that are mapped from files do not count."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = most_gb << 30 if hard == resource.RLIM_INFINITY else min(most_gb << 30, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def _drop_privileges() -> None:
    """No program that is started has a capability, even root's, and none gains any by what its file says."""
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)
    for capability in range(64):
        _prctl(_PR_CAPBSET_DROP, capability)  # refused without the right to, and of those that the kernel lacks


# --- files, and other processes: Landlock (linux/landlock.h) -------------------------------------
_LANDLOCK_CREATE_RULESET, _LANDLOCK_ADD_RULE, _LANDLOCK_RESTRICT_SELF = 444, 445, 446
_LANDLOCK_RULE_PATH_BENEATH = 1
_EXECUTE, _WRITE_FILE, _READ_FILE, _READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
_TRUNCATE, _IOCTL = 1 << 14, 1 << 15
#: Making devices, sockets, pipes and symbolic links. Whoever reads outputs with more rights would follow a link there.
_MAKE_SPECIAL = 1 << 6 | 1 << 9 | 1 << 10 | 1 << 11 | 1 << 12
#: Rights that a file may have; all others are of folders.
_OF_FILES = _EXECUTE | _WRITE_FILE | _READ_FILE | _TRUNCATE | _IOCTL
#: All rights to files by version of Landlock: 2 added moving between folders, 3 truncating, 5 control of devices.
_ALL_RIGHTS = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 4: (1 << 15) - 1, 5: (1 << 16) - 1}
#: From version 4 on, binding and connecting of TCP sockets; from 6 on, abstract Unix sockets and signals.
_NET, _SCOPED = 3, 3


def _wall_in(rights: list[tuple[str, int]]) -> bool:
    """Leave this process, and all that it starts, these rights to what lies beneath these paths, and none to others.

    Returns whether the system can do that; if not, nothing has changed.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    version = int(libc.syscall(_LANDLOCK_CREATE_RULESET, None, ctypes.c_size_t(0), 1))
    if version < 1:
        return False
    handled = _ALL_RIGHTS[min(version, 5)]
    fields = [handled, _NET, _SCOPED][: 1 + (version >= 4) + (version >= 6)]
    attributes = struct.pack(f"{len(fields)}Q", *fields)
    ruleset = int(libc.syscall(_LANDLOCK_CREATE_RULESET, attributes, ctypes.c_size_t(len(attributes)), 0))
    if ruleset < 0:
        return False
    for path, allowed in rights:
        try:
            opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
        except OSError:
            continue  # what is not there needs no rule
        if not stat.S_ISDIR(os.fstat(opened).st_mode):
            allowed &= _OF_FILES
        rule = struct.pack("=Qi", allowed & handled, opened)
        failed = libc.syscall(_LANDLOCK_ADD_RULE, ruleset, _LANDLOCK_RULE_PATH_BENEATH, rule, 0)
        os.close(opened)
        if failed:
            return False
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)
    walled = libc.syscall(_LANDLOCK_RESTRICT_SELF, ruleset, 0) == 0
    os.close(ruleset)
    return walled


# --- system calls: seccomp (linux/filter.h, linux/seccomp.h) -------------------------------------
_SECCOMP_FILTER = 2
_LOAD, _IF_EQUAL, _IF_AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
_ALLOW, _REFUSE = 0x7FFF0000, 0x00050000 | errno.EPERM
_AF_UNIX = 1
#: By machine: its name in system calls' records, the number of ``socket``, and the numbers of what a stage never needs:
#: looking into other processes, other namespaces and mounts, files by handle, keys, kernel modules and programs, and
#: io_uring, which would go round this filter.
_SYSTEM_CALLS = {
    "x86_64": (
        0xC000003E,
        41,
        (101, 155, 165, 166, 175, 246, 248, 249, 250, 272, 298, 303, 304, 308, 310, 311, 313, 320, 321, 323, 425, 428,
         429, 430, 431, 432, 433, 438, 442),
    ),
    "aarch64": (
        0xC00000B7,
        198,
        (39, 40, 41, 97, 104, 105, 106, 117, 217, 218, 219, 241, 264, 265, 268, 270, 271, 273, 280, 282, 294, 425, 428,
         429, 430, 431, 432, 433, 438, 442),
    ),
}  # fmt: skip
#: Numbers from here on are of x86_64's second set of system calls.
_X32 = 0x40000000


def _filter_calls() -> bool:
    """Refuse this process, and all that it starts, Unix sockets and the system calls that no stage needs.

    Pairs of connected sockets, which lead nowhere else, are left. Returns whether the system can do that.
    """
    if os.uname().machine not in _SYSTEM_CALLS:
        return False
    machine, socket_call, refused = _SYSTEM_CALLS[os.uname().machine]
    # Each instruction: code, steps to skip if true, steps to skip if false, value. The record holds the call's number,
    # the machine and, from byte 16 on, the arguments.
    judge = [
        (_LOAD, 0, 0, 4),
        (_IF_EQUAL, 1, 0, machine),
        (_RETURN, 0, 0, _REFUSE),
        (_LOAD, 0, 0, 0),
        (_IF_AT_LEAST, 0, 1, _X32),
        (_RETURN, 0, 0, _REFUSE),
        (_IF_EQUAL, 0, 3, socket_call),
        (_LOAD, 0, 0, 16),
        (_IF_EQUAL, len(refused) + 2, 0, _AF_UNIX),
        (_RETURN, 0, 0, _ALLOW),
        *((_IF_EQUAL, len(refused) - place, 0, call) for place, call in enumerate(refused)),
        (_RETURN, 0, 0, _ALLOW),
        (_RETURN, 0, 0, _REFUSE),
    ]
    code = b"".join(struct.pack("=HBBI", *instruction) for instruction in judge)
    held = ctypes.create_string_buffer(code, len(code))
    program = struct.pack("@HP", len(judge), ctypes.addressof(held))
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)
    libc = ctypes.CDLL(None, use_errno=True)
    return bool(libc.prctl(_PR_SET_SECCOMP, _SECCOMP_FILTER, ctypes.c_char_p(program), 0, 0) == 0)


def _rights(options: list[str]) -> list[tuple[str, int]]:
    """What the options leave of all files."""
    read = _READ_FILE | _READ_DIR
    write = _ALL_RIGHTS[5] & ~(_EXECUTE | _MAKE_SPECIAL)
    of = {"--program": read | _EXECUTE, "--read": read, "--list": _READ_DIR, "--write": write}
    pairs = [option.partition("=") for option in options]
    return [(path, of[name]) for name, _, path in pairs if name in of]


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
    if "--memory-gb" in options:
        _bound_memory(int(options[options.index("--memory-gb") + 1]))
    if "--offline" in options:
        go_offline()  # before the parent-death signal: gaining a user namespace would clear it
    if "--limited" in options:
        _drop_privileges()
    die_with_parent(int(options[options.index("--parent") + 1]))
    if rights := _rights(options):
        _wall_in(rights)
        _filter_calls()
    os.execv(program[0], program)


if __name__ == "__main__":
    main(sys.argv[1:])
