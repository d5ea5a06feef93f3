"""How the published WIBAM data set is laid out.

::

    wibam/calib/calibration_{cam}.npz      camera_matrix, dist_coefs, rvec, tvec: OpenCV's, world to camera
    wibam/annotations/wibam_all.json       images and 2D boxes, see `Dataset`
    wibam/annotations/hand_labels/         see `wibam_core.exchange.wibam.hand_labels`
    wibam/frames/{cam}/{frame}.jpg
    wibam/image_sets/{train,val,test}.txt  an instant a line: the id of the first camera's image

Ids of one instant's images follow each other over the cameras. A frame's number counts periods of 80 ms. 2D boxes are
x, y, width, height from the corner of the image. ``obj_id`` says which boxes of an instant show one vehicle. Classes
have nuScenes' names and numbers.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from wibam_core.traits import NUSCENES_CLASSES

PERIOD_NS = 80_000_000
SUBSETS = ("train", "val", "test")
#: Width and height of the published frames.
SIZE_PX = (1920, 1080)


def _flat(value: Any) -> Any:
    """OpenCV's columns and rows, [[a], [b], [c]] or [[a, b, c]], as one list."""
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        return [number for row in value for number in row]
    return value


_Three = Annotated[tuple[float, float, float], BeforeValidator(_flat)]


class Image(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    id: int = Field(ge=0, le=2**53)
    file_name: str = Field(max_length=500)
    cam: int = Field(ge=0, lt=32)
    width: int | None = Field(default=None, gt=0, le=16384)
    height: int | None = Field(default=None, gt=0, le=16384)
    P: Annotated[tuple[float, ...], BeforeValidator(_flat), Field(min_length=9, max_length=9)]
    dist_coefs: Annotated[tuple[float, ...], BeforeValidator(_flat), Field(max_length=14)] = ()
    rvec: _Three
    tvec: _Three

    @property
    def first_id(self) -> int:
        """Of the instant's image of camera 0: what an instant is known by."""
        return self.id - self.cam


class Annotation(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    image_id: int
    bbox: tuple[float, float, Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]]
    category_id: int
    score: float = Field(default=1.0, ge=0, le=1)
    obj_id: int | None = Field(default=None, ge=0, lt=2**31)


class Category(BaseModel):
    id: int
    name: str = Field(max_length=100)


class Dataset(BaseModel):
    images: tuple[Image, ...] = Field(min_length=1)
    annotations: tuple[Annotation, ...]
    categories: tuple[Category, ...] = tuple(Category(id=i, name=name) for i, name in enumerate(NUSCENES_CLASSES, 1))
