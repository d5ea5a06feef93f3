"""Windows that are cut out of frames before conversion look as they do in the whole pictures."""

from pathlib import Path

import av
import numpy as np
import pytest

from wibam_core.video.decode import OnePass, Watcher, decode
from wibam_core.video.encode import VideoWriter
from wibam_core.video.picture import Orientation, to_bgr
from wibam_core.video.windows import Windows

SIZE = (128, 96)
#: A corner, one that begins at odd pixels, one at the other corner, one row.
WINDOWS = [(0, 0, 12, 20), (37, 41, 50, 70), (100, 61, 128, 96), (5, 30, 90, 31)]


def turned(window: tuple[int, int, int, int], orientation: Orientation) -> tuple[int, int, int, int]:
    return window if not orientation.transposed else (window[1], window[0], window[3], window[2])


@pytest.mark.parametrize("pixels", ["yuv420p", "yuvj420p", "yuv422p", "yuv420p10le", "nv12"])
@pytest.mark.parametrize("matrix", [1, 5])  # BT.709 and BT.601, which OpenCV converts
@pytest.mark.parametrize(
    "orientation",
    [Orientation(a, b, c) for a in (False, True) for b in (False, True) for c in (False, True)],
)
def test_windows_equal_those_of_whole_pictures(pixels: str, matrix: int, orientation: Orientation) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    frame = av.VideoFrame.from_ndarray(noise, format="bgr24").reformat(format=pixels, dst_colorspace=matrix)
    frame.colorspace = matrix
    whole = to_bgr(frame, orientation, None, None)
    windows = [turned(window, orientation) for window in WINDOWS]
    cutter = Windows(windows, orientation.size(SIZE))
    for _ in range(2):
        for (x0, y0, x1, y1), image in zip(windows, cutter.of(frame, orientation), strict=True):
            np.testing.assert_array_equal(image, whole[y0:y1, x0:x1])


@pytest.mark.parametrize("size", [(129, 97), (129, 96), (128, 97)])
@pytest.mark.parametrize("orientation", [Orientation(), Orientation(True, True, False), Orientation(False, True, True)])
def test_windows_at_the_edges_of_odd_pictures_are_whole(size: tuple[int, int], orientation: Orientation) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    frame = av.VideoFrame.from_ndarray(noise, format="bgr24").reformat(format="yuv420p")
    width, height = orientation.size(size)
    whole = to_bgr(frame, orientation, None, None)
    windows = [(0, 0, 12, 20), (width - 20, height - 20, width, height), (width - 1, 0, width, 10)]
    for (x0, y0, x1, y1), image in zip(windows, Windows(windows, (width, height)).of(frame, orientation), strict=True):
        np.testing.assert_array_equal(image, whole[y0:y1, x0:x1])


def test_pictures_of_other_sizes_are_resized_first() -> None:
    image = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    frame = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format="yuv420p")
    [window] = Windows([(10, 20, 40, 60)], SIZE).of(frame, Orientation())
    np.testing.assert_array_equal(window, to_bgr(frame, Orientation(), SIZE, None)[20:60, 10:40])


def test_who_watches_is_shown_every_frame_whatever_is_asked_for(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path = tmp_path / "a.mp4"
    with VideoWriter(path, *SIZE, 25.0) as writer:
        for number in range(30):
            writer.write(rng.integers(0, 255, (SIZE[1], SIZE[0], 3), dtype=np.uint8), number * 40_000_000)
    shown: list[tuple[int, list[np.ndarray]]] = []
    watcher = Watcher(WINDOWS, SIZE, lambda time_ns, images: shown.append((time_ns, images)))
    one_pass = OnePass(path, among={400_000_000}, watcher=watcher)
    one_pass.pass_to(200_000_000)
    found = one_pass.nearest(380_000_000, 50_000_000)
    assert found is not None and found.time_ns == 400_000_000
    one_pass.finish()
    every = list(decode(path))
    assert [time_ns for time_ns, _ in shown] == [time_ns for time_ns, _ in every]
    for (_, images), (_, whole) in zip(shown, every, strict=True):
        for (x0, y0, x1, y1), image in zip(WINDOWS, images, strict=True):
            np.testing.assert_array_equal(image, whole[y0:y1, x0:x1])
