"""``rig.json``: the calibrated cameras of a site.

.. code-block:: json

    {"format": "wibam-rig", "version": 1, "cameras": [
        {"id": "north", "width_px": 1920, "height_px": 1080, "K": [[...], [...], [0, 0, 1]], "dist": [],
         "T_world_cam": [[...], [...], [...]]}, ...]}

``T_world_cam`` is the 3x4 matrix [R|t] with ``x_world = R x_cam + t`` (m). The first camera is the reference. A camera
with a wide lens also has ``lens`` ("fisheye" or "omnidirectional"), ``xi`` and ``views``: the pinhole views that are
cut from its picture, each ``{"id", "width_px", "height_px", "K", "R_cam_view"}`` with ``x_cam = R_cam_view x_view``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pydantic
from pydantic import BaseModel, ConfigDict, Field

from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.cut_view import CutView
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import CameraRig
from wibam_core.site import Lens

Row3 = tuple[float, float, float]
Row4 = tuple[float, float, float, float]


class _View(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    id: str = Field(min_length=1)
    width_px: int = Field(gt=0)
    height_px: int = Field(gt=0)
    K: tuple[Row3, Row3, Row3]
    R_cam_view: tuple[Row3, Row3, Row3]


class _Camera(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    id: str = Field(min_length=1)
    width_px: int = Field(gt=0)
    height_px: int = Field(gt=0)
    K: tuple[Row3, Row3, Row3]
    dist: tuple[float, ...]
    T_world_cam: tuple[Row4, Row4, Row4]
    lens: Lens = "pinhole"
    xi: float = 0.0
    views: tuple[_View, ...] = ()


class _Rig(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["wibam-rig"] = "wibam-rig"
    version: Literal[1] = 1
    cameras: tuple[_Camera, ...] = Field(min_length=1)

    @pydantic.model_validator(mode="after")
    def _unique_ids(self) -> _Rig:
        ids = [camera.id for camera in self.cameras] + [view.id for camera in self.cameras for view in camera.views]
        if len(set(ids)) != len(ids):
            raise ValueError(f"camera ids must differ: {ids}")
        return self


def write_rig(path: Path, rig: CameraRig) -> None:
    """Write a rig. Floats are written so that reading gives the same bits."""
    cameras = []
    for camera_id, camera in rig.mounted.items():
        entry: dict[str, Any] = {
            "id": camera_id,
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "K": camera.K.tolist(),
            "dist": camera.dist.tolist(),
            "T_world_cam": camera.T_world_cam.matrix[:3].tolist(),
        }
        if camera.is_wide:
            entry |= {"lens": camera.lens, "xi": camera.xi, "views": [_view(v) for v in rig.views.get(camera_id, ())]}
        cameras.append(entry)
    document = _Rig.model_validate({"format": "wibam-rig", "version": 1, "cameras": cameras})
    path.write_text(document.model_dump_json(indent=1, exclude_unset=True) + "\n", encoding="utf-8")


def _view(view: CutView) -> dict[str, Any]:
    return {
        "id": view.id,
        "width_px": view.width_px,
        "height_px": view.height_px,
        "K": view.K.tolist(),
        "R_cam_view": view.R_cam_view.tolist(),
    }


def read_rig(path: Path) -> CameraRig:
    """Read a rig.

    Raises:
        CalibrationError: if the file is missing, malformed, or holds no proper cameras (e.g. a mirrored rotation).
    """
    try:
        document = _Rig.model_validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise CalibrationError(f"{path.name} does not exist", hint="Run the calibrate stage first.") from error
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise CalibrationError(
            f"{path.name} is no camera rig: {where}: {first['msg']}", hint="Use the rig.json of the calibrate stage."
        ) from error
    cameras, views = {}, {}
    for entry in document.cameras:
        try:
            pose = SE3.from_matrix(np.array(entry.T_world_cam))
            size_px = entry.width_px, entry.height_px
            camera = Camera(np.array(entry.K), np.array(entry.dist), pose, *size_px, entry.lens, entry.xi)
            cut = [CutView(v.id, np.array(v.R_cam_view), np.array(v.K), v.width_px, v.height_px) for v in entry.views]
            cameras[entry.id] = camera
        except ValueError as error:
            raise CalibrationError(f"{path.name}: camera {entry.id}: {error}", camera=entry.id) from error
        if cut and not camera.is_wide:
            raise CalibrationError(f"{path.name}: camera {entry.id} has views, but no wide lens", camera=entry.id)
        if cut:
            views[entry.id] = tuple(cut)
    return CameraRig(cameras, views)
