"""Files that others wrote: read with bounds, checked against a model, and never followed out of their folder."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import pydantic

from wibam_core.errors import InputError
from wibam_core.text import NotUnicode, decode_text

#: Larger text files are refused: they would be held in memory several times over.
MAX_BYTES = 1 << 30
#: More than a photograph has.
MAX_IMAGE_BYTES = 1 << 26

_Model = TypeVar("_Model", bound=pydantic.BaseModel)


def read_bytes(path: Path, max_bytes: int = MAX_BYTES) -> bytes:
    """The content of a file.

    Raises:
        InputError: there is no such file, it cannot be read, or it is larger than ``max_bytes``.
    """
    try:
        if not path.is_file():
            raise InputError(f"there is no file {path.name}", hint=f"It should lie in {path.parent}.", file=path.name)
        size = path.stat().st_size
        if size > max_bytes:
            raise InputError(
                f"{path.name} has {size} bytes; {max_bytes} are the most that is read",
                hint="Split the data set into parts.",
                file=path.name,
            )
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path.name} cannot be read: {error.strerror}", hint="Check its permissions.") from error


def read_text(path: Path, max_bytes: int = MAX_BYTES) -> str:
    """The content of a text file in any Unicode encoding; line ends as they are.

    Raises:
        InputError: as `read_bytes`, or it is no such text.
    """
    try:
        return decode_text(read_bytes(path, max_bytes))
    except NotUnicode as error:
        raise InputError(f"{path.name}: {error}", hint="Save it as UTF-8.", file=path.name) from error


def read_json(path: Path, model: type[_Model], max_bytes: int = MAX_BYTES) -> _Model:
    """A JSON file as a model.

    Raises:
        InputError: as `read_bytes`, or naming the first field that is wrong.
    """
    try:
        return model.model_validate_json(read_text(path, max_bytes))
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise wrong(path, where, first["msg"]) from error


def image_size_px(path: Path) -> tuple[int, int]:
    """Width and height of a picture.

    Raises:
        InputError: as `read_bytes`, or it is no picture.
    """
    data = np.frombuffer(read_bytes(path, MAX_IMAGE_BYTES), np.uint8)
    try:
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    except cv2.error:  # more pixels than OpenCV takes, or no byte at all
        image = None
    if image is None:
        raise wrong(path, "image", "it cannot be read")
    return int(image.shape[1]), int(image.shape[0])


def wrong(path: Path, field: str, problem: str, hint: str = "Correct the file, or export it again.") -> InputError:
    """The error of a field that cannot be used: ``problem`` says why, the field's name leading."""
    return InputError(f"{path.name}: {field}: {problem}", hint=hint, file=path.name, field=field)


def within(folder: Path, name: str) -> Path:
    """The file ``name`` below a folder.

    Raises:
        InputError: the name leads out of the folder, also through a link.
    """
    try:
        path = (folder / name).resolve()
        inside = path.is_relative_to(folder.resolve())
    except (OSError, ValueError) as error:  # a link to itself, a NUL character
        raise InputError(f"{name!r} is no name of a file", hint="Names are relative to the folder.") from error
    if not inside:
        raise InputError(
            f"{name!r} leads out of the folder {folder.name}", hint="Names are relative to the folder.", file=name
        )
    return path
