"""What a job has made, in the formats of others: from its artifacts to one file (`wibam_core.exchange`)."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Self, TypeVar

import cv2

from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.artifacts.artifact import Artifact
from wibam_core.artifacts.catalogue import ARTIFACTS
from wibam_core.documents.exports import BoxSource, ExportOffer
from wibam_core.errors import InputError
from wibam_core.exchange.base import Content, ExchangeFormat, Part
from wibam_core.exchange.registry import FORMATS, format_of
from wibam_core.formats.archive import Member, zip_blocks
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.labels import read_labels
from wibam_core.scene import Vehicles3D
from wibam_core.site import Site

T = TypeVar("T")

#: Quality of frames that leave in the size of the recording: what their second compression takes is not to be seen.
_JPEG_QUALITY = 95
_BLOCK_BYTES = 1 << 20
_BOXES: Mapping[BoxSource, Artifact[list[Vehicles3D]]] = MappingProxyType(
    {BoxSource.FITS: catalogue.FITS, BoxSource.NETWORK: catalogue.PREDICTIONS_FINETUNED}
)


@dataclass(frozen=True)
class ExportSource:
    """What exports are made of.

    Attributes:
        site: the job's site as it was described for the job.
        artifacts: of the job's finished stages.
        labels: the site's hand labels, where there are any.
    """

    site: Site
    artifacts: ArtifactReader
    labels: Path | None = None

    @property
    def parts(self) -> frozenset[Part]:
        """What is there; nothing is read for it."""
        there = {
            Part.CALIBRATION: self.artifacts.has(catalogue.RIG),
            Part.BOXES_2D: self.artifacts.has(catalogue.ANNOTATIONS),
            Part.BOXES_3D: any(self.artifacts.has(artifact) for artifact in _BOXES.values()),
            Part.TRACKS: self.artifacts.has(catalogue.TRACKS),
            Part.LABELS: self.labels is not None,
            Part.ORIGIN: self.site.origin is not None,
            Part.FRAMES: self.artifacts.has(catalogue.FRAMES),
        }
        return frozenset(part for part, is_there in there.items() if is_there)

    def content(self, wanted: Collection[Part], boxes: BoxSource = BoxSource.FITS) -> Content:
        """Read what is wanted and there.

        Raises:
            InvalidLabels: the labels are wanted, and wrong.
            Conflict: another version made what is wanted, and it looked otherwise then.
        """

        def read(part: Part, artifact: Artifact[T]) -> T | None:
            return self.artifacts.read(artifact) if part in wanted and self.artifacts.has(artifact) else None

        frames = read(Part.FRAMES, catalogue.FRAMES)
        split = self.artifacts.read(catalogue.SPLIT) if self.artifacts.has(catalogue.SPLIT) else None
        return Content(
            site=self.site,
            rig=read(Part.CALIBRATION, catalogue.RIG),
            instants=read(Part.BOXES_2D, catalogue.ANNOTATIONS),
            boxes_3d=read(Part.BOXES_3D, _BOXES[boxes]),
            tracks=read(Part.TRACKS, catalogue.TRACKS),
            labels=read_labels(self.labels) if self.labels is not None and Part.LABELS in wanted else None,
            jpeg=None if frames is None else native_jpeg(frames),
            splits={} if split is None else split.times_ns,
            files={
                artifact.id: self.artifacts.local(artifact)
                for artifact in ARTIFACTS.values()
                if self.artifacts.has(artifact) and self.artifacts.local(artifact).is_file()
            },
        )


def offers(source: ExportSource) -> list[ExportOffer]:
    """All formats."""
    parts = source.parts
    found = []
    for fmt in FORMATS.values():
        # a format that needs nothing in particular still needs something that it can hold
        missing = fmt.needs - parts if fmt.needs or fmt.writes & parts else fmt.writes
        names = tuple(sorted(part.value for part in missing))
        found.append(ExportOffer(name=fmt.name, title=fmt.title, loses=fmt.loses, available=not missing, missing=names))
    return found


class Export:
    """One file that is made while its blocks are taken. A context manager: what was written on the way goes in the end.

    Attributes:
        name: of the file.
        size_bytes: None where it is known only when it is whole.
        blocks: its content.
    """

    def __init__(self, fmt: ExchangeFormat, content: Content) -> None:
        self._scratch = tempfile.TemporaryDirectory(prefix="wibam-export-", ignore_cleanup_errors=True)
        try:
            folder = Path(self._scratch.name)
            paths = iter(fmt.write(content, folder))
            first, second = next(paths, None), next(paths, None)
            if first is None:
                raise InputError(
                    f"there is nothing to write as {fmt.title}", hint="The job found nothing that it could hold."
                )
        except BaseException:
            self._scratch.cleanup()
            raise
        self.name = first.name if second is None else f"{fmt.name}.zip"
        self.size_bytes = first.stat().st_size if second is None else None
        self.blocks = _file(first) if second is None else zip_blocks(_members(folder, chain((first, second), paths)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *details: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove what was written, whether or not all blocks were taken."""
        self.blocks.close()
        self._scratch.cleanup()


def open_export(format_name: str, source: ExportSource, boxes: BoxSource = BoxSource.FITS) -> Export:
    """Begin to write a format: its one file, or a zip archive of several.

    Raises:
        NotFound: there is no such format.
        InputError: the format needs what is not there.
        Conflict: another version made what it needs, and it looked otherwise then.
    """
    fmt = format_of(format_name)
    return Export(fmt, source.content(fmt.writes, boxes))


def _file(path: Path) -> Generator[bytes]:
    with path.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            yield block


def _members(folder: Path, paths: Iterable[Path]) -> Iterator[Member]:
    for path in paths:
        yield Member(path.relative_to(folder).as_posix(), path, passing=True)


def native_jpeg(frames: FrameStore) -> Callable[[str, int], bytes]:
    """Frames by camera and their own time, in the size of the recording."""
    instants = {
        (camera_id, frame_time_ns): frame_set.time_ns
        for frame_set in frames.frame_sets
        for camera_id, frame_time_ns in frame_set.frame_times_ns.items()
    }

    def jpeg(camera_id: str, frame_time_ns: int) -> bytes:
        image = frames.image(camera_id, instants[camera_id, frame_time_ns])
        native = cv2.resize(image, tuple(frames.native_size(camera_id)), interpolation=cv2.INTER_LINEAR)
        return bytes(cv2.imencode(".jpg", native, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])

    return jpeg
