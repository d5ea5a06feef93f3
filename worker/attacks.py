"""What a stage could do that was taken over by a hostile recording, tried out: ``python -m worker.attacks``.

The attacks are made by a program that is confined as every stage is, against files, sockets and processes that are
made for this alone. The exit status is 0 where none succeeds.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from wibam_core.adapters import confine
from worker.process import LogLine, StageProcess

#: Name of an attack -> what it would mean.
ATTACKS: Mapping[str, str] = {
    "read_upload": "read a file of another job",
    "write_data": "write into the data folder",
    "leave_link": "leave a link to a file of another job among its outputs",
    "read_environment": "read the worker's secrets from its environment",
    "read_memory": "read the worker's memory",
    "reach_network": "connect to a service on this machine",
    "enter_network": "enter the worker's network",
    "reach_socket": "connect to Redis by its Unix socket",
    "signal_worker": "send the worker a signal",
    "mount": "change what is mounted, in a namespace of its own",
    "gain_privileges": "start a program with more privileges",
}

_PROGRAM = """
import ctypes, json, os, socket, sys
target = json.loads(sys.argv[1])
libc = ctypes.CDLL(None, use_errno=True)

def connected(family, address):
    with socket.socket(family) as one:
        one.settimeout(5)
        one.connect(address)

def succeeded(call, *arguments):
    if getattr(libc, call)(*arguments) != 0:
        raise OSError(ctypes.get_errno(), call)

def enter(path):
    with open(path) as namespace:
        succeeded("setns", namespace.fileno(), 0)

def privileged():
    lines = dict(line.split(":\\t", 1) for line in open("/proc/self/status").read().splitlines() if ":\\t" in line)
    if lines["NoNewPrivs"].strip() == "1" and int(lines["CapPrm"], 16) == 0:
        raise PermissionError("none to be had")

ATTACKS = {
    "read_upload": lambda: open(target["upload"]).read(),
    "write_data": lambda: open(target["data"] + "/written", "w").close(),
    "leave_link": lambda: os.symlink(target["upload"], target["home"] + "/link"),
    "read_environment": lambda: open(f"/proc/{target['worker']}/environ", "rb").read(),
    "read_memory": lambda: open(f"/proc/{target['worker']}/mem", "rb").close(),
    "reach_network": lambda: connected(socket.AF_INET, ("127.0.0.1", target["port"])),
    "enter_network": lambda: enter(f"/proc/{target['worker']}/ns/net"),
    "reach_socket": lambda: connected(socket.AF_UNIX, target["socket"]),
    "signal_worker": lambda: os.kill(target["worker"], 0),
    "mount": lambda: succeeded("unshare", 0x20000),  # a mount namespace; a mount itself would outlast the attack
    "gain_privileges": privileged,
}
for name, attack in ATTACKS.items():
    try:
        attack()
        kept_out = False
    except (OSError, KeyError):
        kept_out = True
    print(json.dumps([name, kept_out]), flush=True)
"""


def kept_out() -> dict[str, bool]:
    """Whether this system keeps a stage from each of `ATTACKS`."""
    confine.keep_secrets()  # as a worker does
    with contextlib.ExitStack() as stack:
        data = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        home = data / "home"
        home.mkdir()
        upload = data / "upload"
        upload.write_text("somebody else's")
        tcp = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        unix = stack.enter_context(socket.socket(socket.AF_UNIX))
        unix.bind(str(data / "redis.sock"))
        unix.listen()
        target = {
            "upload": str(upload),
            "data": str(data),
            "home": str(home),
            "worker": os.getpid(),
            "port": tcp.getsockname()[1],
            "socket": str(data / "redis.sock"),
        }
        program = [sys.executable, "-c", _PROGRAM, json.dumps(target)]
        process = StageProcess.confined(program, home=home, cache=home, nice=0, reads=[home])
        stack.callback(process.close)
        found: dict[str, bool] = {}
        while True:
            ended = process.ended
            for message in process.poll(0.1):
                if isinstance(message, LogLine) and message.text.startswith("["):
                    name, held = json.loads(message.text)
                    found[name] = held
            if ended and process.quiet:
                return {name: found.get(name, False) for name in ATTACKS}


def report(held: Mapping[str, bool]) -> str:
    """What holds on this system, in lines for a person."""
    lines = [f"{'kept out ' if held[name] else 'SUCCEEDS '} {what}" for name, what in ATTACKS.items()]
    if all(held.values()):
        lines.append("A stage sees what it is given, and nothing else.")
    else:
        lines += [
            "This system cannot keep stages from all of that. It takes Linux 6.12 or newer with Landlock and seccomp,",
            "and network namespaces (as root, or with unprivileged user namespaces). Take uploads from people whom you",
            "trust alone.",
        ]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Say what holds on this system; 0 if everything does."""
    held = kept_out()
    sys.stdout.write(report(held))
    return int(not all(held.values()))


if __name__ == "__main__":
    sys.exit(main())
