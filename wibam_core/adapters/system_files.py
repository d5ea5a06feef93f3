"""What of the system's files a confined program of ours needs."""

from __future__ import annotations

import sys
from pathlib import Path

import wibam_core

#: Programs and libraries of the system.
_PROGRAM_FOLDERS = ("/usr", "/lib", "/lib64", "/bin", "/sbin")
#: What libraries look up: themselves, the time zone, fonts, users' names, and the machine.
_SYSTEM_SETTINGS = ("/etc/ld.so.cache", "/etc/localtime", "/etc/timezone", "/etc/fonts", "/etc/passwd", "/etc/group",
                    "/etc/nsswitch.conf", "/etc/mime.types", "/etc/alternatives", "/proc", "/sys")  # fmt: skip
_DEVICES = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom", "/dev/shm")


def system_files() -> list[str]:
    """What a program may use beside its own files, as options of `wibam_core.adapters.confine`."""
    package = Path(wibam_core.__file__).resolve().parent
    libraries = {Path(path).resolve() for path in (*sys.path, sys.prefix, sys.base_prefix) if path}
    libraries.discard(package.parent)  # it may hold anything, where the project is used from a checkout
    program = [*map(str, sorted(libraries)), str(package), *_PROGRAM_FOLDERS]
    devices = [str(path) for path in Path("/dev").glob("nvidia*")]
    return [
        *(f"--program={path}" for path in program),
        *(f"--read={path}" for path in _SYSTEM_SETTINGS),
        *(f"--list={path}" for path in (package.parent,)),
        *(f"--write={path}" for path in (*_DEVICES, *devices)),
    ]
