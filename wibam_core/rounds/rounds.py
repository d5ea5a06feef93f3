"""Find, fit, teach, and find again.

A round fits the vehicles that several cameras see, teaches a network by those of the training part, and looks for
vehicles with it in all frames. What it sees, and what only the detector saw, is looked at again beside the still
backgrounds, associated and fitted. Rounds go on while the agreement between views rises (`rounds.agreement`), which is
judged at instants that nothing was taught by. What the network alone saw counts only where another camera confirms it:
else its mistakes would teach it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wibam_core.association.associate import associate
from wibam_core.config import FinetuneConfig
from wibam_core.dataset.split import split_in_time
from wibam_core.detection.boxes import Found
from wibam_core.detection.instants import annotated, frame_of, frames_of
from wibam_core.detection.one_per_camera import seen_once
from wibam_core.detection.second_look import background_frames, look_again
from wibam_core.documents.rounds import HeldOutAgreement, Round, Rounds
from wibam_core.documents.split import Split
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.lifting.instants import thinned, within_split
from wibam_core.lifting.lift import lift
from wibam_core.models.frames import Frame
from wibam_core.models.network import Network, predict
from wibam_core.networks.registry import load_to_train
from wibam_core.progress import Progress, part, silent
from wibam_core.rounds.agreement import held_out_agreement
from wibam_core.rounds.seen import beside, outlines_of
from wibam_core.rounds.world import Detected, World
from wibam_core.scene import AnnotatedInstant, Boxes2D, FrameKey, Vehicles3D
from wibam_core.training.dataset import site_views
from wibam_core.training.device import choose_device
from wibam_core.training.finetune import SiteDataset, finetune
from wibam_core.training.teachable import Teachable, without

#: Weaker detections of a taught network are not looked at.
_MIN_SCORE = 0.3
#: A step of teaching sees windows of this share of each image: a quarter of the time, for little less.
_CROP_SHARE = 0.4
#: A vehicle is confirmed by other cameras that see it together at so many instants.
_CONFIRMING_INSTANTS = 2
#: A box overlaps one of the detector by more than this where both show the same.
_SAME_IOU = 0.4
#: Agreement is not judged by fewer instants: then by all of the training part, too.
_FEWEST_TO_JUDGE = 8


@dataclass(frozen=True, eq=False)
class Settled:
    """What follows from the boxes of a round.

    Attributes:
        detected: the boxes. instants: with their vehicles. split: in time. fits: at the instants of the split.
    """

    detected: Detected
    instants: list[AnnotatedInstant]
    split: Split
    fits: list[Vehicles3D]
    agreement: HeldOutAgreement


def run_rounds(world: World, detected: Detected, progress: Progress = silent) -> tuple[dict[FrameKey, Boxes2D], Rounds]:
    """The boxes of the last round that raised the agreement, and what each round gained.

    Args:
        world: the recording.
        detected: what the detector found: round 0.
        progress: told now and then.

    Raises:
        NoVehicles, NoMultiViewVehicles, TooFewInstants: as the stages after would.
    """
    most = world.options.rounds.most
    share = 1 / (most + 1)
    best = settled(world, detected, part(progress, 0.0, 0.2 * share))
    rounds = [_round(0, best)]
    kept, reason = 0, "as many rounds as were asked for"
    for number in range(1, most + 1):
        own = part(progress, (number - 0.8) * share, (number + 0.2) * share)
        teaching, finding, fitting = part(own, 0.0, 0.4), part(own, 0.4, 0.85), part(own, 0.85, 1.0)
        taught = _taught(world, best, number, teaching)
        if taught is None:
            reason = "no vehicle of the training part is seen by several cameras"
            break
        network, vehicles = taught
        again = settled(world, _found_again(world, detected, network, finding), fitting, of_detector=detected)
        rounds.append(_round(number, again, vehicles))
        if again.agreement.found is None:
            reason = "no vehicle is seen by two cameras beside the one that is judged: agreement cannot be told"
            break
        before, after = best.agreement.an_instant, again.agreement.an_instant
        if after < (1 + world.options.rounds.least_gain) * before:
            reason = "agreement between views rose no further"
            if after >= before:
                best, kept = again, number
            break
        best, kept = again, number
    progress(1.0, f"round {kept} is kept")
    return dict(best.detected), Rounds(rounds=rounds, kept=kept, reason=reason)


def settled(
    world: World, detected: Detected, progress: Progress = silent, of_detector: Detected | None = None
) -> Settled:
    """Associate, split and fit, and see how well views agree.

    Args:
        world: the recording.
        detected: the boxes of all frames.
        progress: told now and then.
        of_detector: what the detector found; of what is not among it, only what several cameras see is kept.
    """
    options = world.options
    seen = annotated(world.instants, detected)
    instants = associate(seen, world.rig, options.associate, part(progress, 0.0, 0.2), world.poses)
    if of_detector is not None:
        instants, detected = _confirmed(world, instants, detected, of_detector)
    split = split_in_time(instants, options.dataset)
    fitted = lift(thinned(instants, split, options.lift.rate_hz), world.rig, options.lift, part(progress, 0.2, 0.7))
    judges = judging(instants, split)
    agreement = held_out_agreement(judges, world.rig, options.lift, part(progress, 0.7, 1.0))
    return Settled(detected, instants, split, within_split(fitted.vehicles, split), agreement)


def judging(instants: Sequence[AnnotatedInstant], split: Split) -> list[AnnotatedInstant]:
    """The instants after the training part and before the test part; where these are too few, all before the test."""
    end = split.times_ns["test"][0]
    begin = split.times_ns["train"][-1]
    between = [instant for instant in instants if begin < instant.time_ns < end]
    return between if len(between) >= _FEWEST_TO_JUDGE else [one for one in instants if one.time_ns < end]


def _confirmed(
    world: World, instants: Sequence[AnnotatedInstant], detected: Detected, of_detector: Detected
) -> tuple[list[AnnotatedInstant], Detected]:
    """Without the boxes that the detector has none for, of vehicles that never two cameras saw at once."""
    together: Counter[int] = Counter(
        vehicle.track_id for instant in instants for vehicle in instant.vehicles if len(vehicle.views) > 1
    )
    kept_instants: list[AnnotatedInstant] = []
    kept = dict(detected)
    for instant, frames in zip(instants, world.instants, strict=True):
        confirmed = {camera_id: np.zeros(len(seen), dtype=bool) for camera_id, seen in instant.detections.items()}
        for vehicle in instant.vehicles:
            several = len(vehicle.views) > 1
            if several or (vehicle.track_id >= 0 and together[vehicle.track_id] >= _CONFIRMING_INSTANTS):
                for camera_id, row in vehicle.views.items():
                    confirmed[camera_id][row] = True
        out = {}
        for camera_id, seen in instant.detections.items():
            frame = frame_of(frames, camera_id)
            known = image_iou(seen.boxes, of_detector[frame].boxes).max(axis=1, initial=0.0) > _SAME_IOU
            out[camera_id] = ~(confirmed[camera_id] | known)
            kept[frame] = _where(detected[frame], ~out[camera_id])
        kept_instants.append(without(instant, out))
    return kept_instants, kept


def _where(seen: Boxes2D, rows: np.ndarray) -> Boxes2D:
    return Boxes2D(*(values[rows] for values in seen))


def _taught(world: World, state: Settled, number: int, progress: Progress) -> tuple[Network, int] | None:
    """A network that learned from the training part, and by how many vehicles; None where there are none."""
    options = world.options.rounds
    together = {
        vehicle.track_id for instant in state.instants for vehicle in instant.vehicles if len(vehicle.views) > 1
    }
    fits = [of.where(np.isin(of.ids, list(together))) for of in state.fits]
    times = set(state.split.times_ns["train"])
    vehicles = {track for of in fits if of.time_ns in times for track in of.ids.tolist()}
    if not vehicles:
        return None
    config = FinetuneConfig(
        steps=options.steps, steps_per_epoch=options.steps, crop_share=_CROP_SHARE, seed=options.seed
    )
    network = load_to_train(world.start, config)
    teachable = Teachable.of([one for one in state.instants if one.time_ns in times], fits, network.known)
    views = site_views(
        teachable.instants,
        world.store,
        teachable.fits,
        world.rig,
        state.split.left_out_tracks["train"],
        network.view_width_px,
        not_looked_for=teachable.not_looked_for,
    )
    dataset = SiteDataset(world.store, world.rig, views, [])
    finetune(network, dataset, config, progress, world.scratch / f"round{number}")
    return network.runnable(choose_device(config.device)), len(vehicles)


def _found_again(world: World, of_detector: Detected, network: Network, progress: Progress) -> Detected:
    """What the network and the detector see in all frames, after a second look."""
    frames = frames_of(world.instants)
    of_backgrounds = background_frames(frames, world.shown)
    wanted = sorted({*frames, *of_backgrounds})
    looked: dict[FrameKey, Boxes2D] = {}
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
        looked[frame] = _unrefined(beside(seen, of_detector.get(frame, nothing)))
        if number % 50 == 0:
            searching(number / len(wanted), f"finding again: {number} of {len(wanted)} frames")
    config = world.options.detect
    again = dict(look_again(world.store, frames, looked, _never, world.shown, config, part(progress, 0.5, 1.0)))
    return seen_once(again, world.rig) if world.rig.views else again


def _never(frame: FrameKey, image: object) -> Boxes2D:
    raise AssertionError(f"{frame} was looked at before")


def _unrefined(found: Found) -> Boxes2D:
    unknown = np.full((len(found.boxes), 4), np.nan)
    return Boxes2D(found.boxes, found.scores, found.classes, unknown, unknown)


def _round(number: int, state: Settled, taught: int | None = None) -> Round:
    instants = state.instants
    boxes: dict[str, list[int]] = {}
    views: Counter[int] = Counter()
    for instant in instants:
        for camera_id, seen in instant.detections.items():
            boxes.setdefault(camera_id, []).append(len(seen))
        views.update(len(vehicle.views) for vehicle in instant.vehicles)
    return Round(
        number=number,
        boxes_an_image={camera_id: float(np.mean(of)) for camera_id, of in sorted(boxes.items())},
        vehicles_an_instant={str(n): views[n] / len(instants) for n in sorted(views)},
        views_a_vehicle=sum(n * of for n, of in views.items()) / views.total() if views else None,
        fits=sum(len(of) for of in state.fits),
        taught_vehicles=taught,
        agreement=state.agreement,
    )
