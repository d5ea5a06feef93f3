"""The still background of a camera."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.detection.background import UNKNOWN, BackgroundFrames, still_background
from wibam_core.video.sampling import nearest_times

S = 10**9

HEIGHT, WIDTH = 40, 60


def _scene(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(30, 220, (HEIGHT, WIDTH, 3)).astype(np.uint8)


def test_vehicles_that_stand_for_most_of_the_time_leave_no_trace_where_the_ground_was_seen_often_enough():
    still = _scene(0)
    images, boxes = [], []
    for number in range(12):
        image = still.copy()
        if number < 8:  # a queue at a red light
            image[10:20, 20:40] = 255
            boxes.append(np.array([[19.5, 9.5, 39.5, 19.5]]))
        else:
            boxes.append(np.empty((0, 4)))
        images.append(image)
    background = still_background(images, boxes)
    np.testing.assert_array_equal(background.image, still)
    assert (background.known == 255).all()


def test_where_a_vehicle_always_stood_nothing_is_known():
    still = _scene(1)
    boxes = [np.array([[19.5, 9.5, 39.5, 19.5]])] * 6
    background = still_background([still] * 6, boxes)
    assert (background.known[12:18, 22:38] == 0).all()
    assert (background.image[12:18, 22:38] == UNKNOWN).all()
    assert (background.known[:6] == 255).all()
    np.testing.assert_array_equal(background.image[:6], still[:6])


def test_noise_and_passing_shadows_are_averaged_out():
    rng = np.random.default_rng(2)
    still = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    images = []
    for number in range(15):
        image = np.clip(still + rng.normal(0, 8, still.shape), 0, 255).astype(np.uint8)
        image[:, 4 * number : 4 * number + 6] //= 2
        images.append(image)
    background = still_background(images, [np.empty((0, 4))] * 15)
    assert np.abs(background.image.astype(int) - 120).mean() < 4
    assert np.abs(background.image.astype(int) - 120).max() < 16


def test_what_two_images_surely_show_decides_and_what_one_shows_does_not():
    still, stands = _scene(5), _scene(5)
    stands[10:20, 20:40] = 255  # no box says so
    images, boxes = [stands] * 9 + [still] * 3, [np.empty((0, 4))] * 12
    for sure, expected in ((2, still), (1, stands)):
        uncovered = [np.zeros((HEIGHT, WIDTH), np.uint8) for _ in images]
        for shown in uncovered[-sure:]:
            shown[10:20, 20:40] = 255
        background = still_background(images, boxes, uncovered)
        np.testing.assert_array_equal(background.image, expected)
        assert (background.known == 255).all()


def test_boxes_may_reach_beyond_the_image():
    background = still_background([_scene(3)] * 5, [np.array([[-0.5, -0.5, 10.0, 10.0], [50.0, 30.0, 59.5, 39.5]])] * 5)
    assert background.known[0, 0] == 0 and background.known[-1, -1] == 0 and background.known[20, 30] == 255


def test_of_a_single_image_what_lies_outside_of_boxes_is_known():
    background = still_background([_scene(4)], [np.array([[10.0, 10.0, 20.0, 20.0]])])
    assert background.known[0, 0] == 255 and background.known[15, 15] == 0


def all_shown(frames: BackgroundFrames, times_ns: np.ndarray) -> dict[int, list[int]]:
    blocks = sorted({frames.block(int(time)) for time in times_ns})
    return {block: frames.of_block(block) for block in blocks}


@given(
    intervals=st.lists(st.integers(1, 4 * S), min_size=1, max_size=80),
    damaged=st.sets(st.integers(0, 80)),
    others=st.sets(st.integers(0, 80)),
    block_s=st.floats(5, 200),
)
def test_law_background_frames_do_not_depend_on_which_others_are_stored(
    intervals: list[int], damaged: set[int], others: set[int], block_s: float
) -> None:
    times_ns = np.cumsum([7, *intervals])
    sound = [int(time) for number, time in enumerate(times_ns) if number not in damaged]
    targets_ns, tolerance_ns = BackgroundFrames.targets_ns(times_ns)
    nearest = {time for time in nearest_times(np.array(sound, np.int64), targets_ns, tolerance_ns) if time is not None}
    more = nearest | {time for number, time in enumerate(sound) if number in others}
    few, many = (BackgroundFrames(times_ns, np.array(sorted(stored), np.int64), block_s) for stored in (nearest, more))
    assert all_shown(few, times_ns) == all_shown(many, times_ns)
    assert {time for of_block in all_shown(few, times_ns).values() for time in of_block} <= nearest


def test_a_background_is_made_of_frames_from_all_of_its_time() -> None:
    times_ns = np.arange(0, 600 * S, S // 25)
    targets_ns, _ = BackgroundFrames.targets_ns(times_ns)
    assert len(targets_ns) == 300  # one every two seconds
    shown = all_shown(BackgroundFrames(times_ns, times_ns, 120.0), times_ns)
    assert list(shown) == [0, 1, 2, 3, 4]
    for block, of_block in shown.items():
        assert len(of_block) == 32
        assert block * 120 * S <= of_block[0] < (block * 120 + 2) * S
        assert ((block + 1) * 120 - 2) * S <= of_block[-1] < (block + 1) * 120 * S
        assert max(np.diff(of_block)) <= 4 * S


def test_short_recordings_have_as_many_frames_for_their_background() -> None:
    times_ns = np.arange(0, 10 * S, S // 25)
    assert len(BackgroundFrames(times_ns, times_ns, 120.0).of_block(0)) == 32
