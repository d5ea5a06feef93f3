"""Pictures from above: PNG, JPEG, WebP and TIFF, and where a GeoTIFF or a world file says that they lie.

GeoTIFF: OGC 19-008r4, section 7 (the tags) and 7.4 (the keys). World file: six numbers A, D, B, E, C, F, one a line,
with x = A u + B v + C and y = D u + E v + F for the centre of pixel (u, v).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

from wibam_core.errors import InputError, TooLarge

Image = NDArray[np.uint8]
#: (2, 3): pixel (u, v, 1), whose (0, 0) is the centre of the top-left one, to coordinates of the map.
Affine = NDArray[np.float64]

Tags = dict[int, object]
_FORMATS = ("PNG", "JPEG", "TIFF", "WEBP")
#: What a confined process can hold a few times over: 10,000 x 10,000.
MOST_PIXELS = 100_000_000
#: No map on Earth has larger coordinates, nor pixels, in metres or degrees.
MOST_COORDINATE = 1e8
_SCALE, _TIEPOINT, _TRANSFORMATION, _KEYS = 33550, 33922, 34264, 34735
_RASTER_TYPE, _GEOGRAPHIC, _PROJECTED, _PIXEL_IS_POINT = 1025, 2048, 3072, 2


@dataclass(frozen=True)
class MapPicture:
    """A decoded picture.

    Attributes:
        image: (H, W, 3), RGB.
        affine: where its pixels lie on the map; None where the file does not say.
        sent_px: width and height of the picture in the file.
        epsg: code of the map's coordinate system; None where the file names none.
    """

    image: Image
    sent_px: tuple[int, int]
    affine: Affine | None = None
    epsg: int | None = None


def read_map_picture(path: Path, longest_px: int) -> MapPicture:
    """Decode a picture, no larger than ``longest_px`` at its longer side.

    Raises:
        InputError: it is no picture of a kind that is known, or damaged.
        TooLarge: it has more than `MOST_PIXELS` pixels.
    """
    Pillow.MAX_IMAGE_PIXELS = None  # our own bound is checked before anything is decoded
    try:
        with Pillow.open(path, formats=_FORMATS) as picture:
            width, height = picture.size
            if width * height > MOST_PIXELS:
                raise TooLarge(
                    f"the picture has {width} x {height} pixels, more than {MOST_PIXELS / 1e6:.0f} million",
                    hint="Cut out the intersection, or save it smaller; the world file of a cut-out keeps it in place.",
                )
            tags: Tags = dict(getattr(picture, "tag_v2", {}))
            if picture.format == "JPEG":
                picture.draft("RGB", (longest_px, longest_px))  # decodes at a fraction of the size where that is enough
            image = np.asarray(_small_rgb(picture, longest_px))
    except (OSError, SyntaxError, ValueError, EOFError, MemoryError) as error:
        raise InputError(
            "the file is no picture that can be read here",
            hint="Send a PNG, JPEG, WebP or TIFF; save it anew if it is one.",
        ) from error
    affine = _geotiff(tags)
    if affine is not None:
        affine = shrunk(affine, width / image.shape[1], height / image.shape[0])
    return MapPicture(image, (width, height), affine, _epsg(tags))


def world_file(text: str) -> Affine:
    """(2, 3) from the text of a world file.

    Raises:
        InputError: these are not six numbers that place a picture.
    """
    hint = "It has six lines with one number each, such as the .pgw, .jgw or .tfw that came with the picture."
    try:
        a, d, b, e, c, f = (float(part) for part in text.replace(",", ".").split())
    except ValueError:
        raise InputError("the file is no world file", hint=hint) from None
    affine = np.array([[a, b, c], [d, e, f]])
    if not (np.abs(affine) <= MOST_COORDINATE).all() or abs(np.linalg.det(affine[:, :2])) < 1e-12:
        raise InputError("the numbers of the world file place no picture", hint=hint)
    return affine


def two_points(pixels: NDArray[np.float64], world_m: NDArray[np.float64]) -> Affine:
    """(2, 3) of a picture seen straight from above, north or not, from two of its pixels (2, 2) and where they lie.

    Raises:
        InputError: the points are the same.
    """
    start, end = (complex(u, -v) for u, v in pixels)  # a picture's v points down: seen from above, a rotation is left
    first, second = (complex(x, y) for x, y in world_m)
    if abs(end - start) < 1 or abs(second - first) < 1e-3:
        raise InputError("the two points are the same", hint="Choose two that lie far apart.")
    turn = (second - first) / (end - start)
    offset = first - turn * start
    return np.array([[turn.real, turn.imag, offset.real], [turn.imag, -turn.real, offset.imag]])


def shrunk(affine: Affine, times_u: float, times_v: float) -> Affine:
    """The same place for a picture that is so many times less wide and high."""
    to_large = np.array([[times_u, 0, times_u / 2 - 0.5], [0, times_v, times_v / 2 - 0.5], [0, 0, 1]])
    return affine @ to_large


def _small_rgb(picture: Pillow.Image, longest_px: int) -> Pillow.Image:
    """Made small before anything else: what follows takes several times the memory of what it works on."""
    if picture.mode.startswith("I") or picture.mode == "F":
        return _spread(np.asarray(_small(picture.convert("F"), longest_px))).convert("RGB")
    if "A" in picture.mode or "transparency" in picture.info:
        over = _small(_as(picture, "RGBA"), longest_px)
        return Pillow.alpha_composite(Pillow.new("RGBA", over.size, "white"), over).convert("RGB")
    return _as(_small(picture if picture.mode == "L" else _as(picture, "RGB"), longest_px), "RGB")


def _spread(values: NDArray[np.float32]) -> Pillow.Image:
    """Values (H, W), such as those of 16 bits, over the 8 bits of what they use of them."""
    low, high = np.nanpercentile(values, (0.5, 99.5))
    return Pillow.fromarray(np.clip((values - low) / max(high - low, 1e-9) * 255, 0, 255).astype(np.uint8))


def _as(picture: Pillow.Image, mode: str) -> Pillow.Image:
    return picture if picture.mode == mode else picture.convert(mode)


def _small(picture: Pillow.Image, longest_px: int) -> Pillow.Image:
    picture.thumbnail((longest_px, longest_px), Pillow.Resampling.BOX)
    return picture


def _geotiff(tags: Tags) -> Affine | None:
    """Where a GeoTIFF's pixels lie, by their centres."""
    if (matrix := _numbers(tags, _TRANSFORMATION, 16)) is not None:
        affine = matrix.reshape(4, 4)[:2][:, [0, 1, 3]]
    else:
        scale, tie = _numbers(tags, _SCALE, 3), _numbers(tags, _TIEPOINT, 6)
        if scale is None or tie is None:
            return None
        i, j, _, x, y, _ = tie
        affine = np.array([[scale[0], 0, x - i * scale[0]], [0, -scale[1], y + j * scale[1]]])
    if not np.isfinite(affine).all() or abs(np.linalg.det(affine[:, :2])) < 1e-18:
        return None
    if _keys(tags).get(_RASTER_TYPE) != _PIXEL_IS_POINT:  # (0, 0) is the corner of the first pixel
        affine[:, 2] += affine[:, :2] @ [0.5, 0.5]
    return affine


def _epsg(tags: Tags) -> int | None:
    keys = _keys(tags)
    code = keys.get(_PROJECTED, keys.get(_GEOGRAPHIC))
    return code if code is not None and 1024 <= code < 32767 else None


def _keys(tags: Tags) -> dict[int, int]:
    """GeoKeys whose value stands in the directory itself."""
    found = tags.get(_KEYS)
    numbers = [int(n) for n in found] if isinstance(found, tuple) else []
    rows = [numbers[at : at + 4] for at in range(4, len(numbers) - 3, 4)]
    return {key: value for key, location, _, value in rows if location == 0}


def _numbers(tags: Tags, tag: int, count: int) -> NDArray[np.float64] | None:
    found = tags.get(tag)
    if not isinstance(found, tuple) or len(found) < count:
        return None
    return np.array([float(n) for n in found[:count]])
