from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.errors import InputError
from wibam_core.formats.framestore import FrameStore, FrameStoreWriter

PERIOD_NS = 80_000_000


def picture(value: int, width: int = 64, height: int = 36) -> np.ndarray:
    image = np.full((height, width, 3), value, np.uint8)
    image[:10, :10] = (255, 0, 0)
    return image


def build(folder: Path, native: dict[str, tuple[int, int]] | None = None) -> FrameStore:
    """Camera a at all five instants, b at all but the third."""
    with FrameStoreWriter(folder, 95) as writer:
        for camera, missing in (("b", 2), ("a", None)):
            for i in range(5):
                if i != missing:
                    writer.add(camera, i * PERIOD_NS, i * PERIOD_NS + 7, picture(40 * i, 64 if camera == "a" else 48))
        writer.close(native)
    return FrameStore(folder)


def test_frames_come_back_by_instant(tmp_path: Path) -> None:
    store = build(tmp_path / "frames")
    assert store.camera_ids == ("a", "b")
    assert [s.time_ns for s in store.frame_sets] == [i * PERIOD_NS for i in range(5)]
    assert dict(store.frame_sets[1].frame_times_ns) == {"a": PERIOD_NS + 7, "b": PERIOD_NS + 7}
    assert set(store.frame_sets[2].frame_times_ns) == {"a"}
    for i in (3, 0, 4):
        image = store.image("a", i * PERIOD_NS)
        assert image.shape == (36, 64, 3)
        assert np.abs(image.astype(int) - picture(40 * i)).mean() < 4
    assert store.has("a", 2 * PERIOD_NS)
    assert not store.has("b", 2 * PERIOD_NS)
    with pytest.raises(KeyError):
        store.image("b", 2 * PERIOD_NS)


def test_a_frame_that_came_as_jpeg_is_stored_as_it_came(tmp_path: Path) -> None:
    image = picture(90)
    jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 40])[1].tobytes()
    with FrameStoreWriter(tmp_path / "frames", 95) as writer:
        writer.add("a", 0, 0, image, jpeg)
        writer.close()
    assert (tmp_path / "frames" / "a.jpegs").read_bytes() == jpeg


@pytest.mark.parametrize(
    ("rate_hz", "kept"),
    [(12.5, [0, 1, 2, 3, 4]), (100.0, [0, 1, 2, 3, 4]), (6.25, [0, 2, 4]), (5.0, [0, 3]), (1.0, [0])],
)
def test_instants_are_thinned_to_the_rate(tmp_path: Path, rate_hz: float, kept: list[int]) -> None:
    store = build(tmp_path / "frames")
    assert [instant.time_ns for instant in store.thinned(rate_hz)] == [i * PERIOD_NS for i in kept]


def test_instants_whose_period_was_rounded_down_are_not_taken_for_earlier_ones(tmp_path: Path) -> None:
    period_ns = 33_333_333  # 30 a second: every third falls a nanosecond short of a tenth
    with FrameStoreWriter(tmp_path / "frames", 95) as writer:
        for i in range(8):
            writer.add("a", i * period_ns, i * period_ns, picture(0))
        writer.close()
    kept = FrameStore(tmp_path / "frames").thinned(10.0)
    assert [instant.time_ns // period_ns for instant in kept] == [0, 3, 6]


def test_convention_images_are_bgr(tmp_path: Path) -> None:
    corner = build(tmp_path / "frames").image("a", 0)[2:8, 2:8].mean((0, 1))
    assert corner[0] > 200
    assert corner[2] < 60


def test_one_file_per_camera_and_a_repeated_frame_is_stored_once(tmp_path: Path) -> None:
    with FrameStoreWriter(tmp_path, 90) as writer:
        for i in range(10):
            writer.add("a", i * PERIOD_NS, (i // 5) * 5 * PERIOD_NS, picture(i // 5))
        writer.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.jpegs",
        "cameras.json",
        "frames.parquet",
        "instants.parquet",
    ]
    _, one = cv2.imencode(".jpg", picture(0), [cv2.IMWRITE_JPEG_QUALITY, 90])
    assert (tmp_path / "a.jpegs").stat().st_size < 3 * len(one)
    store = FrameStore(tmp_path)
    assert np.array_equal(store.image("a", 4 * PERIOD_NS), store.image("a", 0))
    assert store.image("a", 5 * PERIOD_NS)[20, 20, 0] == 1


def test_frames_are_kept_by_the_cameras_own_clock(tmp_path: Path) -> None:
    with FrameStoreWriter(tmp_path, 95) as writer:
        writer.add_frame("a", 500, picture(10))
        writer.add_frame("a", 540, picture(90))
        writer.add_to_instant(0, "a", 500, 3)
        writer.add_damaged("a", [580, 620])
        writer.add_damaged("b", [7])
        writer.close()
    store = FrameStore(tmp_path)
    (instant,) = store.frame_sets
    assert (dict(instant.frame_times_ns), dict(instant.local_times_ns)) == ({"a": 3}, {"a": 500})
    assert np.array_equal(store.image("a", 0), store.image_at("a", 500))
    assert store.image_at("a", 540)[20, 20, 0] == pytest.approx(90, abs=3)
    assert [store.damaged_ns(camera_id).tolist() for camera_id in "abc"] == [[580, 620], [7], []]
    assert store.stored_ns("a").tolist() == [500, 540]
    for local_ns in (580, 600):
        with pytest.raises(KeyError):
            store.image_at("a", local_ns)


def test_frames_are_copied_as_they_are(tmp_path: Path) -> None:
    first = build(tmp_path / "first")
    with FrameStoreWriter(tmp_path / "second", 30) as writer:
        for i in (1, 3):
            writer.add_jpeg("a", i * PERIOD_NS + 7, first.jpeg_at("a", i * PERIOD_NS + 7), first.size("a"))
            writer.add_to_instant(i, "a", i * PERIOD_NS + 7, i)
        writer.close()
    second = FrameStore(tmp_path / "second")
    assert np.array_equal(second.image("a", 3), first.image("a", 3 * PERIOD_NS))


def test_sizes_default_to_those_of_the_recording(tmp_path: Path) -> None:
    store = build(tmp_path / "frames", {"a": (640, 360)})
    assert (store.size("a"), store.native_size("a")) == ((64, 36), (640, 360))
    assert (store.size("b"), store.native_size("b")) == ((48, 36), (48, 36))
    boxes = np.array([[-0.5, -0.5, 63.5, 35.5], [0, 0, 10, 10]])
    assert np.allclose(store.to_native_px("a", boxes), [[-0.5, -0.5, 639.5, 359.5], [4.5, 4.5, 104.5, 104.5]])
    assert np.array_equal(store.to_native_px("b", boxes), boxes)


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_convention_native_pixels_invert_resizing(u: float, v: float) -> None:
    store = FrameStore.__new__(FrameStore)
    store.size = lambda camera_id: (960, 541)  # type: ignore[method-assign]
    store.native_size = lambda camera_id: (1920, 1081)  # type: ignore[method-assign]
    small = np.array([(u + 0.5) * 960 / 1920 - 0.5, (v + 0.5) * 541 / 1081 - 0.5])
    assert np.allclose(store.to_native_px("a", small), [u, v], rtol=1e-12, atol=1e-8)


def test_cameras_may_be_written_and_read_from_several_threads(tmp_path: Path) -> None:
    with FrameStoreWriter(tmp_path, 90) as writer:

        def fill(camera: int) -> None:
            for i in range(40):
                writer.add(
                    f"cam{camera}", i * PERIOD_NS, i * PERIOD_NS, np.full((36, 64, 3), camera * 40 + i, np.uint8)
                )

        with ThreadPoolExecutor(4) as pool:
            list(pool.map(fill, range(4)))
        writer.close()
    store = FrameStore(tmp_path)

    def check(camera: int) -> bool:
        levels = [float(store.image(f"cam{camera}", i * PERIOD_NS).mean()) for i in range(40)]
        return bool(np.allclose(levels, camera * 40 + np.arange(40), atol=1))

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(check, range(4)))
    assert len(store) == 40


def test_store_goes_to_other_processes(tmp_path: Path) -> None:
    store = build(tmp_path / "frames")
    store.image("a", 0)
    copy = pickle.loads(pickle.dumps(store))
    assert np.array_equal(copy.image("a", PERIOD_NS), store.image("a", PERIOD_NS))


def test_unfinished_damaged_and_missing_stores_are_refused(tmp_path: Path) -> None:
    with FrameStoreWriter(tmp_path / "frames", 90) as writer:
        writer.add("a", 0, 0, picture(9))
    for folder in (tmp_path / "frames", tmp_path / "absent"):
        with pytest.raises(InputError, match="no finished frame store"):
            FrameStore(folder)
    store = build(tmp_path / "frames")
    pack = tmp_path / "frames" / "a.jpegs"
    whole = pack.read_bytes()
    for content in (whole[:-20], whole[:-200] + bytes(100) + whole[-100:]):
        pack.write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            FrameStore(tmp_path / "frames").image("a", 4 * PERIOD_NS)
    assert store.has("a", 4 * PERIOD_NS)


def test_a_camera_keeps_its_size_and_no_frames_is_a_store_too(tmp_path: Path) -> None:
    with FrameStoreWriter(tmp_path, 90) as writer:
        writer.add("a", 0, 0, picture(1))
        with pytest.raises(ValueError, match="px"):
            writer.add("a", 1, 1, picture(1, 66))
    with FrameStoreWriter(tmp_path / "empty", 90) as writer:
        writer.close()
    assert FrameStore(tmp_path / "empty").frame_sets == []
