"""The parts of an OpenLABEL file that are read, as models; what else a file holds is passed over."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from wibam_core.exchange.base import Part

#: The coordinate system of our world; no camera's id has a dot.
WORLD = "site.world"
#: Times beyond do not fit into int nanoseconds.
_LATEST_NS = 2**62


#: Of a place, a size or a pixel: far beyond all that are measured, and far below what overflows when they are added.
Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]


def _listed(value: Any) -> Any:
    """TUM Traffic has one cuboid where the standard has a list, and an empty object where there is none."""
    return ([value] if value else []) if isinstance(value, dict) else value


def _flat(value: Any) -> Any:
    """Matrices are lists of numbers; some write lists of rows."""
    has_rows = isinstance(value, list) and bool(value) and all(isinstance(row, list) for row in value)
    return [number for row in value for number in row] if has_rows else value


class _Model(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)


class Num(_Model):
    name: str = ""
    val: float


class Vec(_Model):
    name: str = ""
    val: tuple[float | str, ...]


class Text(_Model):
    name: str = ""
    val: str


class Attributes(_Model):
    num: tuple[Num, ...] = ()
    vec: tuple[Vec, ...] = ()
    text: tuple[Text, ...] = ()

    def number(self, name: str) -> float | None:
        return next((n.val for n in self.num if n.name == name), None)

    def numbers(self, name: str, count: int) -> list[float] | None:
        """A vector of ``count`` numbers."""
        found = next((v.val for v in self.vec if v.name == name), ())
        return [float(v) for v in found] if len(found) == count and all(isinstance(v, float) for v in found) else None

    def word(self, name: str) -> str | None:
        return next((t.val for t in self.text if t.name == name), None)


class Cuboid(_Model):
    coordinate_system: str | None = None
    val: tuple[Coordinate, ...] | None = Field(min_length=9, max_length=10)
    attributes: Attributes = Attributes()


class Bbox(_Model):
    coordinate_system: str | None = None
    val: tuple[Coordinate, Coordinate, Coordinate, Coordinate]
    attributes: Attributes = Attributes()


class ObjectData(Attributes):
    type: str | None = None
    cuboid: Annotated[tuple[Cuboid, ...], BeforeValidator(_listed)] = ()
    bbox: Annotated[tuple[Bbox, ...], BeforeValidator(_listed)] = ()


class FrameObject(_Model):
    object_data: ObjectData = ObjectData()


class FrameStreamProperties(_Model):
    time_ns: int | None = Field(default=None, ge=-_LATEST_NS, le=_LATEST_NS)


class FrameStream(_Model):
    uri: str = ""
    stream_properties: FrameStreamProperties = FrameStreamProperties()


class FrameProperties(_Model):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False)

    timestamp: Decimal | None = Field(default=None, ge=-_LATEST_NS // 10**9, le=_LATEST_NS // 10**9)
    time_ns: int | None = Field(default=None, ge=-_LATEST_NS, le=_LATEST_NS)
    camera_id: str | None = None
    streams: dict[str, FrameStream] = {}

    @property
    def file_names(self) -> str:
        """All that further fields say, among it the names of the frame's images and point clouds."""
        return " ".join(str(value) for value in (self.model_extra or {}).values())


class Frame(_Model):
    frame_properties: FrameProperties = FrameProperties()
    objects: dict[str, FrameObject] = {}


class Object(_Model):
    type: str


class Pose(_Model):
    matrix4x4: Annotated[tuple[Coordinate, ...], BeforeValidator(_flat)] | None = Field(
        default=None, min_length=16, max_length=16
    )
    quaternion: tuple[Coordinate, Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0, 1.0)
    translation: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)


class CoordinateSystem(_Model):
    parent: str = ""
    pose_wrt_parent: Pose | None = None


class Pinhole(_Model):
    camera_matrix: Annotated[tuple[Coordinate, ...], BeforeValidator(_flat)] = Field(min_length=9, max_length=12)
    distortion_coeffs: Annotated[tuple[Coordinate, ...], BeforeValidator(_flat)] = Field(default=(), max_length=14)
    width_px: int = Field(gt=0, le=16384)
    height_px: int = Field(gt=0, le=16384)


class StreamProperties(_Model):
    intrinsics_pinhole: Pinhole | None = None


class Stream(_Model):
    type: str = ""
    stream_properties: StreamProperties = StreamProperties()


class Metadata(_Model):
    wibam_part: Part | None = None


class Scene(_Model):
    metadata: Metadata = Metadata()
    coordinate_systems: dict[str, CoordinateSystem] = {}
    streams: dict[str, Stream] = {}
    frames: dict[str, Frame] = {}
    objects: dict[str, Object] = {}


class SceneFile(_Model):
    openlabel: Scene
