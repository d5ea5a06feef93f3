"""Silhouettes before a still background."""

import numpy as np
import pytest

from wibam_core.detection.background import UNKNOWN, StillBackground
from wibam_core.detection.moving import Stillness

HEIGHT, WIDTH = 240, 320
#: A vehicle: rows and columns.
BODY = (slice(100, 140), slice(120, 200))
BOX = np.array([119.5, 99.5, 199.5, 139.5])


def ground() -> np.ndarray:
    """Asphalt with a white line."""
    image = np.full((HEIGHT, WIDTH, 3), (96, 100, 104), np.uint8)
    image[:, 150:156] = 225
    return image


def noisy(image: np.ndarray, seed: int, sd: float = 3.0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, sd, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def stillness(image: np.ndarray, known: np.ndarray | None = None, frames: list[np.ndarray] | None = None) -> Stillness:
    known = np.full(image.shape[:2], 255, np.uint8) if known is None else known
    return Stillness.of(StillBackground(image, known), frames or [noisy(image, seed) for seed in range(12)])


def iou(a: np.ndarray, b: np.ndarray) -> float:
    low, high = np.maximum(a[:2], b[:2]), np.minimum(a[2:], b[2:])
    shared = np.prod(np.clip(high - low, 0, None))
    return float(shared / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - shared))


@pytest.mark.parametrize("colour", [(30, 28, 26), (60, 60, 170), (215, 214, 210)], ids=["black", "red", "silver"])
def test_a_body_has_one_box(colour: tuple[int, int, int]) -> None:
    image = ground()
    image[BODY] = colour
    (box,) = stillness(ground()).silhouettes(noisy(image, 99))
    assert iou(box, BOX) > 0.85


def test_boxes_are_in_pixels_of_the_image_however_large_it_is() -> None:
    """Kept four times as large, it is looked at twice as large."""
    large = np.kron(ground(), np.ones((4, 4, 1), np.uint8))
    image = large.copy()
    image[400:560, 480:800] = (30, 28, 26)
    (box,) = stillness(large).silhouettes(noisy(image, 99))
    assert iou(box, np.array([479.5, 399.5, 799.5, 559.5])) > 0.9


def test_a_soft_shadow_is_none_even_where_it_falls_on_a_white_line() -> None:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    away = np.hypot((rows - 120) / 40, (columns - 160) / 60)
    light = 1.0 - 0.4 * np.clip(1.6 - away, 0.0, 1.0)  # 0.6 of the light, and a border of some 30 px
    shaded = np.clip(ground() * light[..., None], 0, 255)
    assert len(stillness(ground()).silhouettes(noisy(shaded, 99, sd=1.0))) == 0


def test_ground_is_told_from_who_covers_it_whichever_of_them_the_background_shows() -> None:
    """Also where the ground has a texture and who covers it has none."""
    texture = np.random.default_rng(1).integers(-5, 6, (HEIGHT, WIDTH, 1))
    free = (ground() + texture).astype(np.uint8)
    body = free.copy()
    body[BODY] = (30, 28, 26)
    boxes, uncovered = stillness(free).told_apart(noisy(body, 99))
    assert len(boxes) == 1 and iou(boxes[0], BOX) > 0.85 and not uncovered.any()
    boxes, uncovered = stillness(body).told_apart(noisy(free, 99))
    assert len(boxes) == 0 and (uncovered[BODY] > 0).mean() > 0.9
    uncovered[95:145, 115:205] = 0
    assert not uncovered.any()


def test_what_is_usual_is_told_by_images_in_which_nobody_stands() -> None:
    body = ground()
    body[BODY] = (70, 72, 74)
    images = [noisy(body if k < 9 else ground(), k) for k in range(12)]
    boxes = [BOX[None] if k < 9 else np.empty((0, 4)) for k in range(12)]
    still = StillBackground(ground(), np.full((HEIGHT, WIDTH), 255, np.uint8))
    (found,) = Stillness.of(still, images, boxes).silhouettes(noisy(body, 99))
    assert iou(found, BOX) > 0.85
    assert len(Stillness.of(still, images).silhouettes(noisy(body, 99))) == 0


def test_ground_that_was_uncovered_in_two_of_many_images_tells_what_is_usual() -> None:
    """Also where neither of the two is among the half of the images that are looked at otherwise."""
    body = ground()
    body[BODY] = (70, 72, 74)
    places = np.linspace(0, 31, 16).round().astype(int)
    free = np.setdiff1d(np.arange(32), places)[-2:]
    images = [noisy(ground() if k in free else body, k) for k in range(32)]
    uncovered = [np.zeros((HEIGHT, WIDTH), np.uint8) for _ in images]
    for k in free:
        uncovered[k][90:150, 110:210] = 255
    still = StillBackground(ground(), np.full((HEIGHT, WIDTH), 255, np.uint8))
    (found,) = Stillness.of(still, images, None, uncovered).silhouettes(noisy(body, 99))
    assert iou(found, BOX) > 0.8


def test_what_always_flickers_is_none_and_a_body_beside_it_is_one() -> None:
    def with_leaves(seed: int) -> np.ndarray:
        image = ground()
        leaves = np.random.default_rng(seed).integers(40, 180, (60 // 4, 80 // 4, 3))
        image[:60, :80] = np.kron(leaves, np.ones((4, 4, 1)))
        return noisy(image, seed)

    frames = [with_leaves(seed) for seed in range(12)]
    still = stillness(np.median(frames, axis=0).astype(np.uint8), frames=frames)
    image = with_leaves(99)
    image[BODY] = (30, 28, 26)
    (box,) = still.silhouettes(image)
    assert iou(box, BOX) > 0.85


def test_where_the_background_is_unknown_nothing_is_said() -> None:
    image, known = ground(), np.full((HEIGHT, WIDTH), 255, np.uint8)
    known[80:160, 100:220] = 0
    image[known == 0] = UNKNOWN
    body = ground()
    body[BODY] = (30, 28, 26)
    assert len(stillness(image, known).silhouettes(noisy(body, 99))) == 0


def test_specks_and_thin_lines_are_none() -> None:
    image = ground()
    image[20, 20] = 255
    for k in range(100):  # a wire that hangs across
        image[60 + k, 20 + k] = 0
    assert len(stillness(ground()).silhouettes(noisy(image, 99))) == 0
