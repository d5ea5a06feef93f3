"""What went wrong around a stage, as an error that a person can act on."""

from __future__ import annotations

import errno
import signal
import sqlite3

from sqlalchemy.exc import DBAPIError

from wibam_core.errors import DiskFull, StageCrashed, StageError, StageOutOfMemory
from worker.process import StageProcess

_POSTGRESQL_DISK_FULL = "53100"


def crash(stage: str, process: StageProcess, *, attempt: int, system_killed: bool) -> StageError:
    """The process has ended without a result.

    Args:
        stage: which.
        process: it has ended.
        attempt: how often the stage was begun.
        system_killed: the system has killed processes for lack of memory meanwhile.
    """
    code = process.process.returncode
    tail = list(process.tail)
    if code >= 0:
        return StageCrashed(
            f"the stage {stage} ended with exit code {code}, without a result", exit_code=code, log_tail=tail
        )
    so_often = f", in attempt {attempt}" if attempt > 1 else ""
    if code == -signal.SIGKILL and system_killed:
        message = f"the system killed the stage {stage} for lack of memory{so_often}"
        return StageOutOfMemory(message, exit_code=code, log_tail=tail)
    message = f"the stage {stage} was killed by signal {-code} ({_signal_name(-code)}){so_often}"
    return StageCrashed(message, exit_code=code, log_tail=tail)


def was_killed(process: StageProcess) -> bool:
    """A signal has ended it."""
    return process.process.returncode < 0


def system_error(stage: str, error: OSError) -> StageError:
    """The operating system refused something to the worker."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return no_space(stage)
    return StageCrashed(f"the stage {stage} could not be run: {error}")


def no_space(stage: str) -> DiskFull:
    return DiskFull(f"no space left for the stage {stage}")


def is_full(error: DBAPIError) -> bool:
    """The database refused a write because its disk is full."""
    cause = error.orig
    if isinstance(cause, sqlite3.Error):
        return getattr(cause, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    return getattr(cause, "sqlstate", None) == _POSTGRESQL_DISK_FULL


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a real-time one
        return "no common one"
