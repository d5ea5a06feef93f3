"""What follows from the boxes of a round: vehicles, what of them may teach, and how well views agree.

What teaches and what judges comes from the instants before the test part, which are associated by themselves: vehicles
of the test part are not among it. Its boxes have a say through the cameras alone, which the stage refines once before
the first round by what the detector found at all instants. Boxes from there on are only told apart from what no other
camera confirms.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wibam_core.association.associate import associate
from wibam_core.dataset.split import seen_later, split_in_time
from wibam_core.detection.instants import annotated, frame_of
from wibam_core.documents.rounds import HeldOutAgreement
from wibam_core.documents.split import Split
from wibam_core.errors import NoMultiViewVehicles, NoVehicles
from wibam_core.geometry.boxes2d import image_iou
from wibam_core.lifting.instants import thinned, within_split
from wibam_core.lifting.lift import lift
from wibam_core.progress import Progress, part, silent
from wibam_core.rounds.agreement import held_out_agreement
from wibam_core.rounds.broken import broken_tracks
from wibam_core.rounds.scenery import ToldApart, among
from wibam_core.rounds.seen import SAME_IOU
from wibam_core.rounds.world import Detected, World
from wibam_core.scene import AnnotatedInstant, Boxes2D, FrameKey, FrameSet, Vehicles3D
from wibam_core.training.teachable import without

#: A vehicle is confirmed by other cameras that see it together at so many instants.
_CONFIRMING_INSTANTS = 2
#: What lies on scenery is one that stands there if other cameras see it, too, at this share of the instants.
_CONFIRMING_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Settled:
    """What follows from the boxes of a round.

    Attributes:
        detected: the boxes of all frames.
        before: the instants before the test part, with their vehicles.
        split: in time; of each part the vehicles are left out that are there later, but before the test part.
        agreement: between views, of vehicles that teach nothing.
        doubtful: boxes that were dropped, since no other camera confirmed them, though something moved there.
    """

    detected: Detected
    before: list[AnnotatedInstant]
    split: Split
    agreement: HeldOutAgreement
    doubtful: Detected


def settled(
    world: World, detected: Detected, progress: Progress = silent, of_detector: ToldApart | None = None
) -> Settled:
    """Associate, split, and see how well views agree.

    Args:
        world: the recording.
        detected: the boxes of all frames.
        progress: told now and then.
        of_detector: what the detector found; of what is not among it, and of what lies on scenery, only what several
            cameras see is kept.

    Raises:
        TooFewInstants: the footage is too short to be split.
    """
    options = world.options
    times_ns = split_in_time(annotated(world.instants, detected), options.dataset).times_ns
    earlier = [instant for instant in world.instants if instant.time_ns < times_ns["test"][0]]
    later = world.instants[len(earlier) :]
    before = _associated(world, earlier, detected, part(progress, 0.0, 0.4))
    nothing = np.empty(0, dtype=np.int64)
    doubtful = {frame: boxes.where(nothing) for frame, boxes in detected.items()}
    if of_detector is not None:
        confirmed = dict(detected)
        before = _confirmed(earlier, before, of_detector, confirmed, doubtful)
        # their vehicles are found again, beside all others, by the stages after
        _confirmed(later, _associated(world, later, detected), of_detector, confirmed, doubtful)
        detected = confirmed
    split = Split(times_ns=times_ns, left_out_tracks=seen_later(before, times_ns))
    own = part(progress, 0.4, 1.0)
    teaching = _teaching_tracks(before, split)
    taught = teaching | broken_tracks(before, teaching, times_ns["train"][-1], options.associate)
    agreement = held_out_agreement(judging(before, split), world.rig, options.lift, own, taught=taught)
    return Settled(detected, before, split, agreement, doubtful)


def agreement_before_teaching(world: World, state: Settled, progress: Progress = silent) -> HeldOutAgreement:
    """That of all instants before the test part and of all vehicles, which says most while nothing has taught."""
    instants = thinned(state.before, state.split, world.options.lift.rate_hz)
    return held_out_agreement(instants, world.rig, world.options.lift, progress)


def judging(instants: Sequence[AnnotatedInstant], split: Split) -> list[AnnotatedInstant]:
    """The instants after the training part and before the test part."""
    begin, end = split.times_ns["train"][-1], split.times_ns["test"][0]
    return [instant for instant in instants if begin < instant.time_ns < end]


def teaching_fits(world: World, state: Settled, progress: Progress = silent) -> list[Vehicles3D]:
    """Fits of the training part, made of it alone, to vehicles that several cameras see together in it."""
    end = state.split.times_ns["train"][-1]
    instants = [instant for instant in state.before if instant.time_ns <= end]
    together = [v.track_id for instant in instants for v in instant.vehicles if len(v.views) > 1]
    options = world.options.lift
    fitted = lift(thinned(instants, state.split, options.rate_hz), world.rig, options, progress).vehicles
    return [fits.where(np.isin(fits.ids, together)) for fits in within_split(fitted, state.split)]


def _teaching_tracks(instants: Sequence[AnnotatedInstant], split: Split) -> frozenset[int]:
    times = set(split.times_ns["train"])
    return frozenset(
        vehicle.track_id
        for instant in instants
        if instant.time_ns in times
        for vehicle in split.may_teach("train", instant)
    )


def _associated(
    world: World, instants: Sequence[FrameSet], detected: Detected, progress: Progress = silent
) -> list[AnnotatedInstant]:
    """The instants with their vehicles; without any where no two cameras see one."""
    seen = annotated(instants, detected)
    try:
        return associate(seen, world.rig, world.options.associate, progress, world.poses)
    except (NoVehicles, NoMultiViewVehicles):
        return seen


def _confirmed(
    frames: Sequence[FrameSet],
    instants: Sequence[AnnotatedInstant],
    of_detector: ToldApart,
    kept: dict[FrameKey, Boxes2D],
    doubtful: dict[FrameKey, Boxes2D],
) -> list[AnnotatedInstant]:
    """Without the boxes that the detector has none for, of vehicles that never two cameras saw at once.

    What lies on scenery needs more: boxes on the same scenery meet now and then, those of who stands there mostly do.

    Args:
        frames: of each instant.
        instants: with their vehicles.
        of_detector: what the detector found.
        kept: all boxes of the frames; those that are dropped are taken from it.
        doubtful: gets those that are dropped and lie on no scenery.
    """
    together: Counter[int] = Counter()
    seen_at: Counter[int] = Counter()
    for instant in instants:
        seen_at.update(vehicle.track_id for vehicle in instant.vehicles)
        together.update(vehicle.track_id for vehicle in instant.vehicles if len(vehicle.views) > 1)
    left = []
    for instant, of in zip(instants, frames, strict=True):
        confirmed, mostly = (
            {camera_id: np.zeros(len(seen), dtype=bool) for camera_id, seen in instant.detections.items()}
            for _ in range(2)
        )
        for vehicle in instant.vehicles:
            track, several = vehicle.track_id, len(vehicle.views) > 1
            for camera_id, row in vehicle.views.items():
                confirmed[camera_id][row] = several or (track >= 0 and together[track] >= _CONFIRMING_INSTANTS)
                mostly[camera_id][row] = track >= 0 and together[track] >= _CONFIRMING_SHARE * seen_at[track]
        out = {}
        for camera_id, seen in instant.detections.items():
            frame = frame_of(of, camera_id)
            known = image_iou(seen.boxes, of_detector.trusted[frame].boxes).max(axis=1, initial=0.0) > SAME_IOU
            on_scenery = among(seen.boxes, of_detector.on_scenery[frame].boxes)
            out[camera_id] = ~known & ~np.where(on_scenery, mostly[camera_id], confirmed[camera_id])
            doubtful[frame] = kept[frame].where(out[camera_id] & ~on_scenery)
            kept[frame] = kept[frame].where(~out[camera_id])
        left.append(without(instant, out))
    return left
