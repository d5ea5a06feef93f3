"""A detector on tiles: small road users are seen, cut ones are not, and nobody is counted twice."""

import itertools
from dataclasses import dataclass, field

import numpy as np
import pytest

from wibam_core.detection.boxes import Found
from wibam_core.detection.tiles import TiledDetector, spans
from wibam_core.road_users import RoadUserClass


@dataclass
class Squares:
    """Finds bright squares, of a side of at least a share of the image's width, as a detector of small inputs would."""

    least_share: float
    asked: list[tuple[int, int]] = field(default_factory=list)
    classes = (RoadUserClass.CAR,)

    def detect(self, image_bgr: np.ndarray) -> Found:
        self.asked.append(image_bgr.shape[:2])
        boxes, scores = [], []
        for level in np.unique(image_bgr[image_bgr > 0]).tolist():  # each has a brightness of its own
            rows, columns = np.nonzero((image_bgr == level).all(axis=2))
            box = [columns.min() - 0.5, rows.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5]
            if box[2] - box[0] >= self.least_share * image_bgr.shape[1]:
                boxes.append(box)
                scores.append(0.5 + (box[2] - box[0]) / image_bgr.shape[1] / 4)
        return Found(np.array(boxes).reshape(-1, 4), np.array(scores), np.zeros(len(boxes), np.int64))


def picture(*squares: tuple[int, int, int]) -> np.ndarray:
    image = np.zeros((300, 400, 3), np.uint8)
    for number, (x, y, side) in enumerate(squares, 1):
        image[y : y + side, x : x + side] = 10 * number
    return image


def test_what_is_too_small_in_the_whole_image_is_found_in_a_tile_and_once() -> None:
    image = picture((20, 20, 16), (150, 130, 16), (370, 270, 16))
    assert len(Squares(0.1).detect(image).boxes) == 0
    found = TiledDetector(Squares(0.1), 3, 0.6).detect(image)
    wanted = {(19.5, 19.5, 35.5, 35.5), (149.5, 129.5, 165.5, 145.5), (369.5, 269.5, 385.5, 285.5)}
    assert {tuple(box) for box in found.boxes.tolist()} == wanted


def test_a_large_one_keeps_the_box_of_the_whole_image_and_its_parts_are_no_others() -> None:
    image = picture((60, 40, 200))
    found = TiledDetector(Squares(0.1), 3, 0.6).detect(image)
    assert found.boxes.tolist() == [[59.5, 39.5, 259.5, 239.5]]


def test_what_the_border_of_the_image_cuts_stays() -> None:
    found = TiledDetector(Squares(0.1), 2, 0.6).detect(picture((0, 0, 30)))
    assert found.boxes.tolist() == [[-0.5, -0.5, 29.5, 29.5]]


def test_it_looks_at_the_whole_and_at_each_tile() -> None:
    detector = Squares(0.1)
    TiledDetector(detector, 3, 0.6).detect(picture())
    assert len(detector.asked) == 10 and detector.asked[0] == (300, 400)


@pytest.mark.parametrize(("length", "count"), [(400, 1), (400, 2), (401, 3), (720, 4)])
def test_tiles_cover_the_side_and_overlap(length: int, count: int) -> None:
    found = spans(length, count)
    assert found[0][0] == 0 and found[-1][1] == length and len(found) == count
    for (_, end), (start, _) in itertools.pairwise(found):
        assert (end - start) >= 0.2 * (found[0][1] - found[0][0])
