"""A folder into which recorders put files, each run through a network as it is complete, and noted there."""

from __future__ import annotations

import fcntl
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path, PurePath
from typing import Any

from wibam_core.adapters.stream_recorder import RECORDED, disk_error, is_recorded
from wibam_core.client import WibamClient
from wibam_core.client.views import JobView
from wibam_core.errors import Conflict, InputError, Locked, NotFound
from wibam_core.jobs.states import JobState
from wibam_core.video.name_times import time_in

#: Beside the footage: which files were run, and in which run; and what a program locks while it runs them.
_DONE, _LOCK = ".wibam-watched.json", ".wibam-watched.lock"
_VIDEO = {".mp4", ".mkv", ".mov", ".ts", ".m4v", ".avi", ".webm"}


@dataclass(frozen=True)
class Arrived:
    """A complete file of a camera, and when it began."""

    camera: str
    path: Path
    started: datetime


class WatchedFolder:
    """A folder, and what was run of it, which is noted there.

    Args:
        folder: with a folder for each camera.
        client, model_id, site_id, options: what files are run with.
        say: told what a person should know.
        check: called again and again while a run is waited for; what it raises ends the waiting.

    Raises:
        InputError: the notes cannot be read.
        OSError: the same, by the disk.
    """

    def __init__(
        self,
        folder: Path,
        client: WibamClient,
        model_id: str,
        site_id: str,
        options: dict[str, Any],
        say: Callable[[str], None],
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self._folder, self._client, self._say, self._check = folder, client, say, check
        self._model_id, self._site_id, self._options = model_id, site_id, options
        self._done = _read(folder)
        self._written = dict(self._done)
        self._said_unclear: set[str] = set()

    def run_all(self, quiet_s: float, utc_offset: timedelta) -> None:
        """Run what has arrived, one after the other. Files whose names say no time are left, and said once.

        Raises:
            WibamError: one could not be run: it is tried again, since files of a camera are run in order.
            OSError: something in the folder cannot be read or written.
        """
        self._settle()
        for arrived in arrivals(self._folder, set(self._done), quiet_s, utc_offset, time.time(), self._unclear):
            name = _name(self._folder, arrived.path)
            try:
                noted = self._run(arrived, name)
            except FileNotFoundError:  # there was no room for it any more
                continue
            self._done[name] = noted
            self._settle()
            said = f": {noted['failed']}" if "failed" in noted else ""
            self._say(f"{name}: {noted['run']}{said}")

    def _unclear(self, error: InputError) -> None:
        if error.message not in self._said_unclear:
            self._said_unclear.add(error.message)
            self._say(f"{error.message}. {error.hint}")

    def _run(self, arrived: Arrived, name: str) -> dict[str, Any]:
        """Send one file and wait for its run; who is in view at its beginning keeps the id of the run before."""
        started = arrived.started.isoformat(timespec="milliseconds")
        run = self._begin(arrived, self._sent(arrived, started), name)
        ended = self._client.wait(run.id, check=self._check, interval_s=2.0)
        noted = {"run": run.id, "camera": arrived.camera, "model": self._model_id, "started": started}
        if ended.state is JobState.SUCCEEDED:
            return noted
        return noted | {"failed": f"it was {ended.state}" if ended.error is None else ended.error.message}

    def _begin(self, arrived: Arrived, file_id: str, name: str) -> JobView:
        """The run of a file, which this program may have begun before it was ended."""
        options = hashlib.sha256(json.dumps(self._options, sort_keys=True).encode()).hexdigest()[:16]

        def begin(continues: str | None) -> JobView:
            return self._client.create_run(
                self._model_id,
                [file_id],
                self._options,
                continues=continues,
                name=name,
                idempotency_key=f"{self._model_id}-{file_id}-{options}",
            )

        latest = self._latest(arrived.camera)
        if latest is not None and _time(latest) < arrived.started:
            try:
                return begin(latest["run"])
            except (Conflict, NotFound):  # somebody has deleted it since, or restarted it
                self._say(f"{name}: nothing is left of run {latest['run']} to go on with")
        return begin(None)

    def _sent(self, arrived: Arrived, started: str) -> str:
        """The file's id at the service, to which it may have been sent before this program was ended."""
        size = arrived.path.stat().st_size
        there = self._client.footage(
            self._site_id, arrived.camera, (arrived.started, arrived.started + timedelta(milliseconds=1))
        )
        for one in there:
            if (one.filename, one.size_bytes) == (arrived.path.name, size):
                return one.id
        return self._client.upload_footage(self._site_id, arrived.camera, arrived.path, started)

    def _latest(self, camera: str) -> dict[str, Any] | None:
        """Of the camera's runs of this model that went well, the latest one."""
        return self._latest_ones().get((camera, self._model_id))

    def _latest_ones(self) -> dict[tuple[str, str], dict[str, Any]]:
        """Of each camera's runs of each model that went well, the latest one."""
        well = [one for one in self._done.values() if "failed" not in one]
        return {(one["camera"], one["model"]): one for one in sorted(well, key=_time)}

    def _settle(self) -> None:
        """Write the notes, then remove what was recorded here and is noted: no file goes before it is noted.

        Of what was recorded and is gone the notes keep what the next run needs alone.
        """
        latest = {one["run"] for one in self._latest_ones().values()}
        self._done = {
            name: one
            for name, one in self._done.items()
            if one["run"] in latest or not is_recorded(Path(name)) or (self._folder / name).exists()
        }
        if self._done != self._written:
            _write(self._folder, self._done)
            self._written = dict(self._done)
        for name in self._done:
            if is_recorded(Path(name)):
                (self._folder / name).unlink(missing_ok=True)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other programs of this kind out of a folder until the block ends, however it ends.

    Raises:
        Locked: another one is there.
        DiskFull, InputError: the folder cannot be written.
    """
    try:
        file = (folder / _LOCK).open("a")
    except OSError as error:
        raise disk_error(folder, error) from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Locked(
                f"another `wibam watch` is at work in {folder}", hint="Stop it first, or name another folder."
            ) from None
        yield


def arrivals(
    folder: Path,
    done: set[str],
    quiet_s: float,
    utc_offset: timedelta,
    now: float,
    unclear: Callable[[InputError], None],
) -> list[Arrived]:
    """Complete files that were not run yet, by time, then by camera.

    Files that are recorded here get their names when they are complete; of others it is told by their not growing.

    Args:
        folder: with a folder for each camera.
        done: their names below the folder.
        quiet_s: a file that has grown lately may grow on.
        utc_offset: of the times in the names.
        now: Unix seconds.
        unclear: told of each file whose name does not say when it began; it is left out.
    """
    found = []
    for path in sorted([*folder.glob("*/*"), *folder.glob(f"*/{RECORDED}/*")]):
        if path.suffix.lower() not in _VIDEO or path.name.startswith(".") or _name(folder, path) in done:
            continue
        try:
            facts = path.stat()
            if path.is_file() and facts.st_size and (is_recorded(path) or now - facts.st_mtime >= quiet_s):
                camera = path.relative_to(folder).parts[0]
                found.append(Arrived(camera, path, began(path.name, utc_offset)))
        except OSError:  # it has been removed meanwhile, or is a link to what has
            continue
        except InputError as error:
            unclear(error)
    return sorted(found, key=lambda one: (one.started, one.camera, one.path.name))


def began(name: str, utc_offset: timedelta) -> datetime:
    """When a file began, as its name says; one with a Z after its time is in UTC, whatever the offset of the others.

    Raises:
        InputError: it does not.
    """
    found = time_in(PurePath(name).stem)
    if found is None:
        raise InputError(
            f"the name {name!r} does not say when the file began",
            hint="Let the recorder write the time into it, like 2026-07-01_08-00-00.mp4.",
        )
    began, is_utc = found
    return began if is_utc else began - utc_offset


def _time(noted: Mapping[str, Any]) -> datetime:
    return datetime.fromisoformat(str(noted["started"]))


def _name(folder: Path, path: Path) -> str:
    return path.relative_to(folder).as_posix()


def _read(folder: Path) -> dict[str, dict[str, Any]]:
    try:
        return dict(json.loads((folder / _DONE).read_text(encoding="utf-8")))
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise InputError(
            f"{folder / _DONE} cannot be read: {error}", hint="Remove it to run all files of the folder again."
        ) from error


def _write(folder: Path, done: dict[str, dict[str, Any]]) -> None:
    partial = folder / f"{_DONE}.tmp"
    partial.write_text(json.dumps(done, indent=1), encoding="utf-8")
    partial.replace(folder / _DONE)
