"""OpenCV's YAML and JSON (`cv2.FileStorage`), what scripts dump as JSON or YAML, and ROS's camera_info."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from wibam_core.calibration.foreign.base import FoundCamera, Intrinsics, Reader, first, json_object, matrix, vector
from wibam_core.errors import InputError
from wibam_core.site import Lens

_K = ("cameramatrix", "k", "mtx", "m1", "intrinsicmatrix", "intrinsics", "intrinsic")
_DIST = ("distortioncoefficients", "distcoeffs", "distcoefs", "d", "d1", "dist", "distortion")
_MODELS: Mapping[str, Lens] = {
    "plumb_bob": "pinhole",
    "rational_polynomial": "pinhole",
    "thin_prism": "pinhole",
    "pinhole": "pinhole",
    "equidistant": "fisheye",
    "fisheye": "fisheye",
    "omnidirectional": "omnidirectional",
    "omnidir": "omnidirectional",
    "mei": "omnidirectional",
}


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices."""


def _plain_mapping(loader: yaml.SafeLoader, suffix: str, node: yaml.Node) -> Any:
    assert isinstance(node, yaml.MappingNode)
    return loader.construct_mapping(node, deep=True)


_Loader.add_multi_constructor("tag:yaml.org,2002:opencv-", _plain_mapping)


def parsed_yaml(text: str) -> Mapping[str, Any] | None:
    """The mapping that a YAML file holds, OpenCV's included; None where it holds anything else."""
    try:
        found = yaml.load(re.sub(r"\A%YAML:1\.\d\s*\n", "", text), Loader=_Loader)  # a safe loader
    except yaml.YAMLError:
        return None
    return found if isinstance(found, dict) else None


def _content(text: str) -> Mapping[str, Any] | None:
    return json_object(text) or parsed_yaml(text)


def _recognises(name: str, text: str) -> bool:
    if not name.endswith((".yaml", ".yml", ".json")):
        return False
    content = _content(text)
    return content is not None and first(content, _K) is not None


def _read(text: str) -> Sequence[FoundCamera]:
    content = _content(text)
    assert content is not None
    dist = vector(first(content, _DIST), "the distortion")
    xi = first(content, ("xi",))
    lens = _lens(content, xi)
    if lens == "pinhole" and dist.size == 14 and not dist[12:].any():
        dist = dist[:12]
    width, height = first(content, ("imagewidth", "width")), first(content, ("imageheight", "height"))
    size = first(content, ("imagesize", "resolution"))
    if width is None and isinstance(size, list | tuple) and len(size) == 2:
        width, height = size
    intrinsics = Intrinsics(
        matrix(first(content, _K), 3, 3, "the camera matrix"),
        dist,
        lens,
        float(vector(xi, "xi")[0]) if xi is not None else 0.0,
        None if width is None or height is None else (int(width), int(height)),
    )
    rvec, tvec = first(content, ("rvec", "rotationvector")), first(content, ("tvec", "translationvector"))
    if rvec is None or tvec is None or np.size(vector(rvec, "rvec")) != 3:
        return [FoundCamera(intrinsics=intrinsics)]
    pose = matrix(rvec, 3, 1, "rvec").ravel(), matrix(tvec, 3, 1, "tvec").ravel()
    return [FoundCamera("", intrinsics, *pose, notes=("rvec and tvec are taken as world to camera, in metres.",))]


def _lens(content: Mapping[str, Any], xi: Any) -> Lens:
    model = first(content, ("distortionmodel", "cameramodel", "lens"))
    if isinstance(model, str):
        if model.lower() not in _MODELS:
            raise InputError(f"the lens model {model!r} is not known", hint=f"Known are {', '.join(_MODELS)}.")
        return _MODELS[model.lower()]
    if xi is not None:
        return "omnidirectional"
    return "fisheye" if first(content, ("fisheyemodel",)) else "pinhole"


OPENCV = Reader("OpenCV YAML or JSON", _recognises, _read)
