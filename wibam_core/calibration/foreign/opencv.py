"""OpenCV's YAML, JSON and XML (`cv2.FileStorage`), what scripts dump as JSON or YAML, and ROS's camera_info."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

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
    """YAML with OpenCV's matrices. No calibration has aliases; a few of them can stand for more than memory holds."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not read")
        return super().compose_node(parent, index)


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


def parsed_xml(text: str) -> Mapping[str, Any] | None:
    """The members of an ``opencv_storage``; None where there is none. Files with a document type are not read: what it
    declares could stand for more than memory holds."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text or "<opencv_storage" not in text:
        return None
    try:
        root = ElementTree.fromstring(re.sub(r"\A\s*<\?xml[^>]*\?>", "", text))
    except ElementTree.ParseError:
        return None
    return {child.tag: _value(child) for child in root} if root.tag == "opencv_storage" else None


def _value(element: ElementTree.Element) -> Any:
    """A matrix's numbers, a number, several of them, or text."""
    data = element.find("data")
    words = ((element if data is None else data).text or "").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return " ".join(words).strip('"')
    return numbers[0] if data is None and len(numbers) == 1 else numbers


def _content(text: str) -> Mapping[str, Any] | None:
    return parsed_xml(text) if text.lstrip().startswith("<") else json_object(text) or parsed_yaml(text)


def _recognises(name: str, text: str) -> bool:
    if not name.endswith((".yaml", ".yml", ".json", ".xml")):
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


OPENCV = Reader("OpenCV YAML, JSON or XML", _recognises, _read)
