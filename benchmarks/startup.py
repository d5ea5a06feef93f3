"""How long commands and the API take until they can do anything: the CPU time of loading what they import.

    python benchmarks/startup.py

Every command is asked for its help, which imports its module; the application of the API is made, and must do without
torch. CPU seconds (user and system) of the whole process, the least of three, beside those of an interpreter that does
nothing.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile

_COMMANDS = ("", "run", "demo", "serve", "upload", "sites", "jobs", "tracks", "export", "import", "simulate", "track")
_API = """
import sys
from pathlib import Path
from api.main import create_app
from wibam_core.adapters.database import sqlite_url
from wibam_core.adapters.settings import ServiceSettings
folder = Path(sys.argv[1])
url = f"redis+socket://{folder}/none.sock"
database = sqlite_url(folder / "wibam.db")
create_app(ServiceSettings(data_dir=folder, database_url=database, broker_url=url, token_sha256="0" * 64))
assert "torch" not in sys.modules
"""


def cpu_s(command: list[str], repetitions: int = 3) -> float:
    """The least CPU time (s) of a program that must succeed."""

    def once() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    return min(once() for _ in range(repetitions))


def main() -> None:
    nothing_s = cpu_s([sys.executable, "-c", ""])
    rows = {"python -c ''": nothing_s}
    for name in _COMMANDS:
        rows[f"wibam {name} --help".replace("  ", " ")] = cpu_s(
            [sys.executable, "-c", "from wibam_core.cli import main; main()", *name.split(), "--help"]
        )
    with tempfile.TemporaryDirectory() as folder:
        rows["the API"] = cpu_s([sys.executable, "-c", _API, folder])
    for title, seconds in rows.items():
        print(f"{title:<24} {seconds:5.2f} s  {seconds / nothing_s:5.1f} x")


if __name__ == "__main__":
    main()
