"""One box for each road user of what detectors say that box people, two-wheelers and vehicles apart, as COCO does.

Who rides is a person's box over a two-wheeler's: together they are one road user of the two-wheeler's class, in the box
around both. Somebody who pushes a bicycle looks alike and counts as riding it; a second person on it is no road user of
their own. A two-wheeler without a person on it stays, too: often its rider is in its box already, and whether it is
parked shows in that it never moves, as for cars. A person in a vehicle's box whose feet are not at its foot sits in it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wibam_core.detection.boxes import FloatArray, Found
from wibam_core.geometry.boxes2d import areas_px2, intersections_px2, non_maximum_suppression

#: A two-wheeler's box covers at least this share of its rider's.
_RIDDEN_SHARE = 0.25
#: A rider's feet are at most this share of the two-wheeler's height below it; who stands before it is lower.
_FEET_BELOW_SHARE = 0.1
#: A rider's head is at most this share of the two-wheeler's height below its top, where it has the rider in its box.
_HEAD_BELOW_SHARE = 0.2
#: A two-wheeler of which a rider's box covers at least this share was found twice, with and without its rider.
_PART_SHARE = 0.7
#: A vehicle's box covers at least this share of the box of somebody in it, whose lower edge is farther above the
#: vehicle's than this share of its height. Who stands before a vehicle is as low as the vehicle, or lower.
_INSIDE_SHARE, _FOOT_SHARE = 0.9, 0.25


def road_users(vehicles: Found, two_wheelers: Found, persons: Found, nms_iou: float) -> Found:
    """Vehicles, riders and pedestrians, best first.

    Args:
        vehicles: of one image, none found twice; as are the others.
        two_wheelers: of the classes that riders are to have.
        persons: of the class that pedestrians are to have.
        nms_iou: of two people that overlap more, once riders have one box, the weaker is left out.
    """
    rides = _may_ride(persons.boxes, two_wheelers.boxes)
    shares = np.where(rides, _shares(persons.boxes, two_wheelers.boxes), 0.0)
    ridden = _ridden(np.where(shares >= _RIDDEN_SHARE, shares, 0.0))
    boxes, scores = two_wheelers.boxes.copy(), two_wheelers.scores.copy()
    for person in np.flatnonzero(ridden >= 0):
        own = ridden[person]
        low, high = (which(boxes[own], persons.boxes[person]) for which in (np.minimum, np.maximum))
        boxes[own] = np.concatenate([low[:2], high[2:]])
        scores[own] = max(scores[own], persons.scores[person])
    riders = Found(boxes, scores, two_wheelers.classes).where(_single(boxes, ridden))
    walks = np.flatnonzero((ridden < 0) & ~_sits_inside(persons.boxes, vehicles.boxes))
    people = _together(riders, persons.where(walks))
    people = people.where(non_maximum_suppression(people.boxes, people.scores, nms_iou))
    both = _together(vehicles, people)
    return both.where(np.argsort(-both.scores, kind="stable"))


def _together(a: Found, b: Found) -> Found:
    return Found(
        np.concatenate([a.boxes, b.boxes]),
        np.concatenate([a.scores, b.scores]),
        np.concatenate([a.classes, b.classes]),
    )


def _shares(boxes: FloatArray, others: FloatArray) -> FloatArray:
    """(N, M) share of the area of each of N boxes that each of M others covers."""
    return np.asarray(intersections_px2(boxes, others) / np.maximum(areas_px2(boxes), 1e-9)[:, None])


def _may_ride(persons: FloatArray, two_wheelers: FloatArray) -> NDArray[np.bool_]:
    """(N, M) whether a person is over a two-wheeler, and neither before it nor lower than one who sits on it."""
    middle = 0.5 * (persons[:, None, 0] + persons[:, None, 2])
    over = (two_wheelers[:, 0] <= middle) & (middle <= two_wheelers[:, 2])
    height = two_wheelers[:, 3] - two_wheelers[:, 1]
    sits = persons[:, None, 1] <= two_wheelers[:, 1] + _HEAD_BELOW_SHARE * height
    stands_before = persons[:, None, 3] > two_wheelers[:, 3] + _FEET_BELOW_SHARE * height
    return np.asarray(over & sits & ~stands_before)


def _ridden(shares: FloatArray) -> NDArray[np.int64]:
    """(N,) the two-wheeler of each of N persons, −1 for none, of the shares (N, M), 0 where it is not ridden.

    Each two-wheeler gets its best rider first; those who are left are passengers.
    """
    ridden = np.full(len(shares), -1, dtype=np.int64)
    people, two_wheelers = np.nonzero(shares)
    for pair in np.argsort(-shares[people, two_wheelers], kind="stable"):
        person, own = people[pair], two_wheelers[pair]
        if ridden[person] < 0 and own not in ridden:
            ridden[person] = own
    for person in np.setdiff1d(people, np.flatnonzero(ridden >= 0)):
        ridden[person] = shares[person].argmax()
    return ridden


def _single(boxes: FloatArray, ridden: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which of two-wheelers with their riders (M, 4) are not a part of another that is ``ridden``, see `_ridden`."""
    with_rider = np.isin(np.arange(len(boxes)), ridden)
    part = (_shares(boxes, boxes[with_rider]) >= _PART_SHARE).any(axis=1)
    return np.flatnonzero(with_rider | ~part)


def _sits_inside(persons: FloatArray, vehicles: FloatArray) -> NDArray[np.bool_]:
    """(N,) whether a person is in a vehicle, or behind it and seen through its windows."""
    foot = vehicles[:, 3] - _FOOT_SHARE * (vehicles[:, 3] - vehicles[:, 1])
    inside = (_shares(persons, vehicles) >= _INSIDE_SHARE) & (persons[:, None, 3] < foot)
    return np.asarray(inside.any(axis=1))
