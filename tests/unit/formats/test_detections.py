"""2D boxes by the frame that they were detected in."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.errors import InputError
from wibam_core.formats.detections import read_detections, write_detections
from wibam_core.road_users import CLASSES
from wibam_core.scene import Boxes2D, FrameKey

FRAME = st.builds(FrameKey, st.text("abc-_1", min_size=1, max_size=3), st.integers(-(10**18), 10**18))


@st.composite
def boxes(draw: st.DrawFn) -> Boxes2D:
    count = draw(st.integers(0, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    known = draw(st.booleans())
    amodal, sd = rng.normal(0, 1e3, (2, count, 4)) if known else np.full((2, count, 4), np.nan)
    classes = rng.integers(0, len(CLASSES), count)
    return Boxes2D(rng.normal(0, 1e3, (count, 4)), rng.random(count), classes, amodal, sd)


@given(st.dictionaries(FRAME, boxes(), max_size=6))
def test_law_detections_round_trip_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, detected: dict[FrameKey, Boxes2D]
) -> None:
    path = tmp_path_factory.mktemp("detected") / "detections.parquet"
    write_detections(path, detected)
    found = read_detections(path)
    assert list(found) == sorted(detected)
    for frame, values in found.items():
        for value, given_ in zip(values, detected[frame], strict=True):
            np.testing.assert_array_equal(value, given_)
            assert value.shape == given_.shape and value.dtype == given_.dtype


def test_what_is_no_table_of_detections_is_refused(tmp_path: Path) -> None:
    (tmp_path / "detections.parquet").write_bytes(b"nothing")
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        read_detections(tmp_path / "detections.parquet")
