"""Ways that are claimed against boxes of vehicles whose ways are known; bodies are those of `tests.multiview`."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders import corner_rig
from tests.multiview import SIZES, body
from wibam_core.config import LiftConfig
from wibam_core.geometry.box3d import vehicle_to_world
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.lifting.headings import HALF_WINDOW_S, headings, telling
from wibam_core.lifting.lift import lift
from wibam_core.lifting.observations import observe
from wibam_core.lifting.trajectory import Motion, Tracks, smooth
from wibam_core.lifting.way_seen import share_seen
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, Detections2D, MultiViewVehicle

KIND = RoadUserClass.VAN
YAW_RAD = 0.4
TIMES_S = np.arange(60) * 0.16
STILL = np.zeros((60, 2))
RIG = corner_rig()
EVERYWHERE = {camera_id: np.ones(60, bool) for camera_id in RIG}
#: From one to the next in a queue, m.
AHEAD = 6.5 * np.array([np.cos(YAW_RAD), np.sin(YAW_RAD)])
PARTS = np.concatenate(body(KIND, np.array(SIZES[KIND]), np.random.default_rng(5)))


def boxes_of(path: np.ndarray, noise_px: float = 0.8) -> dict[str, np.ndarray]:
    """Of a van at the places of ``path`` (T, 2), by each camera: xyxy (T, 4), px."""
    rng = np.random.default_rng(2)
    found = {}
    for camera_id, camera in RIG.items():
        seen = []
        for place in path:
            uv, _ = camera.project(
                vehicle_to_world(np.array([*place, SIZES[KIND][2] / 2, *SIZES[KIND], YAW_RAD]), PARTS)
            )
            seen.append(np.concatenate([uv.min(axis=0), uv.max(axis=0)]))
        found[camera_id] = np.array(seen) + rng.normal(0, noise_px, (len(path), 4))
    return found


def instants_of(
    boxes: dict[str, np.ndarray], claimed: np.ndarray, seen_by: dict[str, np.ndarray]
) -> list[AnnotatedInstant]:
    """One van in every instant, said to be at ``claimed`` (T, 2), in the cameras that see it (T,)."""
    instants = []
    for k, time_s in enumerate(TIMES_S[: len(claimed)]):
        time_ns = round(time_s * 1e9)
        views = {c: 0 for c in boxes if seen_by[c][k]}
        detections = {c: Detections2D(c, time_ns, boxes[c][k : k + 1], [0.9], [KIND.number]) for c in views}
        instants.append(AnnotatedInstant(time_ns, detections, (MultiViewVehicle(0, 0, KIND, *claimed[k], views),)))
    return instants


def share(
    boxes: dict[str, np.ndarray], claimed: np.ndarray, seen_by: dict[str, np.ndarray] | None = None
) -> np.ndarray:
    seen = observe(instants_of(boxes, claimed, seen_by or EVERYWHERE), RIG, 1)
    tracks = Tracks.group(seen.tracks, seen.times_ns)
    velocity = np.gradient(claimed, TIMES_S[: len(claimed)], axis=0)
    state = np.concatenate([claimed, velocity], axis=1)[None]
    motion = Motion(state, np.tile(np.eye(4), (1, len(claimed), 1, 1)))
    return share_seen(seen, list(RIG.values()), tracks, motion, tracks.valid, HALF_WINDOW_S)[0]


def glide(begin_s: float, over_s: float, by_m: tuple[float, float]) -> np.ndarray:
    """Places (T, 2) that a smoother makes of a jump."""
    return np.clip((TIMES_S - begin_s) / over_s, 0, 1)[:, None] * np.array(by_m)


def test_pictures_confirm_a_way_that_was_driven() -> None:
    for speed in (1.0, 2.0):
        along = (speed * (TIMES_S - TIMES_S.mean()))[:, None] * [np.cos(YAW_RAD), np.sin(YAW_RAD)]
        found = share(boxes_of(along), along)
        assert np.median(found) > 0.9
        assert found.min() > 0.7


def test_a_place_that_slides_where_another_camera_joins_was_not_driven_to() -> None:
    joins = {"cam1": EVERYWHERE["cam1"], "cam2": TIMES_S > 4.0}
    boxes = boxes_of(STILL)
    found = share({c: boxes[c] for c in joins}, glide(3.2, 1.6, (1.5, 1.2)), joins)
    assert found[(TIMES_S > 3) & (TIMES_S < 5)].max() < 0.2


def test_who_is_covered_on_one_side_for_a_while_stands() -> None:
    boxes = boxes_of(STILL)
    covered = TIMES_S > 4.0
    for box in boxes.values():
        box[covered, 2] -= 0.4 * (box[covered, 2] - box[covered, 0])
    found = share(boxes, glide(3.2, 1.6, (-1.2, 0.6)))
    assert found[(TIMES_S > 3) & (TIMES_S < 5)].max() < 0.2


def goes_over_to_the_next(path: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Boxes and places of a van in a queue, and from 4.8 s on those of the van behind it, which does as it does."""
    boxes, of_next = boxes_of(path), boxes_of(path - AHEAD)
    late = TIMES_S > 4.8
    for camera_id, box in boxes.items():
        box[late] = of_next[camera_id][late]
    return boxes, path - late[:, None] * AHEAD


@pytest.mark.parametrize("creeps_mps", [0.0, 0.25])
@pytest.mark.parametrize("seed", [0, 1])
def test_boxes_that_go_over_to_the_next_in_a_queue_have_not_driven_there(seed: int, creeps_mps: float) -> None:
    path = creeps_mps * np.maximum(TIMES_S - 6, 0)[:, None] * [np.cos(YAW_RAD), np.sin(YAW_RAD)]
    boxes, places = goes_over_to_the_next(path)
    places = places + np.random.default_rng(seed).normal(0, 0.15, places.shape)
    seen = observe(instants_of(boxes, places, EVERYWHERE), RIG, 1)
    tracks = Tracks.group(seen.tracks, seen.times_ns)
    motion = smooth(tracks, places, np.tile(0.2**2 * np.eye(2), (len(places), 1, 1)))
    confirmed = share_seen(seen, list(RIG.values()), tracks, motion, tracks.valid, HALF_WINDOW_S)
    assert np.isinf(headings(tracks, seen.classes[:1], motion, 0.4, confirmed).sd_rad).all()
    believed = headings(tracks, seen.classes[:1], motion, 0.4, np.ones_like(confirmed))
    assert np.abs(normalise_angle(believed.yaw_rad - YAW_RAD)).min() > 2.5, "by its places alone it reversed"


def test_only_moments_with_a_way_that_could_tell_are_asked_and_the_others_change_nothing() -> None:
    path = np.where(TIMES_S > 5, 0.4 * (TIMES_S - 5) ** 2, 0.0)[:, None] * [np.cos(YAW_RAD), np.sin(YAW_RAD)]
    seen = observe(instants_of(boxes_of(path), path, EVERYWHERE), RIG, 1)
    tracks = Tracks.group(seen.tracks, seen.times_ns)
    motion = smooth(tracks, path, np.tile(0.2**2 * np.eye(2), (60, 1, 1)))
    some = telling(tracks, motion, 0.4)
    assert not some[0, :20].any()
    assert some[0, 40:].all()
    found = [
        headings(
            tracks, seen.classes[:1], motion, 0.4, share_seen(seen, list(RIG.values()), tracks, motion, wanted, 1.5)
        )
        for wanted in (some, tracks.valid)
    ]
    assert np.array_equal(found[0].yaw_rad, found[1].yaw_rad)
    assert np.array_equal(found[0].sd_rad, found[1].sd_rad)
    assert np.abs(found[0].yaw_rad - YAW_RAD).max() < 0.1


def test_a_van_in_a_queue_is_not_lifted_the_wrong_way_round_and_sure_of_it() -> None:
    boxes, places = goes_over_to_the_next(STILL)
    found = lift(instants_of(boxes, places, EVERYWHERE), RIG, LiftConfig()).vehicles
    assert sum(len(v) for v in found) > 50
    for vehicles in found:
        turned = np.abs(normalise_angle(vehicles.boxes[:, 6] - YAW_RAD))
        assert (np.minimum(turned, np.pi - turned) < 0.2).all()
        assert (vehicles.sd[:, 6] > 1.0).all()


def test_a_way_that_no_camera_could_see_is_left_as_it_is() -> None:
    path = np.array([[0.0, 0.0], [5.0, 0.0]])
    once = {"cam1": np.array([True, False]), "cam2": np.array([False, True])}
    boxes = boxes_of(path)
    assert (share({c: boxes[c] for c in once}, path, once) == 1).all()
