"""What a run at a real site found, against its hand labels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.real_labels import LEAST_VISIBLE, MATCH_M, Area, Judged, Labels, judge
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.artifacts.catalogue import FRAMES, RIG, SPLIT, TRACKS, WEIGHTS
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.evaluation.matching import assign
from wibam_core.geometry.box3d import XY, YAW
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.models.frames import Frame
from wibam_core.models.network import Network, predict
from wibam_core.networks.registry import load_to_detect
from wibam_core.placing import Decode
from wibam_core.scene import AnnotatedInstant, CameraRig, FrameSet, Track, Vehicles3D

Array = NDArray[np.float64]

#: Of fits of one vehicle, those this far apart tell where it was between, ns.
_FIT_GAP_NS = 1_000_000_000
#: A fit this close to a labelled instant, ns, is moved to it by what its neighbours say.
_FIT_NEAR_NS = 250_000_000
#: One camera is asked for vehicles up to this far from it, m.
ONE_CAMERA_M = 35.0


@dataclass(frozen=True, eq=False)
class Sighted:
    """Boxes at one instant, and the instant's labels."""

    labels: Labels
    boxes: Array


def subset_at(split: Split, time_ns: int) -> str:
    """Which part of the split an instant lies in, by its bounds in time: "train", "val", "test" or "gap"."""
    for name in SUBSETS:
        times = split.times_ns[name]
        if times and times[0] - _FIT_NEAR_NS <= time_ns <= times[-1] + _FIT_NEAR_NS:
            return name
    return "gap"


def tracks_at(tracks: Sequence[Track], time_ns: int) -> Array:
    """Boxes (N, 7) of all tracks that last over an instant, between their states."""
    found = []
    for track in tracks:
        if track.times_ns[0] <= time_ns <= track.times_ns[-1]:
            after = min(int(np.searchsorted(track.times_ns, time_ns)), len(track) - 1)
            before = max(after - 1, 0)
            span = max(int(track.times_ns[after] - track.times_ns[before]), 1)
            share = (time_ns - int(track.times_ns[before])) / span if after > before else 0.0
            found.append(_between(track.boxes[before], track.boxes[after], share))
    return np.array(found).reshape(-1, 7)


def _between(first: Array, second: Array, share: float) -> Array:
    box = first + share * (second - first)
    box[YAW] = normalise_angle(first[YAW] + share * normalise_angle(second[YAW] - first[YAW]))
    return box


def fits_at(fits: Sequence[Vehicles3D], time_ns: int) -> Array | None:
    """Boxes (N, 7) of the fits next to an instant, moved to it by their own track; None: no instant of fits is near."""
    near = [vehicles for vehicles in fits if abs(vehicles.time_ns - time_ns) <= _FIT_GAP_NS]
    if not near or min(abs(vehicles.time_ns - time_ns) for vehicles in near) > _FIT_NEAR_NS:
        return None
    states: dict[int, list[tuple[int, Array]]] = {}
    for vehicles in near:
        for track, box in zip(vehicles.ids.tolist(), vehicles.boxes, strict=True):
            states.setdefault(track, []).append((vehicles.time_ns, box))
    found = []
    for of in states.values():
        nearest = min(of, key=lambda state: abs(state[0] - time_ns))
        if abs(nearest[0] - time_ns) > _FIT_NEAR_NS:
            continue
        box = nearest[1].copy()
        if len(of) > 1:  # the straight line through the two next to it
            (t0, a), (t1, b) = sorted(sorted(of, key=lambda state: abs(state[0] - time_ns))[:2], key=lambda s: s[0])
            box = _between(a, b, (time_ns - t0) / (t1 - t0))
        found.append(box)
    return np.array(found).reshape(-1, 7)


def of_tracks(labels: Iterable[Labels], area: Area, tracks: Sequence[Track]) -> Iterator[tuple[Labels, Judged]]:
    """Tracks of all cameras against each labelled instant."""
    for one in labels:
        yield one, judge(one, area, tracks_at(tracks, one.time_ns))


def of_fits(labels: Iterable[Labels], area: Area, fits: Sequence[Vehicles3D]) -> Iterator[tuple[Labels, Judged]]:
    """The fits that teach against the labelled instants that the split covers."""
    for one in labels:
        boxes = fits_at(fits, one.time_ns)
        if boxes is not None:
            yield one, judge(one, area, boxes)


def of_what_may_teach(
    labels: Iterable[Labels], area: Area, fits: Sequence[Vehicles3D], instants: Sequence[AnnotatedInstant], split: Split
) -> Iterator[tuple[Labels, Judged]]:
    """As `of_fits`, of the vehicles alone that the split lets teach in the part that the instant lies in.

    A vehicle that a later part sees, too, is left out of the earlier one on purpose. Which these are is told by where
    association (``instants``) has the vehicles that are left out; who is associated with nothing may teach.
    """
    for one in labels:
        boxes = fits_at(fits, one.time_ns)
        if boxes is None:
            continue
        nearest = min(instants, key=lambda at: abs(at.time_ns - one.time_ns))
        left_out = split.left_out_tracks.get(subset_at(split, one.time_ns), frozenset())
        places = np.array([(vehicle.x_m, vehicle.y_m) for vehicle in nearest.vehicles]).reshape(-1, 2)
        out = np.array([vehicle.track_id in left_out for vehicle in nearest.vehicles], dtype=bool)
        away_m = np.linalg.norm(one.at(nearest.time_ns)[:, None, XY] - places, axis=-1)
        rows, columns = assign(away_m, MATCH_M)
        teaches = np.ones(len(one.boxes), dtype=bool)
        teaches[rows] = ~out[columns]
        yield one, judge(one, area, boxes, counts=teaches)


def of_one_camera(
    labels: Iterable[Labels],
    area: Area,
    rig: CameraRig,
    instants: Sequence[FrameSet],
    detect: Callable[[FrameSet, str], Vehicles3D],
    max_range_m: float = ONE_CAMERA_M,
) -> Iterator[tuple[Labels, str, Judged]]:
    """Boxes in single images against the labels that their camera sees within range, each when it was exposed."""
    for one in labels:
        instant = min(instants, key=lambda at: abs(at.time_ns - one.time_ns))
        for camera_id, camera in rig.items():
            if camera_id not in instant.frame_times_ns:
                continue
            exposed_ns = instant.frame_times_ns[camera_id]
            centre = camera.centre_m[:2]
            boxes = detect(instant, camera_id).boxes
            boxes = boxes[np.linalg.norm(boxes[:, XY] - centre, axis=1) <= max_range_m]
            seen = one.visibility.get(camera_id, np.zeros(len(one.boxes))) > LEAST_VISIBLE
            seen &= np.linalg.norm(one.boxes[:, XY] - centre, axis=1) <= max_range_m
            yield one, camera_id, judge(one, area, boxes, exposed_ns, seen)


def detector_of(outputs: ArtifactReader, min_score: float) -> Callable[[FrameSet, str], Vehicles3D]:
    """The fine-tuned network of a run on a stored frame."""
    network: Network = load_to_detect(outputs.read(WEIGHTS))
    store, rig = outputs.read(FRAMES), outputs.read(RIG)
    decode: Decode = network.card.decode

    def detect(instant: FrameSet, camera_id: str) -> Vehicles3D:
        frame = Frame(store.image(camera_id, instant.time_ns), rig[camera_id], camera_id, instant.time_ns)
        return next(predict(network, [frame], decode=decode, min_score=min_score))

    return detect


def parts(judged: Iterable[tuple[Labels, Judged]], split: Split) -> dict[str, list[Judged]]:
    """By the part of the split that the instant lies in, and "all"."""
    found: dict[str, list[Judged]] = {"all": []}
    for labels, one in judged:
        found["all"].append(one)
        found.setdefault(subset_at(split, labels.time_ns), []).append(one)
    return found


def counts_in_area(instants: Sequence[AnnotatedInstant], area: Area) -> dict[str, object]:
    """Boxes an image by camera; of vehicles whose rays meet in the area, how many an instant by number of views."""
    boxes: dict[str, list[int]] = {}
    views: list[int] = []
    for instant in instants:
        for camera_id, seen in instant.detections.items():
            boxes.setdefault(camera_id, []).append(len(seen))
        if instant.vehicles:
            places = np.array([(vehicle.x_m, vehicle.y_m) for vehicle in instant.vehicles])
            inside = area.border_m(places) >= 0
            views += [len(v.views) for v, within in zip(instant.vehicles, inside.tolist(), strict=True) if within]
    number = max(len(instants), 1)
    by_views: Mapping[int, float] = {n: views.count(n) / number for n in sorted(set(views))}
    return {
        "boxes_an_image": {camera_id: float(np.mean(of)) for camera_id, of in sorted(boxes.items())},
        "vehicles_an_instant": {str(n): share for n, share in by_views.items()},
        "views_a_vehicle": float(np.mean(views)) if views else None,
    }


def tracks_of(outputs: ArtifactReader) -> list[Track]:
    """All tracks of a run."""
    return list(outputs.read(TRACKS))


def split_of(outputs: ArtifactReader) -> Split:
    """Its split in time."""
    return outputs.read(SPLIT)
