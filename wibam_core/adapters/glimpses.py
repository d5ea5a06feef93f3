"""Short looks into uploaded files, each in a confined process of its own (`wibam_core.adapters.glimpse`)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

import wibam_core
from wibam_core.adapters import confine
from wibam_core.adapters.system_files import system_files
from wibam_core.config import EvaluateConfig
from wibam_core.documents.conflicts import Conflicts
from wibam_core.errors import InputError, InvalidWeights, ServiceUnavailable, UnreadableVideo, WibamError
from wibam_core.site import Origin, SignalRegion, SiteCamera

_INHERITED = ("PATH", "LANG", "LC_ALL", "TZ", "LD_LIBRARY_PATH", "VIRTUAL_ENV")

Look = Literal["header", "frame", "signals", "network", "map", "comparison", "calibration", "conflicts"]

#: Looks that are given so many times as long. Who looks at a network imports torch first, which takes seconds, on a
#: busy machine many; who compares two goes through all that they found.
_SLOWER, _TIMES_SLOWER = ("network", "comparison", "conflicts"), 4

#: What to do where a look takes too long.
_TOO_SLOW: dict[Look, str] = {
    "header": "Try again later.",
    "frame": "Try again later.",
    "signals": "Ask for a shorter stretch.",
    "network": "Try again later.",
    "map": "Send a smaller picture, of the intersection alone.",
    "comparison": "Try again later.",
    "calibration": "Send those of one camera alone.",
    "conflicts": "Take the table as CSV.",
}

#: GiB that a look may ask for. A picture of `map_pictures.MOST_PIXELS` takes up to 1.8. Those that run networks ask for
#: more than they use.
_MEMORY_GB = {"map": 4, "calibration": 4, "conflicts": 4}


class ComparisonInputs(BaseModel):
    """What two networks are compared by (`wibam_core.evaluation.comparison`).

    Attributes:
        first: stage -> its outputs, of the one network's job. second: of the other's, whose cameras and annotations
            both are judged by.
        labels: by hand.
        config: how they are judged.
        known: classes that both know.
        cautions: what makes it less than fair.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    first: dict[str, Path]
    second: dict[str, Path]
    labels: Path | None
    config: EvaluateConfig
    known: tuple[str, ...]
    cautions: tuple[str, ...]

    @property
    def reads(self) -> tuple[Path, ...]:
        """All that the process may read."""
        labels = () if self.labels is None else (self.labels,)
        return (*self.first.values(), *self.second.values(), *labels)


class ForeignFile(BaseModel):
    """A file of another program, as text; ``name`` helps to tell its format."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    text: str


class ForeignCalibration(BaseModel):
    """Files that together describe one camera.

    Attributes:
        camera: as the site has it.
        files: of other programs.
        names: what files with several cameras call this one, beside its id.
        origin: of the site.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    camera: SiteCamera
    files: tuple[ForeignFile, ...]
    names: tuple[str, ...] = ()
    origin: Origin | None = None


class ReviewedConflicts(BaseModel):
    """A table of conflicts that is to become a PDF file (`wibam_core.report.conflict_table`).

    Attributes:
        heading: the name of the job. about: what else tells which it is.
        conflicts: of the job.
        reviews: conflict id -> verdict and note; None for a table without them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    heading: str
    about: str
    conflicts: Conflicts
    reviews: dict[int, tuple[str, str]] | None


class GlimpseRequest(BaseModel):
    """What to look for.

    Attributes:
        look: "header", the "frame" at a time, or the "signals" of a stretch; of a file of weights the "network"; of a
            picture from above the "map"; of two networks' jobs their "comparison"; of files on standard input
            (`ForeignCalibration`) the "calibration"; of `ReviewedConflicts` on standard input their "conflicts" as a
            table, which holds no file's but users' words.
        path: of the file, the service's own; None: there is none.
        start_ns: on the recording's clock. duration_ns: of the stretch.
        width_px: the frame is no wider.
        comparison: what it is made of.
        regions: of signals.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    look: Look
    path: Path | None = None
    start_ns: int = 0
    duration_ns: int = 0
    width_px: int | None = None
    regions: tuple[SignalRegion, ...] = ()
    comparison: ComparisonInputs | None = None

    @property
    def reads(self) -> tuple[Path, ...]:
        """All that the process may read."""
        own = () if self.path is None else (self.path,)
        return (*own, *(() if self.comparison is None else self.comparison.reads))

    @property
    def file(self) -> Path:
        """Of what is in a file."""
        if self.path is None:
            raise ValueError(f"a look of the kind {self.look} needs a file")
        return self.path


class Glimpses:
    """Looks into recordings, a few at a time. Tables are made one at a time beside them, so that a long one keeps
    nobody from looking at a frame.

    Args:
        at_once: how many processes may run, beside the one that makes a table.
        patience_s: a look that takes longer is given up.
    """

    def __init__(self, at_once: int = 2, patience_s: float = 60.0) -> None:
        self._places = threading.BoundedSemaphore(at_once)
        self._table_place = threading.BoundedSemaphore(1)
        self._patience_s = patience_s

    def look(self, request: GlimpseRequest, given: bytes = b"") -> tuple[dict[str, Any], bytes]:
        """What `wibam_core.adapters.glimpse.main` answers; ``given`` is its standard input.

        Raises:
            WibamError: whatever the process says is wrong with the recording.
            ServiceUnavailable: too many looks are under way, or this one takes too long.
        """
        is_table = request.look == "conflicts"
        places = self._table_place if is_table else self._places
        if not places.acquire(timeout=self._patience_s / 2):
            busy = "the service makes another table" if is_table else "the service looks into other recordings"
            raise ServiceUnavailable(busy, hint="Try again in a moment.")
        patience_s = self._patience_s * (_TIMES_SLOWER if request.look in _SLOWER else 1)
        program = [sys.executable, "-P", "-m", "wibam_core.adapters.glimpse", request.model_dump_json()]
        try:
            with TemporaryDirectory(prefix="wibam-look-") as own:  # matplotlib insists on a folder that it may write to
                done = subprocess.run(
                    confined(request, program, own),
                    input=given,
                    capture_output=True,
                    timeout=patience_s,
                    env={**_environment(request), "MPLCONFIGDIR": own},
                    check=False,
                )
        except subprocess.TimeoutExpired as error:
            late = {
                "calibration": "the files were not read",
                "comparison": "the two networks were not compared",
                "conflicts": "the table was not made",
            }.get(request.look, "the file was not read")
            raise ServiceUnavailable(f"{late} within {patience_s:g} s", hint=_TOO_SLOW[request.look]) from error
        finally:
            places.release()
        head, _, rest = done.stdout.partition(b"\n")
        try:
            answer = json.loads(head)
        except ValueError:
            if request.look == "network":
                raise InvalidWeights("the file could not be read as a network") from None
            if request.look == "calibration":
                raise InputError(
                    "the files could not be read as a calibration", hint="Send those of one camera alone."
                ) from None
            if request.look == "comparison":
                raise InputError("the two networks could not be compared", hint="Restart their jobs.") from None
            if request.look == "conflicts":
                raise ServiceUnavailable("the table could not be made", hint=_TOO_SLOW["conflicts"]) from None
            if request.look == "map":
                raise InputError(
                    "the picture could not be decoded", hint="Save it as PNG or JPEG, of the intersection alone."
                ) from None
            raise UnreadableVideo(
                "the recording could not be decoded", hint="Upload it again, or convert it to H.264."
            ) from None
        if "error" in answer:
            raise WibamError.from_dict(answer["error"])
        return answer["header"], rest


def confined(request: GlimpseRequest, program: list[str], own: str | None = None) -> list[str]:
    """A command that runs a program with no more rights than a look needs; ``own`` is a folder that it may write to."""
    shim = [sys.executable, "-I", "-S", confine.__file__, "--parent", str(os.getpid()), "--nice", "5"]
    reads = [*system_files(), *(f"--read={path.resolve()}" for path in request.reads)]
    writes = [] if own is None or request.look != "conflicts" else [f"--write={own}"]
    memory = ["--memory-gb", str(_MEMORY_GB[request.look])] if request.look in _MEMORY_GB else []
    return [*shim, "--offline", "--expendable", "--limited", *memory, *reads, *writes, "--", *program]


def _environment(request: GlimpseRequest) -> dict[str, str]:
    """Without our secrets."""
    # OpenBLAS asks for memory for each core beforehand
    few_threads = {"OPENBLAS_NUM_THREADS": "1"} if request.look in _MEMORY_GB else {}
    kept = {name: os.environ[name] for name in _INHERITED if name in os.environ}
    return {
        **kept,
        **few_threads,
        "PYTHONPATH": str(Path(wibam_core.__file__).resolve().parent.parent),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
