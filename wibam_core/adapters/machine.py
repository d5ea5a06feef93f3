"""The machine that this process runs on, as far as it says how long stages take."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from wibam_core.costs import Machine


@cache
def this_machine() -> Machine:
    """Its cores and its processor; how fast they are, it does not say."""
    try:
        flags = Path("/proc/cpuinfo").read_text()
    except OSError:  # another system than Linux
        flags = ""
    return Machine(len(os.sched_getaffinity(0)), "avx512_bf16" in flags)
