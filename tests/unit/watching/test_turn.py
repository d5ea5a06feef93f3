from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.builders import corner_rig
from wibam_core.documents.watching import CameraTurned, CameraWatched, Stretch, Watched
from wibam_core.formats.usual import STILL_WIDTH_PX, Gray, Usual, read_usual, write_usual
from wibam_core.watching.drift import doubts, looked_at
from wibam_core.watching.turn import Turn, turn_between, turned
from wibam_core.watching.usual import Noticed, still_picture

RIG = corner_rig(2)
CAMERA = RIG["cam1"]


def scene(seed: int = 0) -> Gray:
    """A picture with edges everywhere: streets, houses, posts."""
    rng = np.random.default_rng(seed)
    picture = np.full((480, STILL_WIDTH_PX), 120, np.uint8)
    for _ in range(220):
        x, y = rng.integers(0, (STILL_WIDTH_PX, 480)).tolist()
        w, h = rng.integers(8, 70, 2).tolist()
        cv2.rectangle(picture, (x, y), (x + w, y + h), int(rng.integers(40, 220)), -1)
    return picture


def seen_turned(picture: Gray, rotation_deg: tuple[float, float, float]) -> Gray:
    """What the camera shows after a turn: everything lies at K R_new_old K⁻¹ of where it lay."""
    K = CAMERA.resized(picture.shape[1], picture.shape[0]).K
    R_old_new = cv2.Rodrigues(np.deg2rad(rotation_deg))[0]
    H = K @ R_old_new.T @ np.linalg.inv(K)
    return cv2.warpPerspective(picture, H, (picture.shape[1], picture.shape[0]), borderMode=cv2.BORDER_REFLECT)


@pytest.mark.parametrize("rotation_deg", [(0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.0, -0.8, 0.0), (0.2, 0.5, 1.0)])
def test_a_turn_is_found_to_a_fortieth_of_a_degree(rotation_deg: tuple[float, float, float]) -> None:
    before = scene()
    turn = turn_between(before, seen_turned(before, rotation_deg), CAMERA)
    assert turn is not None
    assert np.rad2deg(turn.rotation_rad) == pytest.approx(rotation_deg, abs=0.025)
    assert turn.agree > 0.8


def test_other_light_and_somebody_who_stands_there_change_little() -> None:
    before = scene()
    after = seen_turned(before, (0.0, 0.5, 0.0)).astype(np.float64)
    shade = np.linspace(0.4, 1.0, STILL_WIDTH_PX)  # the sun has moved on
    after = np.clip(after * shade + 10 + np.random.default_rng(1).normal(0, 3, after.shape), 0, 255).astype(np.uint8)
    after[200:320, 250:400] = 200
    turn = turn_between(before, after, CAMERA)
    assert turn is not None
    assert np.rad2deg(turn.rotation_rad) == pytest.approx((0.0, 0.5, 0.0), abs=0.04)


def test_another_place_is_no_turn() -> None:
    turn = turn_between(scene(0), scene(1), CAMERA)
    assert turn is None or turn.agree < 0.5
    assert turn_between(scene(), np.full((480, STILL_WIDTH_PX), 7, np.uint8), CAMERA) is None, "night"
    assert turn_between(scene(), scene()[:-8], CAMERA) is None, "another size"


def test_convention_a_camera_that_is_turned_sees_a_point_where_its_picture_moved_to() -> None:
    rotation = np.deg2rad((0.3, -0.6, 0.9))
    turn = Turn((float(rotation[0]), float(rotation[1]), float(rotation[2])), 50, 1.0, 0.1)
    point = np.array([[2.0, 1.0, 0.0]])
    then, _ = CAMERA.project(point)
    now, _ = turned(CAMERA, turn).project(point)
    H = CAMERA.K @ cv2.Rodrigues(rotation)[0].T @ np.linalg.inv(CAMERA.K)
    moved = H @ [*then[0], 1.0]
    assert now[0] == pytest.approx(moved[:2] / moved[2], abs=1e-6)


def looks(pictures: list[Gray]) -> list[CameraTurned]:
    noted: list[CameraTurned] = []
    for number, picture in enumerate(pictures):
        noted += [look for _, look in looked_at({"cam1": scene()}, {"cam1": picture}, RIG, number, noted)]
    return noted


def test_what_changes_is_noted_once_and_small_turns_are_corrected_both_ways() -> None:
    still, off = scene(), seen_turned(scene(), (0.0, 0.5, 0.0))
    noted = looks([still, still, off, off, still])
    assert [(look.time_ns, look.corrected) for look in noted] == [(0, False), (2, True), (4, True)]
    assert noted[1].angle_deg == pytest.approx(0.5, abs=0.03)
    assert noted[2].angle_deg < 0.05


def watched(turns: list[CameraTurned], **camera: float | None) -> Watched:
    facts = {"images": 1000, "boxes": 2000, "score": 0.8, "usual_score": 0.8, "usual_boxes_an_image": 2.0} | camera
    return Watched(
        start_ns=0,
        end_ns=10,
        dated=False,
        instants=1,
        cameras={"cam1": CameraWatched(footage=[Stretch(from_ns=0, to_ns=10)], **facts)},
        turns=turns,
        tracks=0,
        by_class={},
        continued=False,
    )


def test_what_is_said_of_it() -> None:
    def codes(document: Watched, compared: tuple[str, ...] = ("cam1",)) -> list[str]:
        return [caution.code for caution in doubts(document, compared)]

    still, off = scene(), seen_turned(scene(), (0.0, 0.5, 0.0))
    assert codes(watched(looks([still]))) == []
    assert codes(watched(looks([still, off]))) == ["camera_turned"]
    assert codes(watched(looks([seen_turned(scene(), (0.0, 3.4, 0.0))]))) == ["camera_moved"]
    assert codes(watched([])) == ["background_unlike"]
    assert codes(watched([], score=0.65), ()) == ["scores_fell"]
    assert codes(watched([], boxes=300), ()) == ["fewer_road_users"]
    assert codes(watched([], boxes=300, images=100), ()) == [], "too few pictures to tell"


def test_what_is_usual_is_the_median_of_pictures_and_a_mean_of_scores(tmp_path) -> None:
    noticed = Noticed(60.0)
    empty = np.full((90, 160, 3), 100, np.uint8)
    for number in range(40):
        picture = empty.copy()
        picture[:, 4 * number : 4 * number + 20] = 250  # somebody drives by
        noticed.see("cam1", number * 2_000_000_000, picture)
        noticed.find("cam1", np.array([0.5, 0.9]) if number % 2 else np.empty(0))
    usual = noticed.usual()
    assert (usual.stills["cam1"] == still_picture(empty)).all()
    found = usual.found["cam1"]
    assert (found.images, found.boxes, found.score) == (40, 40, pytest.approx(0.7))
    write_usual(tmp_path / "usual.npz", usual)
    again = read_usual(tmp_path / "usual.npz")
    assert again.found == usual.found
    np.testing.assert_array_equal(again.stills["cam1"], usual.stills["cam1"])
    assert isinstance(again, Usual)
