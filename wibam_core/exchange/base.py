"""What every exchange format can say of itself and do.

A format is a module of this package with an object that has the attributes and methods of `ExchangeFormat`, or of
`ReadableFormat` where it can be read, and a line in `wibam_core.exchange.registry`. It converts between a file or
folder and a `Content`: our own nouns, in our own units and frames. What a format has no place for is left out on
writing, and said in ``loses``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from wibam_core.errors import InputError
from wibam_core.scene import AnnotatedInstant, CameraRig, LabelledInstant, Track, Vehicles3D
from wibam_core.site import Site


class Part(StrEnum):
    """A kind of content that a format may hold; the origin is where the world lies on Earth."""

    CALIBRATION = "calibration"
    BOXES_2D = "boxes_2d"
    BOXES_3D = "boxes_3d"
    TRACKS = "tracks"
    LABELS = "labels"
    ORIGIN = "origin"
    FRAMES = "frames"

    @property
    def words(self) -> str:
        """For a person."""
        return {"boxes_2d": "2D boxes", "boxes_3d": "3D boxes"}.get(self.value, self.value)


@dataclass(frozen=True, eq=False)
class Content:
    """What is exchanged. A part that is None is not there; one that is empty was looked for and not found.

    Attributes:
        site: its description, for names and for where its origin lies on Earth.
        rig: the calibrated cameras.
        instants: 2D boxes by camera with the vehicles associated among them.
        boxes_3d: 3D boxes at single instants, of fits or of a network; ``camera_id`` says in whose image, if in one's.
        tracks: road users over time.
        labels: boxes made by hand, or true ones.
        images: (camera id, frame time in ns on the reference clock) -> the name of that image elsewhere.
        jpeg: (camera id, frame time) -> that frame as a JPEG file, in the size of the recording.
        splits: "train", "val", "test" -> instants (ns, reference clock).
        files: name -> a file of our own, as it is, for an archive of everything.
        notes: sentences for a person on what reading decided or left out.
    """

    site: Site | None = None
    rig: CameraRig | None = None
    instants: Sequence[AnnotatedInstant] | None = None
    boxes_3d: Sequence[Vehicles3D] | None = None
    tracks: Sequence[Track] | None = None
    labels: Sequence[LabelledInstant] | None = None
    images: Mapping[tuple[str, int], str] = field(default_factory=lambda: MappingProxyType({}))
    jpeg: Callable[[str, int], bytes] | None = None
    splits: Mapping[str, Sequence[int]] = field(default_factory=lambda: MappingProxyType({}))
    files: Mapping[str, Path] = field(default_factory=lambda: MappingProxyType({}))
    notes: tuple[str, ...] = ()

    @property
    def parts(self) -> frozenset[Part]:
        """What is there."""
        there = {
            Part.CALIBRATION: self.rig,
            Part.BOXES_2D: self.instants,
            Part.BOXES_3D: self.boxes_3d,
            Part.TRACKS: self.tracks,
            Part.LABELS: self.labels,
            Part.ORIGIN: None if self.site is None else self.site.origin,
            Part.FRAMES: self.jpeg,
        }
        return frozenset(part for part, value in there.items() if value is not None)

    def image_name(self, camera_id: str, frame_time_ns: int) -> str:
        """What a frame is called: as elsewhere, or ``<camera id>/<frame time in ns>.jpg``, see `parse_image_name`."""
        return self.images.get((camera_id, frame_time_ns), f"{camera_id}/{frame_time_ns}.jpg")

    def size_px(self, camera_id: str) -> tuple[int, int]:
        """Width and height of a camera's images.

        Raises:
            InputError: neither the rig nor the site knows the camera.
        """
        if self.rig is not None and camera_id in self.rig:
            return self.rig[camera_id].width_px, self.rig[camera_id].height_px
        for camera in () if self.site is None else self.site.cameras:
            if camera.id == camera_id:
                return camera.width_px, camera.height_px
        raise InputError(
            f"the size of camera {camera_id}'s images is not known",
            hint="Give the site, or the calibration, with all its cameras.",
            camera=camera_id,
        )


class ExchangeFormat(Protocol):
    """A format of somebody else's.

    Attributes:
        name: what a person types, e.g. ``"coco"``.
        title: for a list, e.g. ``"COCO object detection"``.
        writes: the parts that it can hold; those of `needs` must be there to write it.
        needs: the parts without which it cannot be written.
        loses: one or two sentences: what of our content it has no place for.
    """

    @property
    def name(self) -> str: ...

    @property
    def title(self) -> str: ...

    @property
    def writes(self) -> frozenset[Part]: ...

    @property
    def needs(self) -> frozenset[Part]: ...

    @property
    def loses(self) -> str: ...

    def write(self, content: Content, folder: Path) -> Iterable[Path]:
        """Write files into an empty folder.

        Returns:
            The files, in the order in which a person would open them. They may be written as one goes through them;
            each is whole when it is come to, and may be removed then.

        Raises:
            InputError: the content cannot be written: a part, or where the site lies on Earth, is missing.
        """
        ...


class ReadableFormat(ExchangeFormat, Protocol):
    """A format that can also be read.

    Attributes:
        reads: the parts that `read` can bring in.
    """

    @property
    def reads(self) -> frozenset[Part]: ...

    def read(self, path: Path) -> Content:
        """Read a file or folder.

        Raises:
            InputError: it is not of this format, or holds what cannot be: naming the file and the field.
        """
        ...


#: What ids of cameras look like, as `wibam_core.site.CameraId`.
CAMERA_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_ORIGIN_HINT = "Say in site.json where the world's origin lies on Earth, see docs/site-format.md, and create a new job."

_IMAGE_NAME = re.compile(rf"(?:.*/)?(?P<camera>{CAMERA_ID.pattern})/(?P<time>\d{{1,18}})\.[A-Za-z]{{1,5}}")


def parse_image_name(name: str) -> tuple[str, int] | None:
    """Camera id and frame time (ns) of a name that `Content.image_name` made; None of any other."""
    found = _IMAGE_NAME.fullmatch(name)
    return None if found is None else (found["camera"], int(found["time"]))


def require_parts(fmt: ExchangeFormat, content: Content) -> None:
    """Refuse content that lacks what a format needs.

    Raises:
        InputError: naming the parts.
    """
    missing = sorted(fmt.needs - content.parts)
    if missing:
        raise InputError(
            f"{fmt.title} cannot be written without {' and '.join(part.words for part in missing)}",
            hint=_ORIGIN_HINT if missing == [Part.ORIGIN] else "Let the job run up to the stage that makes it.",
            parts=[part.value for part in missing],
        )
