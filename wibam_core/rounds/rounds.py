"""Find, fit, teach, and find again, as far as it is needed.

How many of the vehicles that other cameras place has each camera a box of? Where that is nearly all of them, nothing
more is done. Else the first round looks for what moves beside the still backgrounds (`rounds.moving`), which needs no
network. Where that is not enough, or where the detector by itself knows too few of those that move to know those that
stand (`rounds.known`), a round fits the vehicles that several cameras see, teaches a network by those of the
training part, and looks for vehicles with it in all frames. What it sees, and what was found before, is looked at
again beside the still backgrounds and associated (`rounds.settled`). Rounds go on while the agreement between views
rises (`rounds.agreement`), which is judged at instants and of vehicles that nothing was taught by. What no detector saw
counts only where another camera confirms it: else the mistakes of a network would teach it. The same is asked of what a
detector saw on scenery (`rounds.scenery`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from wibam_core.config import FinetuneConfig, RoundsConfig
from wibam_core.detection.boxes import Found
from wibam_core.detection.instants import frame_of, frames_of
from wibam_core.detection.one_per_camera import seen_once
from wibam_core.detection.second_look import background_frames, look_again
from wibam_core.documents.rounds import HeldOutAgreement, Round, Rounds, Source
from wibam_core.errors import NoMultiViewVehicles, TooFewInstants
from wibam_core.geometry.pixels import resized_px, scale_of
from wibam_core.models.frames import Frame
from wibam_core.models.network import Network, predict
from wibam_core.networks.registry import load_to_train
from wibam_core.progress import Progress, part, silent
from wibam_core.rounds.known import share_known
from wibam_core.rounds.moving import Still, beside_what_moves, looked_at_again
from wibam_core.rounds.scenery import ToldApart, among
from wibam_core.rounds.seen import beside, outlines_of
from wibam_core.rounds.settled import Settled, agreement_before_teaching, settled, teaching_fits
from wibam_core.rounds.world import Detected, World
from wibam_core.scene import Boxes2D, FrameKey
from wibam_core.training.dataset import SiteView, site_views
from wibam_core.training.device import choose_device
from wibam_core.training.finetune import SiteDataset, finetune
from wibam_core.training.teachable import Teachable

#: Weaker detections of a taught network are not looked at. Who stands and was found by nobody was taught as background,
#: so that scores of vehicles are about the share of them that was found; other cameras tell which are none.
_MIN_SCORE = 0.2
#: A step of teaching sees windows of this share of each image: a quarter of the time, for little less.
_CROP_SHARE = 0.4
#: Two cameras place a vehicle, and the third is judged.
_FEWEST_CAMERAS = 3
#: Who stands is there for many instants: it is found if two of three cameras have a box of it at two instants in three,
#: as they do if each has one at this share (3 · 0.6² · 0.4 + 0.6³ = 0.65).
_KNOWN_ENOUGH = 0.6
#: Fewer vehicles that cameras should show than this, at the instants that judge, do not say whether a round is needed.
_FEWEST_SIGHTINGS = 20


def run_rounds(world: World, detected: Detected, progress: Progress = silent) -> tuple[dict[FrameKey, Boxes2D], Rounds]:
    """The boxes of the last round that raised the agreement, and what each round gained.

    Where nothing can be judged, the boxes stay as they are: what is wrong is for the stages after to say.

    Args:
        world: the recording.
        detected: what the detector found: round 0.
        progress: told now and then.
    """
    if len({world.rig.mounted_id(camera_id) for camera_id in world.rig}) < _FEWEST_CAMERAS:
        return dict(detected), Rounds(rounds=[], kept=0, reason="it takes three cameras to judge whether rounds help")
    options = world.options.rounds
    sources = _sources(options)
    share = 1 / (len(sources) + 1)
    try:
        best = settled(world, detected, part(progress, 0.0, 0.1 * share))
    except TooFewInstants as error:
        return dict(detected), Rounds(rounds=[], kept=0, reason=error.message)
    rounds = [_round(0, "detector", best)]
    kept, reason = 0, "as many rounds as were asked for"
    need = first_agreement(world, best, part(progress, 0.1 * share, 0.2 * share))
    known: float | None = None
    without_network, of_detector = detected, ToldApart.unasked(detected)
    stills: Mapping[tuple[str, int], Still] = {}
    for number, source in enumerate(sources, 1):
        if _is_enough(need.found, known, options):
            reason = f"cameras have boxes of {need.found:.0%} of the vehicles that the others place, which is enough"
            break
        own = part(progress, (number - 0.8) * share, (number + 0.2) * share)
        teaching, finding, fitting = part(own, 0.0, 0.4), part(own, 0.4, 0.85), part(own, 0.85, 1.0)
        taught = None
        found: Detected
        if source == "motion":
            found, of_detector, stills = beside_what_moves(world, detected, part(own, 0.0, 0.85))
            by_itself, asked_of = detected, of_detector
        elif need.found is None:
            reason = "no vehicle is seen by two cameras beside the one that is judged: agreement cannot be told"
            break
        else:
            taught = _taught(world, best, number, teaching)
            if taught is None:
                reason = "no vehicle of the training part is seen by several cameras"
                break
            found, by_itself, on_scenery = _found_again(world, without_network, taught.network, stills, finding)
            asked_of = ToldApart(of_detector.trusted, on_scenery)
        again = settled(world, found, fitting, of_detector=asked_of)
        left_out = _left_out(of_detector.on_scenery, found, again.detected) if source == "motion" else None
        known = share_known(world.instants[: len(again.before)], again.before, by_itself)
        rounds.append(_round(number, source, again, taught, left_out, known))
        rises = _agrees(rounds[kept], rounds[number], 1 + options.least_gain)
        if _agrees(rounds[kept], rounds[number]):
            best, kept, need = again, number, again.agreement
            if source == "motion":
                without_network, need = again.detected, first_agreement(world, again)
        if source == "network" and not rises:
            reason = "agreement between views rose no further"
            break
    progress(1.0, f"round {kept} is kept")
    return dict(best.detected), Rounds(rounds=rounds, kept=kept, reason=reason)


def _agrees(before: Round, after: Round, times: float = 1.0) -> bool:
    """Whether views agree at least so many times as much after a round.

    A network that takes much for vehicles gives more boxes that agree, too, by chance or as second ones of a vehicle:
    after its round each box has to agree as much as before. True boxes do so more, as each finds more to agree with.
    """
    if after.agreement.found is None or after.agreement.an_instant < times * before.agreement.an_instant:
        return False
    return after.source != "network" or after.agreement_a_box >= before.agreement_a_box


def _is_enough(found: float | None, known: float | None, options: RoundsConfig) -> bool:
    """Whether no further round is needed, by the share of vehicles found that other cameras place, and by that of
    vehicles that move which is known without their motion, where that was looked at."""
    return found is not None and found >= options.enough and (known is None or known >= _KNOWN_ENOUGH)


def _sources(options: RoundsConfig) -> list[Source]:
    """What each round may find boxes with, in order."""
    motion: list[Source] = ["motion"] if options.motion else []
    networks: list[Source] = ["network"] * options.most
    return motion + networks


def first_agreement(world: World, state: Settled, progress: Progress = silent) -> HeldOutAgreement:
    """What says how much the detector overlooks, while nothing has taught.

    That is the agreement after the training part, by which rounds are judged, too; where it rests on few sightings,
    that of all instants before the test part.
    """
    if state.agreement.sightings + state.agreement.missed >= _FEWEST_SIGHTINGS:
        return state.agreement
    return agreement_before_teaching(world, state, progress)


@dataclass(frozen=True, eq=False)
class _Taught:
    """A network that learned from the training part: from so many vehicles, by so many fits to them."""

    network: Network
    vehicles: int
    fits: int


def _taught(world: World, state: Settled, number: int, progress: Progress) -> _Taught | None:
    """None where no vehicle could teach."""
    options = world.options.rounds
    fits = teaching_fits(world, state, part(progress, 0.0, 0.2))
    vehicles = {track for of in fits for track in of.ids.tolist()}
    if not vehicles:
        return None
    config = FinetuneConfig(
        steps=options.steps, steps_per_epoch=options.steps, crop_share=_CROP_SHARE, seed=options.seed
    )
    network = load_to_train(world.start, config)
    times = set(state.split.times_ns["train"])
    teachable = Teachable.of([one for one in state.before if one.time_ns in times], fits, network.known)
    views = site_views(
        teachable.instants,
        world.store,
        teachable.fits,
        world.rig,
        state.split.left_out_tracks["train"],
        network.view_width_px,
        not_looked_for=teachable.not_looked_for,
    )
    frames = {one.time_ns: one for one in world.instants}
    views = [_not_judged(world, view, state.doubtful[frame_of(frames[view.time_ns], view.camera_id)]) for view in views]
    dataset = SiteDataset(world.store, world.rig, views, [])
    try:
        finetune(network, dataset, config, part(progress, 0.2, 1.0), world.scratch / f"round{number}")
    except NoMultiViewVehicles:  # none of the fits lies within an image
        return None
    return _Taught(network.runnable(choose_device(config.device)), len(vehicles), sum(map(len, fits)))


def _not_judged(world: World, view: SiteView, doubtful: Boxes2D) -> SiteView:
    """The view without a judgement of the heat where boxes were that no other camera confirmed."""
    labels = view.pseudo_labels
    scale = scale_of(world.rig[view.camera_id].size_px, labels.camera.size_px, 4)
    ignored = np.concatenate([labels.ignored, resized_px(doubtful.boxes, scale)])
    return replace(view, pseudo_labels=replace(labels, ignored=ignored))


class _FoundAgain(NamedTuple):
    """What is seen in all frames after a network was taught.

    Attributes:
        boxes: what the network sees, and what was found before, after a second look.
        by_itself: what the network sees, before it. on_scenery: those of the boxes that lie on what never changes.
    """

    boxes: dict[FrameKey, Boxes2D]
    by_itself: dict[FrameKey, Boxes2D]
    on_scenery: Detected


def _found_again(
    world: World, before: Detected, network: Network, stills: Mapping[tuple[str, int], Still], progress: Progress
) -> _FoundAgain:
    """Look for vehicles with a network in all frames, beside the stills where these are known."""
    frames = frames_of(world.instants)
    wanted = frames if stills else sorted({*frames, *background_frames(frames, world.shown)})
    looked: dict[FrameKey, Boxes2D] = {}
    alone: dict[FrameKey, Boxes2D] = {}
    nothing = _unrefined(Found(np.empty((0, 4)), np.empty(0), np.empty(0, dtype=np.int64)))
    nms_iou = world.options.detect.nms_iou
    searching = part(progress, 0.0, 0.5)
    inputs = (
        Frame(world.store.image_at(*frame), world.rig[frame.camera_id], frame.camera_id, frame.local_ns)
        for frame in wanted
    )
    found = predict(network, inputs, decode="fitted", min_score=_MIN_SCORE)
    for number, (frame, vehicles) in enumerate(zip(wanted, found, strict=True)):
        seen = outlines_of(vehicles, world.rig[frame.camera_id], nms_iou)
        alone[frame] = _unrefined(seen)
        looked[frame] = _unrefined(beside(seen, before.get(frame, nothing)))
        if number % 50 == 0:
            searching(number / len(wanted), f"finding again: {number} of {len(wanted)} frames")
    if stills:
        again, on_scenery = looked_at_again(world, stills, looked, part(progress, 0.5, 1.0))
        return _FoundAgain(again, alone, on_scenery)
    config = world.options.detect
    again = dict(look_again(world.store, frames, looked, _never, world.shown, config, part(progress, 0.5, 1.0)))
    again = seen_once(again, world.rig) if world.rig.views else again
    return _FoundAgain(again, alone, ToldApart.unasked(again).on_scenery)


def _never(frame: FrameKey, image: object) -> Boxes2D:
    raise AssertionError(f"{frame} was looked at before")


def _unrefined(found: Found) -> Boxes2D:
    unknown = np.full((len(found.boxes), 4), np.nan)
    return Boxes2D(found.boxes, found.scores, found.classes, unknown, unknown)


def _left_out(on_scenery: Detected, before: Detected, after: Detected) -> int:
    """How many boxes on scenery were there before, and are not after other cameras were asked."""

    def there(found: Detected) -> int:
        return sum(int(among(of.boxes, found[frame].boxes).sum()) for frame, of in on_scenery.items())

    return there(before) - there(after)


def _round(
    number: int,
    source: Source,
    state: Settled,
    taught: _Taught | None = None,
    left_out: int | None = None,
    known: float | None = None,
) -> Round:
    boxes: dict[str, list[int]] = {}
    views: Counter[int] = Counter()
    for instant in state.before:
        for camera_id, seen in instant.detections.items():
            boxes.setdefault(camera_id, []).append(len(seen))
        views.update(len(vehicle.views) for vehicle in instant.vehicles)
    return Round(
        number=number,
        source=source,
        boxes_an_image={camera_id: float(np.mean(of)) for camera_id, of in sorted(boxes.items())},
        vehicles_an_instant={str(n): views[n] / len(state.before) for n in sorted(views)},
        views_a_vehicle=sum(n * of for n, of in views.items()) / views.total() if views else None,
        taught_vehicles=None if taught is None else taught.vehicles,
        taught_fits=None if taught is None else taught.fits,
        scenery_left_out=left_out,
        known_share=known,
        agreement=state.agreement,
    )
