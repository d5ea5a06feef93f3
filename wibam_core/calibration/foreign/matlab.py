"""MATLAB's cameraParameters and cameraIntrinsics: ``jsonencode(toStruct(parameters))`` as JSON, or the struct in a .mat
file.

MATLAB counts pixels from 1, writes sizes as rows, columns, and older versions transpose the matrix.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wibam_core.calibration.foreign.base import Array, FoundCamera, Intrinsics, Reader, json_object, matrix, vector
from wibam_core.errors import InputError


def _recognises(name: str, text: str) -> bool:
    content = json_object(text) if name.endswith(".json") else None
    return content is not None and _is_camera(content)


def _read(text: str) -> Sequence[FoundCamera]:
    content = json_object(text)
    assert content is not None
    return [_camera("", content)]


def read_mat(path: Path) -> Sequence[FoundCamera]:
    """The structs in a .mat file that are cameras, by the names of their variables.

    Raises:
        InputError: it is of another version, or holds none.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    hint = "Save it as: parameters = toStruct(parameters); save('lens.mat', 'parameters', '-v7')"
    try:
        content = loadmat(path, simplify_cells=True)
    except NotImplementedError as error:
        raise InputError("MATLAB files of version 7.3 are not read", hint=hint) from error
    except (MatReadError, ValueError, TypeError, KeyError, IndexError, OSError, zlib.error, EOFError) as error:
        raise InputError("it is no MATLAB file, or broken", hint=hint) from error
    structs = {name: value for name, value in content.items() if isinstance(value, dict)}
    cameras = {name: struct for name, struct in structs.items() if _is_camera(struct)}
    if not cameras:
        raise InputError("no struct in it has a RadialDistortion; objects cannot be read", hint=hint)
    return [_camera(name, struct) for name, struct in cameras.items()]


def _is_camera(content: Mapping[str, Any]) -> bool:
    return "RadialDistortion" in content or "MappingCoefficients" in content


def _camera(name: str, content: Mapping[str, Any]) -> FoundCamera:
    if "MappingCoefficients" in content:
        raise InputError(
            "MATLAB's fisheyeParameters are a polynomial that is not read",
            hint="Calibrate with cv2.fisheye, or undistort the recording with undistortFisheyeImage.",
        )
    radial = vector(content["RadialDistortion"], "RadialDistortion")
    tangential = vector(content.get("TangentialDistortion"), "TangentialDistortion")
    if radial.size not in (2, 3) or tangential.size not in (0, 2):
        raise InputError("RadialDistortion must have 2 or 3 numbers, and TangentialDistortion 2")
    p1, p2 = tangential if tangential.size else np.zeros(2)
    K = _matrix(content)
    K[:2, 2] -= 1.0
    size = vector(content.get("ImageSize"), "ImageSize")
    return FoundCamera(
        name,
        Intrinsics(
            K,
            np.array([radial[0], radial[1], p1, p2, *radial[2:]]),
            size_px=(int(size[1]), int(size[0])) if size.size == 2 else None,
        ),
    )


def _matrix(content: Mapping[str, Any]) -> Array:
    if "K" in content:
        return matrix(content["K"], 3, 3, "K")
    if "IntrinsicMatrix" in content:
        return matrix(content["IntrinsicMatrix"], 3, 3, "IntrinsicMatrix").T.copy()
    fx, fy = matrix(content.get("FocalLength"), 1, 2, "FocalLength").ravel()
    cx, cy = matrix(content.get("PrincipalPoint"), 1, 2, "PrincipalPoint").ravel()
    return np.array([[fx, float(content.get("Skew") or 0.0), cx], [0, fy, cy], [0, 0, 1.0]])


MATLAB = Reader("MATLAB camera parameters", _recognises, _read)
