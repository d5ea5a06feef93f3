"""Stages whose outputs a site brings along: they are taken as they are, and never run.

A site folder may hold ``given/<stage>/``: the artifacts of that stage and a manifest, as the store keeps them. The
stage's address is then the hash of these files; what comes after it runs as ever.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wibam_core.artifacts.access import MANIFEST, ArtifactWriter
from wibam_core.errors import SiteFileError
from wibam_core.stages.base import Summary
from wibam_core.stages.graph import STAGES
from wibam_core.stages.store import sha256_of, write_manifest

FOLDER = "given"


def given_stages(site_dir: Path) -> dict[str, Path]:
    """Stage -> folder with its outputs, of all that a site brings along.

    Raises:
        SiteFileError: a folder has the name of no stage, or lacks what that stage makes.
    """
    root = site_dir / FOLDER
    folders = {path.name: path for path in sorted(root.iterdir()) if path.is_dir()} if root.is_dir() else {}
    for name, folder in folders.items():
        if name not in STAGES:
            raise SiteFileError(
                f"{FOLDER}/{name} is given, but there is no stage {name!r}", hint=f"Stages are {', '.join(STAGES)}."
            )
        needed = [artifact.file for artifact in STAGES[name].writes if not artifact.optional]
        missing = [file for file in (*needed, MANIFEST) if not (folder / file).exists()]
        if missing:
            raise SiteFileError(
                f"{FOLDER}/{name} is given, but lacks {', '.join(missing)}",
                hint="Import the site again, or remove the folder so that the stage runs.",
                stage=name,
            )
    return folders


def digest_of(folder: Path) -> str:
    """SHA-256 (hex) of all files of a folder and their names, the manifest aside."""
    files = {
        path.relative_to(folder).as_posix(): path
        for path in folder.rglob("*")
        if path.is_file() and path.relative_to(folder).as_posix() != MANIFEST
    }
    whole = hashlib.sha256()
    for name in sorted(files):
        whole.update(f"{name}\0{sha256_of(files[name])}\0".encode())
    return whole.hexdigest()


@contextmanager
def giving(site_dir: Path, stage: str, summary: Summary) -> Iterator[ArtifactWriter]:
    """Write what a stage would have made into a site folder.

    Args:
        site_dir: the site's.
        stage: which; nothing may be given for it yet.
        summary: what the stage would have said, JSON types only.

    Returns:
        A context manager with the writer; on leaving it without an error, the manifest follows.
    """
    folder = site_dir / FOLDER / stage
    folder.mkdir(parents=True)
    yield ArtifactWriter(stage, folder, STAGES[stage].writes)
    write_manifest(folder, stage, digest_of(folder), summary, 0.0)
