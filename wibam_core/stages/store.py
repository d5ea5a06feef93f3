"""Stage outputs on disk: content-addressed folders, written aside and published by one rename."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from wibam_core.artifacts.access import MANIFEST
from wibam_core.documents.manifest import FileFacts, Manifest
from wibam_core.documents.warnings import StageWarning
from wibam_core.stages.base import Summary

#: Which outputs belong together: those of the latest run.
_LATEST = "latest.json"
_ADDRESS = re.compile(r"(\w+)-([0-9a-f]{32})")


@dataclass(frozen=True)
class Attempt:
    """One run of a stage.

    Attributes:
        stage, hash, frame_hash: as in `wibam_core.stages.graph.PlannedStage`.
        output: where it alone writes.
        scratch: outlives it until the stage is published.
        earlier: published outputs of the same frame hash, the newest first. Each may be removed at any time.
    """

    stage: str
    hash: str
    frame_hash: str | None
    output: Path
    scratch: Path
    earlier: tuple[Path, ...]


class StageStore:
    """Published stage outputs under ``root``: ``<stage>-<first half of the hash>/`` with a manifest of its files."""

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self._partial = self.root / ".partial"
        self._scratch = self.root / ".scratch"

    def _folder(self, stage: str, hash: str) -> Path:
        return self.root / f"{stage}-{hash[:32]}"

    def find(self, stage: str, hash: str) -> Path | None:
        """The published folder of a stage, or None."""
        folder = self._folder(stage, hash)
        return folder if (folder / MANIFEST).is_file() else None

    def manifest(self, stage: str, hash: str) -> Manifest:
        """What is known about a published stage."""
        return Manifest.model_validate_json((self._folder(stage, hash) / MANIFEST).read_bytes())

    def remember(self, hashes: Mapping[str, str]) -> None:
        """Note which outputs, by stage, the latest run of all stages is about."""
        self.root.mkdir(parents=True, exist_ok=True)
        partial = self.root / f".{_LATEST}-{secrets.token_hex(8)}"
        partial.write_text(json.dumps(dict(hashes), indent=1), encoding="utf-8")
        partial.replace(self.root / _LATEST)

    def remembered(self) -> dict[str, str]:
        """Stage -> hash of what the latest run is about; nothing where there was none."""
        try:
            found = json.loads((self.root / _LATEST).read_bytes())
        except FileNotFoundError:
            return {}
        return {str(stage): str(hash) for stage, hash in found.items()}

    @contextlib.contextmanager
    def turn(self, hash: str, waiting: Callable[[], None]) -> Iterator[None]:
        """Among processes that make the same stage: one at a time, since they share its scratch folder.

        Args:
            hash: of the stage.
            waiting: called where another process is at it; then this waits for as long as that takes.
        """
        self.root.mkdir(parents=True, exist_ok=True)
        with (self.root / ".lock").open("wb") as lock:
            own_byte = (1, int(hash[:15], 16))  # length and place: locked, it need not be there
            try:
                fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB, *own_byte)
            except BlockingIOError:
                waiting()
                fcntl.lockf(lock, fcntl.LOCK_EX, *own_byte)
            yield

    def begin(self, stage: str, hash: str, frame_hash: str | None = None) -> Attempt:
        """A fresh output folder, with the scratch folder that an earlier attempt at the same stage may have left."""
        self._partial.mkdir(parents=True, exist_ok=True)
        scratch = self._scratch / f"{stage}-{hash[:32]}"
        scratch.mkdir(parents=True, exist_ok=True)
        output = Path(tempfile.mkdtemp(prefix=_prefix(stage, hash), dir=self._partial))
        output.chmod(0o755)
        earlier = () if frame_hash is None else tuple(self._with_frame_hash(stage, frame_hash))
        return Attempt(stage, hash, frame_hash, output, scratch, earlier)

    def temporary(self, attempt: Attempt) -> tempfile.TemporaryDirectory[str]:
        """A folder for whatever an attempt needs only while it runs. Where it was killed, `sweep` removes it."""
        prefix = _prefix(attempt.stage, attempt.hash)
        return tempfile.TemporaryDirectory(prefix=prefix, dir=self._partial, ignore_cleanup_errors=True)

    def seal(self, attempt: Attempt, summary: Summary, seconds: float, warnings: Sequence[StageWarning] = ()) -> None:
        """Write the manifest of a finished attempt, with the digests of its files. Takes as long as reading them.

        Once it returns, the output would survive a power cut.
        """
        write_manifest(attempt.output, attempt.stage, attempt.hash, summary, seconds, warnings, attempt.frame_hash)
        for path in (*attempt.output.rglob("*"), attempt.output):
            if path.is_file() or path.is_dir():
                _sync(path)

    def reveal(self, attempt: Attempt) -> Path:
        """Make a sealed attempt's output visible at its address, by one rename. Of two that raced, the first stays."""
        folder = self._folder(attempt.stage, attempt.hash)
        try:
            attempt.output.rename(folder)
        except OSError:
            if self.find(attempt.stage, attempt.hash) is None:
                self._drop(folder)  # without a manifest it is nobody's output
                attempt.output.rename(folder)
        _sync(self.root)
        return folder

    def publish(
        self, attempt: Attempt, summary: Summary, seconds: float, warnings: Sequence[StageWarning] = ()
    ) -> Path:
        """Seal and reveal an attempt, and drop its scratch."""
        self.seal(attempt, summary, seconds, warnings)
        folder = self.reveal(attempt)
        self.discard(attempt)  # of two that raced, the second is still there
        self.drop_scratch(attempt)
        return folder

    def drop_scratch(self, attempt: Attempt) -> None:
        """Remove what a later attempt could have resumed from."""
        shutil.rmtree(attempt.scratch, ignore_errors=True)

    def discard(self, attempt: Attempt) -> None:
        """Remove an attempt's output; its scratch stays for the next attempt."""
        shutil.rmtree(attempt.output, ignore_errors=True)

    def sweep(self, running: Callable[[], Collection[str]]) -> None:
        """Remove the output of attempts that were killed.

        Args:
            running: the hashes of all stages that are being made; asked after the attempts were listed, so that
                one that begins meanwhile is left alone.
        """
        attempts = list(self._partial.iterdir()) if self._partial.is_dir() else []
        alive = {hash[:8] for hash in running()} if attempts else set()
        for folder in attempts:
            if folder.name.split("-")[1] not in alive:
                shutil.rmtree(folder, ignore_errors=True)

    def remove(self, stage: str, hash: str) -> None:
        """Forget a stage, so that it runs again, and from its beginning. The first half of the hash will do."""
        self._drop(self._scratch / f"{stage}-{hash[:32]}")
        self._drop(self._folder(stage, hash))

    def addresses(self) -> set[tuple[str, str]]:
        """Stage and first half of the hash of everything that is published, or has scratch."""
        folders = [path for root in (self.root, self._scratch) if root.is_dir() for path in root.iterdir()]
        return _addresses_of(folders)

    def addresses_with(self, stage: str, frame_hash: str) -> set[tuple[str, str]]:
        """Those of them that are published and hold the same of each frame."""
        return _addresses_of(self._with_frame_hash(stage, frame_hash))

    def _with_frame_hash(self, stage: str, frame_hash: str) -> list[Path]:
        """Published outputs that hold the same of each frame, the newest first."""
        found = []
        for folder in self.root.glob(f"{stage}-*"):
            path = folder / MANIFEST
            try:
                if Manifest.model_validate_json(path.read_bytes()).frame_hash == frame_hash:
                    found.append((path.stat().st_mtime_ns, folder))
            except (OSError, ValidationError):
                continue  # no output, or one that is being removed
        return [folder for _, folder in sorted(found, reverse=True)]

    def _drop(self, folder: Path) -> None:
        """Remove a folder: at once for everybody, also if this process is killed before the last file is gone."""
        self._partial.mkdir(parents=True, exist_ok=True)
        aside = self._partial / f"removed-{secrets.token_hex(8)}"
        with contextlib.suppress(FileNotFoundError):
            folder.rename(aside)
            shutil.rmtree(aside, ignore_errors=True)  # `sweep` tries again


def write_manifest(
    folder: Path,
    stage: str,
    hash: str,
    summary: Summary,
    seconds: float,
    warnings: Sequence[StageWarning] = (),
    frame_hash: str | None = None,
) -> None:
    """Write the manifest of a folder that holds all of a stage's outputs."""
    files = {
        path.relative_to(folder).as_posix(): FileFacts(bytes=path.stat().st_size, sha256=sha256_of(path))
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    manifest = Manifest(
        stage=stage,
        hash=hash,
        frame_hash=frame_hash,
        seconds=round(seconds, 3),
        summary=summary,
        warnings=tuple(warnings),
        files=files,
    )
    (folder / MANIFEST).write_text(manifest.model_dump_json(indent=1), encoding="utf-8")


def _addresses_of(folders: Iterable[Path]) -> set[tuple[str, str]]:
    return {(found[1], found[2]) for folder in folders if (found := _ADDRESS.fullmatch(folder.name))}


def sha256_of(path: Path) -> str:
    """SHA-256 (hex) of a file, read in pieces."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _prefix(stage: str, hash: str) -> str:
    return f"{stage}-{hash[:8]}-"


def _sync(path: Path) -> None:
    """Return once a file, or which names a folder has, would survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
