"""What is usual: how each camera's still background looks, and how sure the network is of what it finds there.

It is noted where a network is made, and goes along with it: months later it tells whether the camera still looks the
same way, and whether light, weather or traffic have become so different that the network sees worse.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.errors import InputError

Gray = NDArray[np.uint8]

#: A still picture is so wide, px: a tenth of a degree is about a pixel of a camera that sees 60°.
STILL_WIDTH_PX = 640
_STILL, _FOUND = "still/", "found/"


@dataclass(frozen=True)
class Found:
    """What a network found in the pictures of one camera.

    Attributes:
        images: how many pictures. boxes: how many road users in all of them.
        score: mean of their scores; NaN where there were none.
    """

    images: int
    boxes: int
    score: float

    @property
    def boxes_an_image(self) -> float:
        return self.boxes / max(self.images, 1)


@dataclass(frozen=True, eq=False)
class Usual:
    """What is usual by camera, or by view where a camera's lens is wide.

    Attributes:
        stills: (H, W) uint8, `STILL_WIDTH_PX` wide. found: what the network found.
    """

    stills: Mapping[str, Gray] = field(default_factory=dict)
    found: Mapping[str, Found] = field(default_factory=dict)


def write_usual(path: Path, usual: Usual) -> None:
    """Write it as an ``.npz`` of arrays."""
    arrays: dict[str, NDArray] = {f"{_STILL}{camera_id}": still for camera_id, still in usual.stills.items()}
    arrays |= {
        f"{_FOUND}{camera_id}": np.array([found.images, found.boxes, found.score])
        for camera_id, found in usual.found.items()
    }
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # names are the arrays'


def read_usual(path: Path) -> Usual:
    """Read what `write_usual` wrote.

    Raises:
        InputError: the file is not of this kind.
    """
    stills: dict[str, Gray] = {}
    found: dict[str, Found] = {}
    try:
        with np.load(path, allow_pickle=False) as arrays:
            for name in arrays.files:
                value = arrays[name]
                if name.startswith(_STILL) and value.ndim == 2 and value.dtype == np.uint8:
                    stills[name.removeprefix(_STILL)] = value
                elif name.startswith(_FOUND) and value.shape == (3,):
                    found[name.removeprefix(_FOUND)] = Found(int(value[0]), int(value[1]), float(value[2]))
                else:
                    raise ValueError(f"it holds {name!r}")
    except (OSError, ValueError) as error:
        raise InputError(f"{path.name} does not say what is usual: {error}", hint="Leave it out.") from error
    return Usual(stills, found)
