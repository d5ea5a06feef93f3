"""Stage outputs on disk: content-addressed folders, written aside and published by one rename."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wibam_core.stages.base import Summary

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class Attempt:
    """Where one run of a stage writes: ``output`` is its own; ``scratch`` outlives it until the stage is published."""

    stage: str
    digest: str
    output: Path
    scratch: Path


class StageStore:
    """Published stage outputs under ``root``: ``<stage>-<first half of the hash>/`` with a manifest of its files."""

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self._partial = self.root / ".partial"
        self._scratch = self.root / ".scratch"

    def _folder(self, stage: str, digest: str) -> Path:
        return self.root / f"{stage}-{digest[:32]}"

    def find(self, stage: str, digest: str) -> Path | None:
        """The published folder of a stage, or None."""
        folder = self._folder(stage, digest)
        return folder if (folder / MANIFEST).is_file() else None

    def manifest(self, stage: str, digest: str) -> dict[str, Any]:
        """``{"stage", "digest", "summary", "seconds", "files": {name: {"bytes", "sha256"}}}`` of a published stage."""
        manifest: dict[str, Any] = json.loads((self._folder(stage, digest) / MANIFEST).read_bytes())
        return manifest

    def begin(self, stage: str, digest: str) -> Attempt:
        """A fresh output folder, with the scratch folder that an earlier attempt at the same stage may have left."""
        self._partial.mkdir(parents=True, exist_ok=True)
        scratch = self._scratch / f"{stage}-{digest[:32]}"
        scratch.mkdir(parents=True, exist_ok=True)
        output = Path(tempfile.mkdtemp(prefix=f"{stage}-{digest[:8]}-", dir=self._partial))
        output.chmod(0o755)
        return Attempt(stage, digest, output, scratch)

    def seal(self, attempt: Attempt, summary: Summary, seconds: float) -> None:
        """Write the manifest of a finished attempt, with the digests of its files. Takes as long as reading them."""
        files = {
            path.relative_to(attempt.output).as_posix(): {"bytes": path.stat().st_size, "sha256": sha256_of(path)}
            for path in sorted(attempt.output.rglob("*"))
            if path.is_file()
        }
        manifest = {
            "stage": attempt.stage,
            "digest": attempt.digest,
            "seconds": round(seconds, 3),
            "summary": summary,
            "files": files,
        }
        with (attempt.output / MANIFEST).open("w") as file:
            json.dump(manifest, file, indent=1, allow_nan=False)
            file.flush()
            os.fsync(file.fileno())

    def reveal(self, attempt: Attempt) -> Path:
        """Make a sealed attempt's output visible at its address, by one rename. Of two that raced, the first stays."""
        folder = self._folder(attempt.stage, attempt.digest)
        try:
            attempt.output.rename(folder)
        except OSError:
            if self.find(attempt.stage, attempt.digest) is None:
                raise
        return folder

    def publish(self, attempt: Attempt, summary: Summary, seconds: float) -> Path:
        """Seal and reveal an attempt, and drop its scratch."""
        self.seal(attempt, summary, seconds)
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
        alive = {digest[:8] for digest in running()} if attempts else set()
        for folder in attempts:
            if folder.name.split("-")[1] not in alive:
                shutil.rmtree(folder, ignore_errors=True)

    def remove(self, stage: str, digest: str) -> None:
        """Forget a stage, so that it runs again, and from its beginning."""
        shutil.rmtree(self._scratch / f"{stage}-{digest[:32]}", ignore_errors=True)
        folder = self.find(stage, digest)
        if folder is not None:
            (folder / MANIFEST).unlink()
            shutil.rmtree(folder)


def sha256_of(path: Path) -> str:
    """SHA-256 (hex) of a file, read in pieces."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
