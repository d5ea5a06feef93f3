"""COLMAP's text model: ``cameras.txt`` (lenses) and ``images.txt`` (poses).

COLMAP counts pixels from the corner of the top-left pixel, whose centre is (0.5, 0.5). Its poses are world to camera,
in a world of its own unless the model was aligned to a metric one with the road at Z = 0 (``colmap model_aligner``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from wibam_core.calibration.foreign.base import FoundCamera, Intrinsics, Reader
from wibam_core.errors import InputError
from wibam_core.site import Lens

#: Model -> lens, how many focal lengths come first, and where each of OpenCV's coefficients stands after cx and cy; −1
#: is 0.
_MODELS: Mapping[str, tuple[Lens, int, tuple[int, ...]]] = {
    "SIMPLE_PINHOLE": ("pinhole", 1, ()),
    "PINHOLE": ("pinhole", 2, ()),
    "SIMPLE_RADIAL": ("pinhole", 1, (0, -1, -1, -1)),
    "RADIAL": ("pinhole", 1, (0, 1, -1, -1)),
    "OPENCV": ("pinhole", 2, (0, 1, 2, 3)),
    "FULL_OPENCV": ("pinhole", 2, (0, 1, 2, 3, 4, 5, 6, 7)),
    "OPENCV_FISHEYE": ("fisheye", 2, (0, 1, 2, 3)),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", 1, (0, -1, -1, -1)),
    "RADIAL_FISHEYE": ("fisheye", 1, (0, 1, -1, -1)),
}
_WORLD = (
    "The poses are in COLMAP's world: they are right if that was aligned to metres with Z up and the road at Z = 0."
)


def _lines(text: str) -> Iterator[list[str]]:
    return (line.split() for line in text.splitlines() if line.strip() and not line.startswith("#"))


def _recognises_cameras(name: str, text: str) -> bool:
    fields = next(_lines(text), [])
    return name.endswith(".txt") and len(fields) >= 7 and fields[0].isdigit() and fields[1].isupper()


def _read_cameras(text: str) -> Sequence[FoundCamera]:
    return [_camera(fields) for fields in _lines(text)]


def _camera(fields: list[str]) -> FoundCamera:
    number, model = fields[0], fields[1]
    if model not in _MODELS:
        raise InputError(
            f"camera {number}: the lens model {model} is not read", hint=f"These are: {', '.join(_MODELS)}."
        )
    lens, focals, places = _MODELS[model]
    width, height, *numbers = _numbers(fields[2:], f"camera {number}")
    if len(numbers) != focals + 2 + (max(places) + 1 if places else 0):
        raise InputError(f"camera {number}: {len(numbers)} parameters do not fit the model {model}")
    fx, fy = numbers[0], numbers[focals - 1]
    cx, cy, *coefficients = numbers[focals:]
    K = np.array([[fx, 0, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1.0]])
    dist = np.array([coefficients[place] if place >= 0 else 0.0 for place in places])
    return FoundCamera(number, Intrinsics(K, dist, lens, 0.0, (int(width), int(height))))


def _recognises_images(name: str, text: str) -> bool:
    fields = next(_lines(text), [])
    return name.endswith(".txt") and len(fields) >= 10 and fields[0].isdigit() and not fields[1].isupper()


def _read_images(text: str) -> Sequence[FoundCamera]:
    found = []
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    for line in lines[::2]:  # each image's line is followed by one, often empty, with its points
        fields = line.split(maxsplit=9)
        if len(fields) < 10:
            continue
        w, x, y, z, *tvec = _numbers(fields[1:8], f"image {fields[0]}")
        rvec = Rotation.from_quat([x, y, z, w]).as_rotvec()
        stem = fields[9].replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0]
        found.append(FoundCamera(stem, None, rvec, np.array(tvec), notes=(_WORLD,)))
    return found


def _numbers(fields: list[str], what: str) -> list[float]:
    try:
        return [float(field) for field in fields]
    except ValueError as error:
        raise InputError(f"{what}: {error}") from error


COLMAP_CAMERAS = Reader("COLMAP cameras.txt", _recognises_cameras, _read_cameras)
COLMAP_IMAGES = Reader("COLMAP images.txt", _recognises_images, _read_images)
