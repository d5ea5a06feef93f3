"""OpenCV's YAML, JSON and XML (`cv2.FileStorage`), what scripts dump as JSON or YAML, and ROS's camera_info."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

from wibam_core.calibration.foreign.base import (
    Array,
    FoundCamera,
    Intrinsics,
    Reader,
    first,
    json_object,
    matrix,
    vector,
)
from wibam_core.errors import InputError
from wibam_core.geometry.se3 import SE3
from wibam_core.site import Lens

_K = ("cameramatrix", "k", "mtx", "m1", "intrinsicmatrix", "intrinsics", "intrinsic")
_DIST = ("distortioncoefficients", "distcoeffs", "distcoefs", "distcoeff", "d", "d1", "dist", "distortion")
#: Distortion number by number, in OpenCV's order, and of its fisheye.
_ONE_BY_ONE, _OF_FISHEYE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), ("k1", "k2", "k3", "k4")
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
        ended = re.sub(r"\n---\s*\Z", "\n", text)  # as ROS ends a message
        found = yaml.load(re.sub(r"\A%YAML:1\.\d\s*\n", "", ended), Loader=_Loader)  # a safe loader
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
    return content is not None and _camera_matrix(content) is not None


def _read(text: str) -> Sequence[FoundCamera]:
    content = _content(text)
    assert content is not None
    _check_whole(content)
    xi = first(content, ("xi",))
    lens = _lens(content, xi)
    dist, notes = _distortion(content, lens)
    if first(content, ("m2", "cameramatrix2")) is not None:
        notes = (*notes, "The file holds two cameras: the first is read.")
    if lens == "pinhole" and dist.size == 14 and not dist[12:].any():
        dist = dist[:12]
    width, height = first(content, ("imagewidth", "width")), first(content, ("imageheight", "height"))
    size = first(content, ("imagesize", "resolution"))
    if width is None and isinstance(size, list | tuple) and len(size) == 2:
        width, height = size
    intrinsics = Intrinsics(
        matrix(_camera_matrix(content), 3, 3, "the camera matrix"),
        dist,
        lens,
        float(vector(xi, "xi")[0]) if xi is not None else 0.0,
        None if width is None or height is None else (int(width), int(height)),
    )
    pose = _pose(content)
    if pose is None:
        return [FoundCamera(intrinsics=intrinsics, notes=notes)]
    said = f"{' and '.join(pose.names)} are taken as world to camera, in metres."
    return [FoundCamera("", intrinsics, pose.rvec, pose.tvec, notes=(*notes, said))]


@dataclass(frozen=True)
class _Pose:
    """World to camera, and what the file calls it."""

    rvec: Array
    tvec: Array
    names: tuple[str, str]


def _pose(content: Mapping[str, Any]) -> _Pose | None:
    """None where the file has none: R and T of a stereo pair are between its cameras, R alone rectifies."""
    rvec, tvec = first(content, ("rvec", "rotationvector")), first(content, ("tvec", "translationvector"))
    if rvec is not None and tvec is not None and np.size(vector(rvec, "rvec")) == 3:
        return _Pose(matrix(rvec, 3, 1, "rvec").ravel(), matrix(tvec, 3, 1, "tvec").ravel(), ("rvec", "tvec"))
    rotation, moved = first(content, ("r", "rotation", "rotationmatrix")), first(content, ("t", "translation"))
    if rotation is None or moved is None or first(content, ("m2", "cameramatrix2", "e", "f")) is not None:
        return None
    turned = SE3(matrix(rotation, 3, 3, "the rotation"), matrix(moved, 3, 1, "the translation").ravel())
    return _Pose(*turned.to_rvec_tvec(), ("R", "T"))


def _camera_matrix(content: Mapping[str, Any]) -> Any:
    """As a matrix, or put together of fx, fy, cx and cy, which may stand by themselves or in an object."""
    found = first(content, _K)
    source = found if isinstance(found, Mapping) and "data" not in found else content if found is None else None
    if source is None:
        return found
    fx, fy, cx, cy = (first(source, (name,)) for name in ("fx", "fy", "cx", "cy"))
    if fx is None or cx is None or cy is None:
        return found
    return [[fx, 0.0, cx], [0.0, fx if fy is None else fy, cy], [0.0, 0.0, 1.0]]


def _distortion(content: Mapping[str, Any], lens: Lens) -> tuple[Array, tuple[str, ...]]:
    """The coefficients, and what a person should know of them.

    Raises:
        InputError: something is called a distortion, and it is unknown how it is meant.
    """
    found, nested = first(content, _DIST), first(content, _K)
    if found is None:
        others = [name for name, value in content.items() if "dist" in str(name).lower() and not isinstance(value, str)]
        if others:
            raise InputError(
                f"it is unknown what {others[0]!r} is",
                hint="Call the distortion distortion_coefficients, or take it out.",
            )
    sources = [source for source in (found, nested, content) if isinstance(source, Mapping) and "data" not in source]
    if found is None or (isinstance(found, Mapping) and "data" not in found):
        order = _OF_FISHEYE if lens == "fisheye" else _ONE_BY_ONE
        for source in sources:
            values = [first(source, (name,)) for name in order]
            if any(value is not None for value in values):
                last = max(number for number, value in enumerate(values) if value is not None)
                numbers = [0.0 if value is None else value for value in values[: max(last + 1, 4)]]
                numbers += [0.0] * ((8 if len(numbers) > 5 else len(numbers)) - len(numbers))
                return vector(numbers, "the distortion"), ()
    if found is None:
        return np.empty(0), ("The file says nothing of distortion: the lens is taken to bend no line.",)
    return vector(found, "the distortion"), ()


def _check_whole(content: Mapping[str, Any]) -> None:
    """Raises:
    InputError: pictures are a part of what the camera's numbers are for, or binned (ROS's ``camera_info``).
    """
    region = first(content, ("roi",))
    parts = [first(region, (name,)) for name in ("xoffset", "yoffset")] if isinstance(region, Mapping) else []
    binned = [first(content, (name,)) for name in ("binningx", "binningy")]
    if any(parts) or any(isinstance(value, int) and value > 1 for value in binned):
        raise InputError(
            "the file says that pictures are binned, or a part of what its numbers are for (binning_x, roi)",
            hint="Give the numbers of the pictures as recorded, without binning and roi.",
        )


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
