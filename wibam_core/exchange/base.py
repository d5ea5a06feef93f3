"""What every exchange format can say of itself and do.

A format is a module of this package with an object that has the attributes and methods of `ExchangeFormat`, and a line
in `wibam_core.exchange.registry`. It converts between a file or folder and a `Content`: our own nouns, in our own
units and frames. What a format has no place for is left out on writing, and said in ``loses``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from wibam_core.errors import InputError
from wibam_core.scene import AnnotatedInstant, CameraRig, LabelledInstant, Track, Vehicles3D
from wibam_core.site import Site


class Part(StrEnum):
    """A kind of content that a format may hold."""

    CALIBRATION = "calibration"
    BOXES_2D = "boxes_2d"
    BOXES_3D = "boxes_3d"
    TRACKS = "tracks"
    LABELS = "labels"


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
        splits: "train", "val", "test" -> instants (ns, reference clock).
    """

    site: Site | None = None
    rig: CameraRig | None = None
    instants: Sequence[AnnotatedInstant] | None = None
    boxes_3d: Sequence[Vehicles3D] | None = None
    tracks: Sequence[Track] | None = None
    labels: Sequence[LabelledInstant] | None = None
    images: Mapping[tuple[str, int], str] = field(default_factory=lambda: MappingProxyType({}))
    splits: Mapping[str, Sequence[int]] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def parts(self) -> frozenset[Part]:
        """What is there."""
        there = {
            Part.CALIBRATION: self.rig,
            Part.BOXES_2D: self.instants,
            Part.BOXES_3D: self.boxes_3d,
            Part.TRACKS: self.tracks,
            Part.LABELS: self.labels,
        }
        return frozenset(part for part, value in there.items() if value is not None)


class ExchangeFormat(Protocol):
    """A format of somebody else's.

    Attributes:
        name: what a person types, e.g. ``"coco"``.
        title: for a list, e.g. ``"COCO object detection"``.
        writes: the parts that it can hold; those of `needs` must be there to write it.
        needs: the parts without which it cannot be written.
        reads: the parts that `read` can bring in; empty for a format that is only written.
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
    def reads(self) -> frozenset[Part]: ...

    @property
    def loses(self) -> str: ...

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """Write files into an empty folder.

        Returns:
            The files, in the order in which a person would open them.

        Raises:
            InputError: the content cannot be written: a part, or where the site lies on Earth, is missing.
        """
        ...

    def read(self, path: Path) -> Content:
        """Read a file or folder.

        Raises:
            InputError: it is not of this format, or holds what cannot be: naming the file and the field.
        """
        ...


def require_parts(fmt: ExchangeFormat, content: Content) -> None:
    """Refuse content that lacks what a format needs.

    Raises:
        InputError: naming the parts.
    """
    missing = sorted(part.value for part in fmt.needs - content.parts)
    if missing:
        raise InputError(
            f"{fmt.title} needs {' and '.join(missing).replace('_', ' ')}, which is not there",
            hint="Let the job run up to the stage that makes it.",
            parts=missing,
        )
