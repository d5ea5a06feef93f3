"""Where the recordings lie in a site folder, and what several files of one camera are called together."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from wibam_core.errors import MissingCamera, SiteFileError
from wibam_core.site import SiteCamera
from wibam_core.text import nfc
from wibam_core.video.recording import Recording, RecordingFile

_PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".dng", ".heic")
#: What cameras write beside their recordings: thumbnails, previews of low resolution, positions, subtitles, sound and
#: lists of their own; and what people and systems put there.
_BESIDE = (
    *_PICTURES,
    *(".thm", ".lrv", ".lrf", ".gpx", ".kml", ".kmz", ".fit", ".nmea", ".wav", ".mp3", ".m4a", ".aac", ".flac"),
    *(".srt", ".vtt", ".ass", ".ssa", ".sub", ".idx", ".cpi", ".mpl", ".bdm", ".ctg", ".sav"),
    *(".txt", ".md", ".log", ".json", ".csv", ".xml", ".db", ".ini", ".html", ".pdf", ".md5", ".sha256"),
)


def find_recording(folder: Path, camera_id: str, listed: Sequence[str] = ()) -> Recording | None:
    """A camera's recording in a folder ``recordings/``; None where there is none.

    It is one file, ``<camera id>.<anything>`` or ``<camera id>``, or several in a folder ``<camera id>/``, of which all
    count, or those that the site lists.

    Raises:
        SiteFileError: there are several files, and no folder or list says that they belong together.
        MissingCamera: a file that the site lists is not there.
    """
    own = folder / camera_id
    if listed:
        return Recording(tuple(_listed(folder, camera_id, name) for name in sorted(listed)))
    named = [*folder.glob(f"{camera_id}.*"), own]
    single = sorted(path for path in named if path.is_file() and not _is_beside(path))
    if own.is_dir():
        inside = sorted(path for path in own.iterdir() if path.is_file() and not _is_beside(path))
        if inside and single:
            raise _ambiguous(camera_id, [*single, *inside])
        if inside:
            return Recording.at(*inside)
    if len(single) > 1:
        raise _ambiguous(camera_id, single)
    return Recording.at(single[0]) if single else None


def check_elsewhere(folder: Path, camera_id: str) -> None:
    """Say where the recording lies that a camera needs and has none of by `find_recording`.

    Raises:
        SiteFileError: one lies deeper or under the id in other letters, or there are pictures alone.
    """
    own = folder / camera_id
    deeper = sorted(path for path in own.glob("*/**/*") if path.is_file() and not _is_beside(path))
    if deeper:
        raise SiteFileError(
            f"camera {camera_id} has no recording in {own.name}/, but deeper: {deeper[0].relative_to(own)}",
            hint=f"Move its files into recordings/{camera_id}/ itself.",
            camera=camera_id,
        )
    others = sorted(folder.iterdir()) if folder.is_dir() else []
    for path in others:
        named = path.name.split(".")[0]
        if named != camera_id and named.strip().lower() == camera_id.lower() and not _is_beside(path):
            raise SiteFileError(
                f"camera {camera_id} has no recording, but there is {path.name!r}",
                hint=f"Call it {camera_id}{path.name[len(named) :]}: letter case and blanks count.",
                camera=camera_id,
            )
    inside = sorted(own.iterdir()) if own.is_dir() else []
    pictures = [path for path in (*inside, *folder.glob(f"{camera_id}.*")) if path.suffix.lower() in _PICTURES]
    if pictures:
        raise SiteFileError(
            f"camera {camera_id} has no recording, but pictures: {pictures[0].name}"
            + (f" and {len(pictures) - 1} more" if len(pictures) > 1 else ""),
            hint="Make one video file of them, with the time of each: pictures by themselves do not say when they were "
            "taken.",
            camera=camera_id,
        )


def unclaimed(folder: Path, cameras: Sequence[SiteCamera]) -> tuple[str, ...]:
    """Names of files and folders in ``recordings/`` that are no camera's, as of one that was called otherwise."""
    claimed = {name for camera in cameras for name in (camera.id, *camera.recordings)}
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    return tuple(
        path.name
        for path in found
        if not _is_beside(path)
        and nfc(path.name) not in claimed
        and not any(path.is_file() and path.name.startswith(f"{camera.id}.") for camera in cameras)
    )


def digest_of(files: Iterable[tuple[str, str]]) -> str:
    """What a recording's content is known by: the SHA-256 of its file, or one over names and those of several.

    Args:
        files: name and SHA-256 (hex) of each.
    """
    ordered = sorted(files)
    if len(ordered) == 1:
        return ordered[0][1]
    return hashlib.sha256(json.dumps(ordered).encode()).hexdigest()


def digest_of_recording(files: Iterable[tuple[str, str, int | None]]) -> str:
    """The same where it also counts when each file began, if that is known of all of them.

    Args:
        files: name and SHA-256 (hex) of each, and `RecordingFile.started_ns`.
    """
    known = sorted(files, key=lambda file: file[:2])
    if any(started is None for *_, started in known):
        return digest_of((name, sha256) for name, sha256, _ in known)
    return hashlib.sha256(json.dumps(known).encode()).hexdigest()


def _is_beside(path: Path) -> bool:
    return path.name.startswith(".") or path.suffix.lower() in _BESIDE


def _listed(folder: Path, camera_id: str, name: str) -> RecordingFile:
    for inside in (folder / camera_id, folder):
        others = sorted(inside.iterdir()) if inside.is_dir() else []
        for path in (inside / name, *(other for other in others if nfc(other.name) == name)):
            if path.is_file():
                return RecordingFile(path, name)
    raise MissingCamera(
        f"{name}, a recording of camera {camera_id}, is not there",
        hint=f"Put it into recordings/{camera_id}/, or take it off the site's list.",
        camera=camera_id,
        file=name,
    )


def _ambiguous(camera_id: str, paths: list[Path]) -> SiteFileError:
    return SiteFileError(
        f"camera {camera_id} has several recordings: {', '.join(path.name for path in paths)}",
        hint=f"Leave one of them in the folder, or put all parts of one recording into recordings/{camera_id}/.",
        camera=camera_id,
    )
