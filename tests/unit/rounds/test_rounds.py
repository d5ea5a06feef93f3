"""Rounds: when they go on, what they keep, and one that teaches and looks for real."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.multiview import crossing
from wibam_core.config import AssociateConfig, DatasetConfig, DetectConfig, LiftConfig, RoundsConfig
from wibam_core.detection.instants import by_frame
from wibam_core.detection.second_look import backgrounds_shown
from wibam_core.documents.rounds import HeldOutAgreement, Round, Source
from wibam_core.formats.framestore import FrameStore, FrameStoreWriter
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import load_to_detect
from wibam_core.progress import silent
from wibam_core.rounds import rounds
from wibam_core.rounds.agreement import held_out_agreement
from wibam_core.rounds.moving import BesideWhatMoves
from wibam_core.rounds.rounds import run_rounds
from wibam_core.rounds.scenery import ToldApart
from wibam_core.rounds.settled import judging, settled, teaching_fits
from wibam_core.rounds.world import Detected, Options, World
from wibam_core.scene import Boxes2D, CameraRig, FrameKey

SHORT = DatasetConfig(rate_hz=6.25, train_share=0.5, val_share=0.3, gap_s=0.2)
#: Fits that have not settled to the last digit: good enough to tell which boxes agree.
QUICK = LiftConfig(iterations=8)


def options(most: int = 3, enough: float = 1.0, motion: bool = False) -> Options:
    asked = RoundsConfig(most=most, enough=enough, motion=motion, steps=2)
    return Options(asked, DetectConfig(), AssociateConfig(), SHORT, QUICK)


def some(boxes: Boxes2D, rows: np.ndarray) -> Boxes2D:
    return Boxes2D(*(values[rows] for values in boxes))


@pytest.fixture(scope="module")
def everything() -> tuple[World, dict[FrameKey, Boxes2D]]:
    scene = crossing()
    instants, detected = by_frame(scene.unassociated[::2])
    world = World(scene.rig, {}, None, instants, {}, Path(), options(), Path())  # type: ignore[arg-type]
    return world, detected


def overlooking(detected: Detected, share: float) -> dict[FrameKey, Boxes2D]:
    """What a detector finds that overlooks a share of what there is: the lower part of each image."""
    few = {}
    for frame, boxes in detected.items():
        order = np.argsort(boxes.boxes[:, 3])
        few[frame] = some(boxes, np.sort(order[: round(len(order) * (1 - share))]))
    return few


def beside(found: Detected, of_detector: Detected) -> BesideWhatMoves:
    """What moves beside what a detector found, none of it on scenery."""
    return BesideWhatMoves(dict(found), ToldApart.unasked(of_detector), {})


def again(found: Detected, by_itself: Detected | None = None) -> rounds._FoundAgain:
    """What a network finds, none of it on scenery."""
    alone = found if by_itself is None else by_itself
    return rounds._FoundAgain(dict(found), dict(alone), ToldApart.unasked(found).on_scenery)


def finding(monkeypatch: pytest.MonkeyPatch, *found: Detected) -> list[int]:
    """Networks that find these, one a round; says how many vehicles taught each."""
    left, taught = list(found), []

    def teach(world: World, state: rounds.Settled, number: int, progress: object) -> rounds._Taught:
        taught.append(number)
        return rounds._Taught(None, 7, 70)  # type: ignore[arg-type]

    monkeypatch.setattr(rounds, "_taught", teach)
    monkeypatch.setattr(rounds, "_found_again", lambda *given: again(left.pop(0)))
    return taught


def test_a_round_that_finds_more_is_kept_and_one_that_finds_no_more_is_the_last(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, detected = everything
    few, more = overlooking(detected, 0.3), overlooking(detected, 0.2)
    taught = finding(monkeypatch, more, more, detected)
    found, document = run_rounds(world, few)
    assert taught == [1, 2] and document.kept == 2 and "no further" in document.reason
    assert [one.number for one in document.rounds] == [0, 1, 2]
    first, second, third = (one.agreement for one in document.rounds)
    assert second.an_instant > 1.2 * first.an_instant
    assert third.an_instant == second.an_instant  # the same boxes
    assert [one.taught_vehicles for one in document.rounds] == [None, 7, 7, 7][: len(document.rounds)]
    assert sum(len(boxes.boxes) for boxes in found.values()) > sum(len(boxes.boxes) for boxes in few.values())


def test_what_agrees_less_is_not_kept(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, detected = everything
    worse = {frame: boxes._replace(boxes=boxes.boxes + 12.0) for frame, boxes in detected.items()}
    finding(monkeypatch, worse)
    found, document = run_rounds(world, detected)
    assert document.kept == 0 and len(document.rounds) == 2
    assert found.keys() == detected.keys()
    assert all(np.array_equal(found[frame].boxes, detected[frame].boxes) for frame in detected)


def test_a_network_that_sees_much_where_others_see_nothing_is_not_kept() -> None:
    def after(source: Source, boxes: float, an_instant: float, found: float | None = 0.85) -> Round:
        agreement = HeldOutAgreement(
            instants=60, sightings=800, iou=0.6, missed=150, found=found, an_instant=an_instant
        )
        of_cameras = {"one": 0.75 * boxes, "two": 0.25 * boxes}
        return Round(
            number=1, source=source, boxes_an_image=of_cameras, vehicles_an_instant={}, views_a_vehicle=None,
            agreement=agreement,
        )  # fmt: skip

    before = after("motion", 32.0, 9.1)
    assert not rounds._agrees(before, after("network", 53.0, 10.9)), "each box agrees less"
    assert rounds._agrees(before, after("network", 36.0, 10.9)), "each box agrees more"
    assert rounds._agrees(before, after("motion", 53.0, 10.9)), "what moves is there"
    assert not rounds._agrees(before, after("network", 30.0, 9.0)), "less is found"
    assert not rounds._agrees(before, after("network", 36.0, 10.9, found=None))
    assert not rounds._agrees(before, after("network", 36.0, 9.2), 1.02)


def test_two_cameras_cannot_judge_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = {camera_id: camera for camera_id, camera in crossing().rig.items() if camera_id in ("cam1", "cam2")}
    world = World(CameraRig(rig), {}, None, [], {}, Path(), options(), Path())  # type: ignore[arg-type]
    taught = finding(monkeypatch, {})
    _, document = run_rounds(world, {})
    assert taught == [] and document.kept == 0 and "three cameras" in document.reason


def test_where_no_vehicle_can_be_judged_nothing_is_taught(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, detected = everything
    blind = {
        frame: boxes if frame.camera_id == "cam1" else some(boxes, np.empty(0, np.int64))
        for frame, boxes in detected.items()
    }
    taught = finding(monkeypatch, detected)
    found, document = run_rounds(world, blind)
    assert taught == [] and document.kept == 0 and "cannot be told" in document.reason
    assert sum(len(boxes.boxes) for boxes in found.values()) == sum(len(boxes.boxes) for boxes in blind.values())


def test_a_round_is_run_where_much_is_overlooked_and_none_where_little_is(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, detected = everything
    world = replace(world, options=options(enough=RoundsConfig().enough))
    for share, expected in ((0.0, []), (0.3, [1])):
        taught = finding(monkeypatch, detected)
        _, document = run_rounds(world, overlooking(detected, share))
        assert taught == expected and "which is enough" in document.reason
        assert document.kept == len(expected)


def test_a_network_is_taught_only_where_what_moves_is_not_enough(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, detected = everything
    world = replace(world, options=options(most=1, enough=RoundsConfig().enough, motion=True))
    few = overlooking(detected, 0.3)
    taught = finding(monkeypatch)
    monkeypatch.setattr(rounds, "beside_what_moves", lambda world, found, progress: beside(dict(detected), found))
    _, document = run_rounds(world, few)
    assert taught == [] and document.kept == 1 and "which is enough" in document.reason
    assert [one.source for one in document.rounds] == ["detector", "motion"]

    # a little more moves than was found, which is not enough: a network looks for more beside it
    places: list[int] = []
    more = overlooking(detected, 0.25)

    def found_again(world: World, before: Detected, *others: object) -> rounds._FoundAgain:
        places.append(sum(len(boxes.boxes) for boxes in before.values()))
        return again(detected)

    taught = finding(monkeypatch)
    monkeypatch.setattr(rounds, "_found_again", found_again)
    monkeypatch.setattr(rounds, "beside_what_moves", lambda world, found, progress: beside(more, found))
    _, document = run_rounds(replace(world, options=options(most=1, motion=True)), few)
    assert taught == [2] and document.kept == 2
    assert [one.source for one in document.rounds] == ["detector", "motion", "network"]
    assert places[0] > 1.01 * sum(len(boxes.boxes) for boxes in few.values())


def test_a_network_is_taught_where_the_detector_knows_few_of_those_that_move(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Views agree then, of what moves; of who stands nothing is known but by a network."""
    world, detected = everything
    world = replace(world, options=options(most=3, enough=RoundsConfig().enough, motion=True))
    few = overlooking(detected, 0.55)
    monkeypatch.setattr(rounds, "beside_what_moves", lambda world, found, progress: beside(dict(detected), found))
    taught = finding(monkeypatch, detected)
    _, document = run_rounds(world, few)
    assert taught == [2] and [one.source for one in document.rounds] == ["detector", "motion", "network"]
    none, of_detector, of_network = (one.known_share for one in document.rounds)
    assert none is None and 0.2 < (of_detector or 0) < 0.6 and (of_network or 0) > 0.95
    assert (document.rounds[1].agreement.found or 0) > 0.9


def test_what_no_camera_confirmed_is_not_judged_where_it_teaches(
    everything: tuple[World, dict[FrameKey, Boxes2D]],
) -> None:
    world, detected = everything
    one = np.array([[300.0, 300.0, 330.0, 318.0]])
    unknown = np.full((1, 4), np.nan)
    more = Boxes2D(one, np.ones(1), np.zeros(1, np.int64), unknown, unknown)
    haunted = {
        frame: Boxes2D(*(np.concatenate(both) for both in zip(boxes, more, strict=True)))
        if frame.camera_id == "cam1"
        else boxes
        for frame, boxes in detected.items()
    }
    nothing = ToldApart.unasked(detected).on_scenery
    of_scenery = {frame: more if frame.camera_id == "cam1" else nothing[frame] for frame in detected}
    moves, stands = (
        settled(world, haunted, of_detector=ToldApart(detected, scenery)).doubtful for scenery in (nothing, of_scenery)
    )
    frames = [frame for frame in detected if frame.camera_id == "cam1"]
    assert np.mean([(moves[frame].boxes == one).all(axis=1).any() for frame in frames]) > 0.8
    assert not any((stands[frame].boxes == one).all(axis=1).any() for frame in frames)


def test_what_moves_is_looked_for_where_the_detector_found_nothing(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, detected = everything
    nothing = {frame: some(boxes, np.empty(0, np.int64)) for frame, boxes in detected.items()}
    taught = finding(monkeypatch)
    monkeypatch.setattr(rounds, "beside_what_moves", lambda world, found, progress: beside(dict(detected), found))
    found, document = run_rounds(replace(world, options=options(most=0, enough=0.5, motion=True)), nothing)
    assert taught == [] and document.kept == 1
    assert sum(len(boxes.boxes) for boxes in found.values()) > 100


def test_what_moves_and_agrees_less_is_not_kept_and_a_network_is_taught_all_the_same(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, detected = everything
    few = overlooking(detected, 0.3)
    worse = {frame: boxes._replace(boxes=boxes.boxes + 12.0) for frame, boxes in few.items()}
    taught = finding(monkeypatch, detected)
    monkeypatch.setattr(rounds, "beside_what_moves", lambda world, found, progress: beside(worse, found))
    _, document = run_rounds(replace(world, options=options(most=1, motion=True)), few)
    assert taught == [2] and document.kept == 2 and len(document.rounds) == 3


def test_footage_that_is_too_short_is_left_to_the_stages_after(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, detected = everything
    taught = finding(monkeypatch, detected)
    found, document = run_rounds(replace(world, instants=world.instants[:6]), detected)
    assert taught == [] and document.rounds == [] and document.reason
    assert found.keys() == detected.keys()


def test_what_the_test_part_shows_changes_neither_what_teaches_nor_what_judges(
    everything: tuple[World, dict[FrameKey, Boxes2D]],
) -> None:
    world, detected = everything
    begin = settled(world, detected).split.times_ns["test"][0]
    test_part = {one.time_ns for one in world.instants if one.time_ns >= begin}
    # others drive there than those that are seen before
    other = {
        frame: boxes._replace(boxes=boxes.boxes[:, [0, 1, 2, 3]] + [40.0, 15.0, 40.0, 15.0])
        if frame.local_ns in test_part
        else boxes
        for frame, boxes in detected.items()
    }
    one, two = (settled(world, of, of_detector=ToldApart.unasked(of)) for of in (detected, other))
    assert one.agreement == two.agreement and one.agreement.sightings > 20
    fits = [teaching_fits(world, state) for state in (one, two)]
    assert sum(map(len, fits[0])) > 5
    for first, second in zip(*fits, strict=True):
        assert first.time_ns == second.time_ns <= one.split.times_ns["train"][-1]
        assert np.array_equal(first.boxes, second.boxes) and np.array_equal(first.ids, second.ids)


def test_vehicles_that_teach_are_not_judged(everything: tuple[World, dict[FrameKey, Boxes2D]]) -> None:
    world, detected = everything
    state = settled(world, detected)
    judges = judging(state.before, state.split)
    assert judges[0].time_ns > state.split.times_ns["train"][-1]
    left = sorted({v.track_id for instant in judges for v in instant.vehicles if len(v.views) > 2})
    everyone = held_out_agreement(judges, world.rig, QUICK)
    some_taught = held_out_agreement(judges, world.rig, QUICK, taught=frozenset(left[:1]))
    assert 0 < some_taught.sightings < everyone.sightings
    # whoever is there in the training part and after it is left out of one of the two
    teaching = {track for fits in teaching_fits(world, state) for track in fits.ids.tolist()}
    validating = set(state.split.times_ns["val"])
    later = {v.track_id for instant in state.before if instant.time_ns in validating for v in instant.vehicles}
    assert teaching and later and not teaching & later


def test_no_more_rounds_than_asked_for(
    everything: tuple[World, dict[FrameKey, Boxes2D]], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, detected = everything
    taught = finding(monkeypatch, overlooking(detected, 0.2))
    _, document = run_rounds(replace(world, options=options(most=1)), overlooking(detected, 0.3))
    assert taught == [1] and document.kept == 1 and "as many" in document.reason


def test_what_a_network_sees_in_one_camera_alone_is_dropped_and_what_the_detector_saw_stays(
    everything: tuple[World, dict[FrameKey, Boxes2D]],
) -> None:
    world, detected = everything
    ghost = np.array([[300.0, 300.0, 330.0, 318.0]])  # at a place where one camera sees something that never moves
    unknown = np.full((1, 4), np.nan)
    more = Boxes2D(ghost, np.ones(1), np.zeros(1, np.int64), unknown, unknown)
    haunted = {
        frame: Boxes2D(*(np.concatenate(both) for both in zip(boxes, more, strict=True)))
        if frame.camera_id == "cam1"
        else boxes
        for frame, boxes in detected.items()
    }

    def count(found: Detected) -> int:
        return sum(int((boxes.boxes == ghost[0]).all(axis=1).sum()) for boxes in found.values())

    frames = sum(frame.camera_id == "cam1" for frame in detected)
    assert count(haunted) == frames
    assert count(settled(world, haunted, of_detector=ToldApart.unasked(detected)).detected) < 0.2 * frames
    assert count(settled(world, haunted, of_detector=ToldApart.unasked(haunted)).detected) == frames
    # the same where the detector saw it, but on scenery
    on_scenery = {f: more if f.camera_id == "cam1" else some(more, np.empty(0, np.int64)) for f in detected}
    left = settled(world, haunted, of_detector=ToldApart(detected, on_scenery)).detected
    assert count(left) < 0.1 * frames
    for frame, boxes in detected.items():
        assert (left[frame].boxes[:, None] == boxes.boxes).all(axis=-1).any(axis=0).all()


def test_what_lies_on_scenery_stays_where_several_cameras_have_it_and_else_goes(
    everything: tuple[World, dict[FrameKey, Boxes2D]],
) -> None:
    world, detected = everything
    nothing = ToldApart.unasked(detected).on_scenery

    def kept(found: Detected) -> float:
        left = settled(world, found, of_detector=ToldApart(nothing, found)).detected
        return sum(len(of.boxes) for of in left.values()) / sum(len(of.boxes) for of in found.values())

    assert 0.8 < kept(detected) < 1.0  # some are seen by one camera alone for most of their way
    of_one = {frame: boxes if frame.camera_id == "cam1" else nothing[frame] for frame, boxes in detected.items()}
    assert kept(of_one) == 0.0


def test_a_round_teaches_and_looks_again_in_all_frames(tmp_path: Path) -> None:
    scene = crossing()
    instants, detected = by_frame(scene.unassociated[::4])
    image = np.full((360, 640, 3), 100, np.uint8)
    with FrameStoreWriter(tmp_path / "frames", 80) as writer:
        for one in instants:
            for camera, local_ns in one.local_times_ns.items():
                writer.add(camera, one.time_ns, local_ns, image)
        writer.close()
    store = FrameStore(tmp_path / "frames")
    shown = backgrounds_shown(store, {camera: store.stored_ns(camera) for camera in scene.rig}, 120.0, None)
    split = DatasetConfig(rate_hz=6.25, train_share=0.45, val_share=0.25, gap_s=0.1)
    asked = replace(options(most=1), dataset=split)
    world = World(scene.rig, {}, store, store.frame_sets, shown, bundled("mono_small.safetensors"), asked, tmp_path)
    found, document = run_rounds(world, detected)
    assert found.keys() == detected.keys() and [one.number for one in document.rounds] == [0, 1]
    assert (document.rounds[1].taught_vehicles or 0) > 0
    # a network that two steps taught sees nothing in grey images: what the detector found is looked at a second time
    looked = settled(world, rounds._found_again(world, detected, load_to_detect(world.start), {}, silent).boxes)
    assert looked.detected.keys() == detected.keys()
    for frame, boxes in looked.detected.items():
        assert len(boxes.boxes) <= len(detected[frame].boxes) + 2
        assert np.isfinite(boxes.amodal_boxes).all()
