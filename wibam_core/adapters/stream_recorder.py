"""Recording a camera's stream for months into a folder: connecting again and again, in bounded space."""

from __future__ import annotations

import errno
import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from wibam_core.adapters.camera_stream import SILENCE_S, StreamAddress, StreamLost, StreamRefused, open_stream
from wibam_core.errors import DiskFull, InputError, WibamError
from wibam_core.video.chunks import SUFFIX, Chunk, ChunkCutter, recovered

#: In a camera's folder, for what is recorded here: all in it is ours to remove, whatever others write beside it.
RECORDED = "wibam-recorded"
#: Pauses before a camera is tried again: at first, and at most. A refused password is not tried more often: cameras
#: lock users out who do so.
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 60.0
#: All room is for so many files at least, so that removing the oldest leaves others.
_FILES_AT_LEAST = 4
_OURS = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d\.\d{3}Z" + re.escape(SUFFIX))


def is_recorded(path: Path) -> bool:
    """Whether a complete file was recorded here, by where it is and by its name."""
    return path.parent.name == RECORDED and _OURS.fullmatch(path.name) is not None


def disk_error(folder: Path, error: OSError) -> WibamError:
    """What a person can do about a folder in which something went wrong."""
    said = str(error.strerror or error).lower()
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return DiskFull(f"{folder} cannot be written: {said}", hint="Free space there; it is tried again.")
    return InputError(f"{folder} cannot be used: {said}", hint="Look at the disk and at who may write to the folder.")


class StreamRecorder:
    """Records one stream in a thread of its own until it is stopped: files in a folder, and words for a person.

    A stream that breaks, ends or falls silent is connected to again, after pauses that double up to a minute. What is
    missing meanwhile is missing: files say when they began, and how long they are. Where files wait for longer than
    there is room, the oldest is removed. A stream that was never readable in this folder, and is refused at once, ends
    the recording; later refusals, as of a camera that is starting, are waited out.

    Args:
        address: of the stream.
        folder: of the camera; it is made, and within it one for the files (`RECORDED`).
        chunk_s: how long a file is, about.
        most_bytes: that files which wait may take, with the one that is being written.
        say: told what a person should know, from the thread.
        silence_s: a stream that is silent for so long is gone.
        first_pause_s: before a lost stream is tried again.
    """

    def __init__(
        self,
        address: StreamAddress,
        folder: Path,
        chunk_s: float,
        most_bytes: int,
        say: Callable[[str], None],
        silence_s: float = SILENCE_S,
        first_pause_s: float = _FIRST_PAUSE_S,
    ) -> None:
        self._address, self._camera, self._folder = address, folder.name, folder / RECORDED
        self._chunk_s, self._most_bytes, self._silence_s = chunk_s, most_bytes, silence_s
        self._first_pause_s = self._pause_s = first_pause_s
        self._say = say
        self._stop = threading.Event()
        self._failed: BaseException | None = None
        self._ever_read = self._folder.is_dir()
        self._is_read = False
        self._lost_at: float | None = None
        self._said = ""
        folder.mkdir(parents=True, exist_ok=True)
        recovered(self._folder)
        self._thread = threading.Thread(target=self._run, name=f"stream {folder.name}", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Raises what ended the recording.

        Raises:
            StreamRefused: the stream was never readable, and does not become so by waiting. It was said, too.
        """
        if self._failed is not None:
            raise self._failed

    def stop(self) -> None:
        """End the recording; the file that is being written is completed."""
        self._stop.set()
        self._thread.join()

    # --- in the thread -------------------------------------------------------------------------
    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                try:
                    self._record()
                except StreamRefused as error:
                    is_first = not self._ever_read and self._lost_at is None
                    self._lost(error)
                    if is_first:
                        raise
                    self._pause_s = _LONGEST_PAUSE_S
                except WibamError as error:
                    self._lost(error)
                except OSError as error:  # the disk's: all that the stream says are errors of ours
                    self._lost(disk_error(self._folder, error))
                self._stop.wait(self._pause_s)
                self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)
        except BaseException as error:  # it is the reader's to deal with
            self._failed = error

    def _record(self) -> None:
        """Record until the stream is lost or somebody stops it."""
        cutter = ChunkCutter(self._folder, self._chunk_s, _unix_ns, self._keep, self._most_bytes // _FILES_AT_LEAST)
        with open_stream(self._address, self._silence_s) as packets, cutter:
            self._folder.mkdir(exist_ok=True)
            self._ever_read = True
            for one in packets:
                cutter.add(one.packet, one.stream, one.arrived_ns)
                if cutter.writing and not self._is_read:
                    self._found()
                if self._stop.is_set():
                    return
                if cutter.overdue:
                    raise StreamLost(
                        f"{self._address} has hardly any key frames", hint="Set the camera to one in every few seconds."
                    )
                if cutter.frozen:
                    raise StreamLost(
                        f"the stamps of {self._address} hardly move", hint="Restart the camera, or renew its software."
                    )

    def _keep(self, chunk: Chunk) -> None:
        """Make room for a complete file, and for the next one, which is about to be written."""
        self._pause_s = self._first_pause_s
        most_bytes = self._most_bytes - self._most_bytes // _FILES_AT_LEAST
        sizes: dict[Path, int] = {}
        for path in sorted(path for path in self._folder.iterdir() if is_recorded(path)):
            with suppress(FileNotFoundError):  # somebody was done with it meanwhile
                sizes[path] = path.stat().st_size
        for path in [*sizes][:-1]:
            if sum(sizes.values()) <= most_bytes:
                return
            path.unlink(missing_ok=True)
            del sizes[path]
            self._say(f"{self._camera}/{path.name} was removed: files wait for longer than there is room")

    def _found(self) -> None:
        if self._lost_at is not None:
            self._say(f"{self._address} is back after {time.monotonic() - self._lost_at:.0f} s")
        else:
            self._say(f"{self._address} is being recorded")
        self._is_read, self._lost_at = True, None

    def _lost(self, error: WibamError) -> None:
        """Say why, unless it is what was said last."""
        self._is_read = False
        if self._lost_at is None:
            self._lost_at, self._said = time.monotonic(), ""
        if error.message != self._said:
            self._said = error.message
            self._say(f"{error.message}. {error.hint}".strip())


def _unix_ns(monotonic_ns: int) -> int:
    """Unix time of a time of the clock that is never set, by what is known of it now."""
    return time.time_ns() - time.monotonic_ns() + monotonic_ns
