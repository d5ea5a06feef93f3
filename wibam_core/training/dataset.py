"""The frames of a site with what their 2D boxes and the fits to all views say about the vehicles in them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.pixels import resized_px, scale_of
from wibam_core.models.frames import INPUT_WIDTH_PX, prepare_camera, prepare_image
from wibam_core.models.trunk import INPUT_MULTIPLE
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, MultiViewVehicle, Vehicles3D
from wibam_core.training.fits import FitsByTrack
from wibam_core.training.overlooked import overlooked
from wibam_core.training.teachable import without
from wibam_core.training.views import FloatArray, LabelledView

#: Pseudo-labels whose heading is less certain than this do not tell front from rear.
FRONT_SD_RAD = 1.0

_NO_IMAGE = np.zeros((0, 0, 3), np.uint8)


@dataclass(frozen=True, eq=False)
class SiteView:
    """One camera's frame of one instant.

    Attributes:
        camera_id, time_ns: which frame.
        pseudo_labels: for the network's input size; without the image. 3D boxes are where the vehicles are when the
            frame is exposed, which is a little before or after the instant.
        other_vehicle: (P,) vehicles of ``pseudo_labels`` that other cameras see too, once per such camera.
        other_camera: (P,) number of that camera in the rig.
        other_boxes: (P, 4) the vehicle's 2D box there, px of that camera's input.
    """

    camera_id: str
    time_ns: int
    pseudo_labels: LabelledView
    other_vehicle: NDArray[np.int64]
    other_camera: NDArray[np.int64]
    other_boxes: FloatArray

    def alone(self, pseudo_labels: LabelledView) -> SiteView:
        """The view with these instead, and without other views: where augmentation renumbered the vehicles."""
        nothing = np.zeros(0, np.int64)
        return SiteView(self.camera_id, self.time_ns, pseudo_labels, nothing, nothing, np.zeros((0, 4)))

    def where(self, rows: NDArray[np.int64]) -> SiteView:
        """The view with these (K,) of its vehicles alone, which are numbered anew."""
        number = np.full(len(self.pseudo_labels.classes), -1)
        number[rows] = np.arange(len(rows))
        vehicle = number[self.other_vehicle]
        kept = vehicle >= 0
        return replace(
            self,
            pseudo_labels=self.pseudo_labels.where(rows),
            other_vehicle=vehicle[kept],
            other_camera=self.other_camera[kept],
            other_boxes=self.other_boxes[kept],
        )


def site_views(
    instants: Sequence[AnnotatedInstant],
    frames: FrameStore,
    lifts: Sequence[Vehicles3D],
    rig: CameraRig,
    left_out_tracks: frozenset[int] = frozenset(),
    input_width_px: int = INPUT_WIDTH_PX,
    *,
    complete: bool = True,
    not_looked_for: frozenset[RoadUserClass] = frozenset(),
) -> list[SiteView]:
    """Every frame of the instants, in order of time, then of the rig.

    Args:
        instants: associated 2D boxes, px of the recording.
        frames: tells which frames exist.
        lifts: fits in the world; ``ids`` are track ids, ``scores`` confidences.
        rig: cameras, of the recording's pixels.
        left_out_tracks: vehicles of another subset: they teach nothing, and finding them is not punished.
        input_width_px: how wide the network sees the images.
        complete: also label vehicles that were detected in other views alone (`wibam_core.training.overlooked`).
        not_looked_for: the road users that the detector does not know, nor takes for others.
    """
    prepared = {camera_id: prepare_camera(camera, input_width_px) for camera_id, camera in rig.items()}
    scales = {camera_id: scale_of(rig[camera_id].size_px, camera.size_px, 4) for camera_id, camera in prepared.items()}
    fits = FitsByTrack(lifts)
    views: list[SiteView] = []
    for instant in sorted(instants, key=lambda one: one.time_ns):
        instant, set_aside = _set_aside(instant, left_out_tracks)
        boxes, ignored = (
            {camera_id: resized_px(found[camera_id], scales[camera_id]) for camera_id in rig.keys() & found.keys()}
            for found in ({camera_id: seen.boxes for camera_id, seen in instant.detections.items()}, set_aside)
        )
        for camera_id in rig:
            if camera_id in boxes and frames.has(camera_id, instant.time_ns):
                seen = instant.detections[camera_id]
                known = _pseudo_labels3d(seen, instant.vehicles, fits, instant.time_ns)
                pseudo_labels = LabelledView(
                    image=_NO_IMAGE,
                    camera=prepared[camera_id],
                    boxes2d=boxes[camera_id],
                    classes=seen.classes,
                    boxes3d=known["boxes3d"],
                    confidence=known["confidence"],
                    front_known=known["front_known"],
                    ignored=ignored[camera_id],
                    not_looked_for=not_looked_for,
                )
                if complete:
                    found = {vehicle.track_id for vehicle in instant.vehicles if camera_id in vehicle.views}
                    pseudo_labels = _completed(
                        pseudo_labels, fits, instant.time_ns, seen.frame_time_ns, found, left_out_tracks
                    )
                others = _others(camera_id, instant.vehicles, boxes, tuple(rig))
                views.append(SiteView(camera_id, instant.time_ns, pseudo_labels, *others))
    return views


def input_width_of(views: Iterable[SiteView]) -> int:
    """How wide the images of views of one site are seen; as usual where there is none."""
    return next((view.pseudo_labels.camera.width_px for view in views), INPUT_WIDTH_PX)


def _set_aside(instant: AnnotatedInstant, tracks: frozenset[int]) -> tuple[AnnotatedInstant, dict[str, FloatArray]]:
    """The instant without the vehicles of these tracks, and the boxes (N, 4) taken out by camera."""
    out = {camera_id: np.zeros(len(seen), bool) for camera_id, seen in instant.detections.items()}
    for vehicle in instant.vehicles:
        if vehicle.track_id in tracks:
            for camera_id, row in vehicle.views.items():
                out[camera_id][row] = True
    boxes = {camera_id: seen.boxes[out[camera_id]] for camera_id, seen in instant.detections.items()}
    return without(instant, out), boxes


def _pseudo_labels3d(
    seen: Detections2D, vehicles: Sequence[MultiViewVehicle], fits: FitsByTrack, time_ns: int
) -> dict[str, NDArray]:
    boxes3d = np.full((len(seen), 7), np.nan)
    confidence = np.zeros(len(seen))
    front_known = np.ones(len(seen), bool)
    for vehicle in vehicles:
        row = vehicle.views.get(seen.camera_id)
        fit = fits.find(vehicle.track_id, time_ns)
        if row is None or fit is None:
            continue
        boxes3d[row] = fits.box_at(vehicle.track_id, time_ns, seen.frame_time_ns)
        confidence[row] = fit.confidence
        front_known[row] = not fit.yaw_sd_rad > FRONT_SD_RAD
    return {"boxes3d": boxes3d, "confidence": confidence, "front_known": front_known}


def _completed(
    pseudo_labels: LabelledView,
    fits: FitsByTrack,
    time_ns: int,
    exposed_ns: int,
    found: Set[int],
    left_out_tracks: frozenset[int],
) -> LabelledView:
    """The pseudo-labels of a view, and what was overlooked in it: more vehicles, and more that is not judged.

    ``found`` are the tracks that have a box in the view, but for those that are left out.
    """
    tracks = fits.tracks_at(time_ns)
    if not tracks:
        return pseudo_labels
    boxes3d = np.array([fits.box_at(track, time_ns, exposed_ns) for track in tracks])
    its = [fits.of(track, time_ns) for track in tracks]
    classes = np.array([fit.vehicle_class for fit in its], np.int64)
    confidence = np.array([fit.confidence for fit in its])
    known = np.concatenate([pseudo_labels.boxes2d, pseudo_labels.ignored])
    missed = overlooked(pseudo_labels.camera, boxes3d, classes, np.array([track in found for track in tracks]), known)
    taught = np.array([tracks[row] not in left_out_tracks and confidence[row] > 0 for row in missed.rows], bool)
    rows = missed.rows[taught]
    front_known = np.array([not its[row].yaw_sd_rad > FRONT_SD_RAD for row in rows], bool)
    return replace(
        pseudo_labels,
        boxes2d=np.concatenate([pseudo_labels.boxes2d, missed.boxes2d[taught]]),
        classes=np.concatenate([pseudo_labels.classes, classes[rows]]),
        boxes3d=np.concatenate([pseudo_labels.boxes3d, boxes3d[rows]]),
        confidence=np.concatenate([pseudo_labels.confidence, confidence[rows]]),
        front_known=np.concatenate([pseudo_labels.front_known, front_known]),
        ignored=np.concatenate([pseudo_labels.ignored, missed.boxes2d[~taught], missed.unsure]),
    )


def _others(
    camera_id: str, vehicles: Sequence[MultiViewVehicle], boxes: Mapping[str, FloatArray], cameras: tuple[str, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Vehicle, camera number and box of every pair of a vehicle in this view and another camera that sees it."""
    pairs = [
        (vehicle.views[camera_id], cameras.index(other), boxes[other][row])
        for vehicle in vehicles
        if camera_id in vehicle.views
        for other, row in vehicle.views.items()
        if other != camera_id and other in boxes
    ]
    return (
        np.array([pair[0] for pair in pairs], dtype=np.int64),
        np.array([pair[1] for pair in pairs], dtype=np.int64),
        np.array([pair[2] for pair in pairs], dtype=np.float64).reshape(-1, 4),
    )


class ImageCache:
    """The prepared images of views in a file, each decoded when it is first asked for, so that memory stays flat.

    Args:
        path: made anew.
        views: in the order in which images are asked for by number.
        frames: holds the images.
    """

    def __init__(self, path: Path, views: Sequence[SiteView], frames: FrameStore) -> None:
        self._views = views
        self._frames = frames
        height = max((view.pseudo_labels.camera.height_px for view in views), default=INPUT_MULTIPLE)
        height += -height % INPUT_MULTIPLE
        self._width_px = input_width_of(views)
        self._shape = (height, self._width_px, 3)
        self._path = path
        self._first_byte = 0
        if len(views):
            shape = (len(views), *self._shape)
            self._first_byte = np.lib.format.open_memmap(path, mode="w+", dtype=np.uint8, shape=shape).offset
        self._ready = np.zeros(len(views), bool)

    def view(self, number: int) -> LabelledView:
        """The labelled view of this number, with its image (H, W, 3); H is the same for all."""
        view = self._views[number]
        image = np.zeros(self._shape, np.uint8)
        # read, not mapped: pages of a mapped file count as the process's memory once they were looked at
        with self._path.open("r+b", buffering=0) as file:
            file.seek(self._first_byte + number * image.nbytes)
            if self._ready[number]:
                file.readinto(image.data)
            else:
                prepared = prepare_image(self._frames.image(view.camera_id, view.time_ns), self._width_px)
                image[: len(prepared)] = prepared
                file.write(image.data)
                self._ready[number] = True
        return replace(view.pseudo_labels, image=image)
