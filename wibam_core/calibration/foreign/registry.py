"""All formats that calibrations and points are read from, and which one a file is of."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wibam_core.calibration.foreign.base import FoundCamera, Reader
from wibam_core.calibration.foreign.colmap import COLMAP_CAMERAS, COLMAP_IMAGES
from wibam_core.calibration.foreign.geojson import GEOJSON
from wibam_core.calibration.foreign.kalibr import KALIBR
from wibam_core.calibration.foreign.matlab import MATLAB, read_mat
from wibam_core.calibration.foreign.odm import ODM
from wibam_core.calibration.foreign.opencv import OPENCV
from wibam_core.calibration.foreign.points_table import POINTS_TABLE
from wibam_core.calibration.foreign.qgis import QGIS
from wibam_core.calibration.foreign.tumtraf import TUMTRAF
from wibam_core.errors import InputError
from wibam_core.exchange.files import read_text
from wibam_core.text import NotJson, read_json

#: Asked in this order: what is more particular comes first.
READERS: tuple[Reader, ...] = (
    QGIS, ODM, POINTS_TABLE, GEOJSON, TUMTRAF, MATLAB, KALIBR, OPENCV, COLMAP_CAMERAS, COLMAP_IMAGES,
)  # fmt: skip
#: Larger files are no calibration.
_MAX_BYTES = 1 << 26


def read_file(path: Path) -> tuple[str, Sequence[FoundCamera]]:
    """What a file is, and the cameras in it.

    Raises:
        InputError: it is of no known format, or broken.
    """
    if path.suffix.lower() == ".mat":
        try:
            return MATLAB.name, read_mat(path)
        except InputError as error:
            raise _of_file(path.name, MATLAB.name, error) from error
    if path.suffix.lower() == ".npz":
        try:
            with np.load(path, allow_pickle=False) as arrays:
                text = json.dumps({name: arrays[name].tolist() for name in arrays.files})
        except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(
                f"{path.name} is no file of NumPy's arrays, or holds objects",
                hint="Save it as: np.savez('lens.npz', camera_matrix=K, dist_coeffs=dist)",
            ) from error
        return read_named(f"{path.name}.json", text)
    return read_named(path.name, read_text(path, _MAX_BYTES))


def read_named(name: str, text: str) -> tuple[str, Sequence[FoundCamera]]:
    """What the text of a file is, by the file's name and itself, and the cameras in it.

    Raises:
        InputError: it is of no known format, or broken.
    """
    if name.lower().endswith((".json", ".geojson")):
        _check_json(name, text)
    try:
        reader = next((reader for reader in READERS if reader.recognises(name.lower(), text)), None)
        if reader is None:
            hint = f"Known are {', '.join(r.name for r in READERS)}."
            if name.lower().endswith((".csv", ".tsv", ".txt")):
                hint = f"A table of points begins with a line of names, such as x,y,u,v. {hint}"
            raise InputError(f"{name} is of no known calibration format", hint=hint)
        found = reader.read(text)
    except RecursionError as error:
        raise InputError(f"{name} is nested too deeply") from error
    except InputError as error:
        raise (error if reader is None else _of_file(name, reader.name, error)) from error
    return reader.name, found


def _check_json(name: str, text: str) -> None:
    """Raises:
    InputError: a file that is called JSON is none. OpenCV's own begins with a line that says ``%YAML``.
    """
    if text.lstrip().startswith("%"):
        return
    try:
        read_json(text)
    except NotJson as error:
        raise InputError(
            f"{name} is no JSON: {error}", hint="Correct the text there, or save the file again."
        ) from error


def _of_file(name: str, form: str, error: InputError) -> InputError:
    return InputError(f"{name} ({form}): {error.message}", hint=error.hint, **error.details)
