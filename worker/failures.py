"""What went wrong around a stage, as an error that a person can act on."""

from __future__ import annotations

import errno
import sqlite3

from sqlalchemy.exc import DBAPIError

from wibam_core.errors import DiskFull, StageCrashed, StageError, StageOutOfMemory
from worker.process import StageProcess

_POSTGRESQL_DISK_FULL = "53100"


def crash(stage: str, process: StageProcess, *, system_killed: bool) -> StageError:
    """The process has ended without a result.

    Args:
        stage: which.
        process: it has ended.
        system_killed: the system has killed processes for lack of memory meanwhile.
    """
    code = process.process.returncode
    tail = list(process.tail)
    if code == -9 and system_killed:
        return StageOutOfMemory(f"the system killed the stage {stage} for lack of memory", log_tail=tail)
    how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}, without a result"
    return StageCrashed(f"the stage {stage} {how}", exit_code=code, log_tail=tail)


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
