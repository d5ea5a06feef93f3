"""Pictures from above: where their files say that they lie, and what is refused."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from wibam_core.errors import InputError, TooLarge
from wibam_core.formats.map_pictures import read_map_picture, two_points, world_file

SCALE, TIEPOINT, TRANSFORMATION, KEYS = 33550, 33922, 34264, 34735


def write_tiff(path: Path, tags: dict[int, tuple[float, ...]], size: tuple[int, int] = (40, 20)) -> Path:
    """A grey TIFF with tags of numbers; those of `KEYS` are short integers."""
    info = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, values in tags.items():
        info.tagtype[tag] = 3 if tag == KEYS else 12
        info[tag] = tuple(int(v) for v in values) if tag == KEYS else values
    Image.new("RGB", size, (90, 100, 110)).save(path, tiffinfo=info)
    return path


def keys(*pairs: tuple[int, int]) -> tuple[int, ...]:
    """A directory of GeoKeys with short values."""
    return (1, 1, 0, len(pairs), *(n for key, value in pairs for n in (key, 0, 1, value)))


class TestGeoTiff:
    TAGS = {SCALE: (0.5, 0.25, 0.0), TIEPOINT: (0.0, 0.0, 0.0, 1000.0, 2000.0, 0.0)}  # noqa: RUF012

    def test_where_a_pixel_is_an_area_the_tie_point_is_its_corner(self, tmp_path: Path) -> None:
        found = read_map_picture(
            write_tiff(tmp_path / "a.tif", {**self.TAGS, KEYS: keys((1025, 1), (3072, 25832))}), 100
        )
        np.testing.assert_allclose(found.affine, [[0.5, 0, 1000.25], [0, -0.25, 1999.875]])
        assert (found.epsg, found.sent_px, found.image.shape) == (25832, (40, 20), (20, 40, 3))

    def test_where_a_pixel_is_a_point_the_tie_point_is_its_centre(self, tmp_path: Path) -> None:
        found = read_map_picture(write_tiff(tmp_path / "p.tif", {**self.TAGS, KEYS: keys((1025, 2))}), 100)
        np.testing.assert_allclose(found.affine, [[0.5, 0, 1000.0], [0, -0.25, 2000.0]])
        assert found.epsg is None

    def test_a_transformation_may_turn_it(self, tmp_path: Path) -> None:
        matrix = (0.0, 2.0, 0.0, 10.0, 3.0, 0.0, 0.0, 20.0, *(0.0,) * 4, 0.0, 0.0, 0.0, 1.0)
        found = read_map_picture(write_tiff(tmp_path / "t.tif", {TRANSFORMATION: matrix}), 100)
        assert found.affine is not None
        np.testing.assert_allclose(found.affine @ [0, 0, 1], [11.0, 21.5], err_msg="half a pixel from the corner")
        np.testing.assert_allclose(found.affine @ [4, 1, 1], [13.0, 33.5])

    def test_a_picture_that_is_kept_smaller_lies_where_it_lay(self, tmp_path: Path) -> None:
        whole = read_map_picture(write_tiff(tmp_path / "w.tif", self.TAGS), 100)
        small = read_map_picture(tmp_path / "w.tif", 10)
        assert small.image.shape == (5, 10, 3)
        assert whole.affine is not None and small.affine is not None
        for corner in ((-0.5, -0.5), (1.0, 1.0)):
            large = [(n + 0.5) * 4 - 0.5 for n in corner]
            np.testing.assert_allclose(small.affine @ [*corner, 1], whole.affine @ [*large, 1])


def test_sixteen_bits_are_spread_and_what_is_clear_is_white(tmp_path: Path) -> None:
    Image.fromarray(np.linspace(1000, 3000, 100).astype(np.uint16).reshape(10, 10)).save(tmp_path / "deep.tif")
    deep = read_map_picture(tmp_path / "deep.tif", 100).image
    assert deep.min() == 0 and deep.max() == 255
    Image.new("RGBA", (4, 4), (0, 0, 0, 0)).save(tmp_path / "clear.png")
    assert (read_map_picture(tmp_path / "clear.png", 100).image == 255).all()


def test_what_is_no_picture_or_too_large_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(InputError, match="no picture that can be read"):
        read_map_picture(tmp_path / "text.png", 100)
    Image.new("RGB", (50, 50)).save(tmp_path / "whole.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "whole.png").read_bytes()[:60])
    with pytest.raises(InputError, match="no picture that can be read"):
        read_map_picture(tmp_path / "cut.png", 100)
    header = b"IHDR" + struct.pack(">IIBBBBB", 200_000, 200_000, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    (tmp_path / "bomb.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk + b"\0\0\0\0IDAT")
    with pytest.raises(TooLarge, match="200000 x 200000 pixels"):
        read_map_picture(tmp_path / "bomb.png", 100)


def test_deep_pictures_are_made_small_before_they_are_spread(tmp_path: Path) -> None:
    """Of 4 megapixels, 8 bytes each would be 32 MB, and some copies of them."""
    ramp = np.tile(np.linspace(1000, 3000, 2000).astype(np.uint16), (2000, 1))
    Image.fromarray(ramp).save(tmp_path / "deep.png", compress_level=1)
    tracemalloc.start()
    image = read_map_picture(tmp_path / "deep.png", 100).image
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16e6
    assert image.shape == (100, 100, 3) and image[50, 0, 0] < 5 and image[50, -1, 0] > 250
    assert image[50, 50, 0] == pytest.approx(128, abs=4)


def test_what_can_be_seen_through_lies_on_white(tmp_path: Path) -> None:
    Image.new("RGBA", (40, 40), (200, 0, 0, 0)).save(tmp_path / "clear.png")
    np.testing.assert_array_equal(read_map_picture(tmp_path / "clear.png", 10).image, 255)


def test_a_world_file_places_the_centres_of_pixels() -> None:
    affine = world_file("0.1\n0.0\n0.0\n-0,1\n500.05\n99.95\n")
    np.testing.assert_allclose(affine @ [10, 20, 1], [501.05, 97.95])
    for text in ("", "1\n2\n3", "a b c d e f", "0\n0\n0\n0\n1\n1", "nan\n0\n0\n1\n1\n1", "1\n0\n0\n-1\n1e307\n0"):
        with pytest.raises(InputError):
            world_file(text)


def test_two_points_place_a_picture_that_is_turned() -> None:
    """Up in the picture is east: pixel (10, 50) is the origin, 20 px further up are 5 m along X."""
    affine = two_points(np.array([[10.0, 50.0], [10.0, 30.0]]), np.array([[0.0, 0.0], [5.0, 0.0]]))
    np.testing.assert_allclose(affine @ [10, 30, 1], [5, 0], atol=1e-9)
    np.testing.assert_allclose(affine @ [30, 50, 1], [0, -5], atol=1e-9, err_msg="right of it is south")
    with pytest.raises(InputError, match="the same"):
        two_points(np.zeros((2, 2)), np.array([[0.0, 0.0], [5.0, 0.0]]))
