"""The nouns that stages exchange.

Pixels are always those of the recording as uploaded; time is int nanoseconds on the reference camera's clock;
world is metres with Z up and the ground at Z = 0. Boxes in 2D are xyxy.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import SIZE
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.cut_view import CutView
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.site import MatrixCalibration, SignalRegion, SiteCamera

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class CameraRig(Mapping[str, Camera]):
    """The calibrated cameras of a site, by id. The first is the reference camera, whose clock is *the* clock.

    As a mapping it holds the cameras whose pictures are looked at: those with a pinhole as they are, and instead of one
    with a wide lens the views that are cut from its picture.

    Attributes:
        mounted: camera id -> the camera as it hangs at the site.
        views: camera id -> the views of a camera with a wide lens.
    """

    mounted: Mapping[str, Camera]
    views: Mapping[str, tuple[CutView, ...]] = field(default_factory=lambda: MappingProxyType({}))
    _seen: Mapping[str, Camera] = field(init=False, repr=False)
    _source: Mapping[str, str] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.mounted:
            raise ValueError("a rig needs at least one camera")
        seen: dict[str, Camera] = {}
        source: dict[str, str] = {}
        for camera_id, camera in self.mounted.items():
            views = self.views.get(camera_id, ())
            seen |= {view.id: view.camera(camera) for view in views} if views else {camera_id: camera}
            source |= dict.fromkeys((view.id for view in views), camera_id)
        object.__setattr__(self, "mounted", MappingProxyType(dict(self.mounted)))
        object.__setattr__(self, "views", MappingProxyType(dict(self.views)))
        object.__setattr__(self, "_seen", seen)
        object.__setattr__(self, "_source", source)

    def __getitem__(self, camera_id: str) -> Camera:
        return self._seen[camera_id]

    def __iter__(self) -> Iterator[str]:
        return iter(self._seen)

    def __len__(self) -> int:
        return len(self._seen)

    @property
    def reference_id(self) -> str:
        """The mounted camera whose clock is the reference."""
        return next(iter(self.mounted))

    def mounted_id(self, camera_id: str) -> str:
        """The camera that a view is cut from; a camera with a pinhole itself."""
        return self._source.get(camera_id, camera_id)


def site_camera(camera_id: str, camera: Camera, signals: tuple[SignalRegion, ...] = ()) -> SiteCamera:
    """A calibrated camera as a site describes it, with ready matrices."""
    rvec, tvec = camera.T_cam_world.to_rvec_tvec()
    calibration = MatrixCalibration(
        K=tuple(tuple(row) for row in camera.K.tolist()),
        dist=tuple(camera.dist.tolist()),
        lens=camera.lens,
        xi=camera.xi,
        rvec=tuple(rvec.tolist()),
        tvec=tuple(tvec.tolist()),
    )
    return SiteCamera(
        id=camera_id, width_px=camera.width_px, height_px=camera.height_px, calibration=calibration, signals=signals
    )


class FrameKey(NamedTuple):
    """A frame of a recording.

    Attributes:
        camera_id: whose.
        local_ns: when it was exposed, on that camera's own clock: its presentation timestamp.
    """

    camera_id: str
    local_ns: int


class Boxes2D(NamedTuple):
    """2D boxes in one image, in its pixels.

    Attributes:
        boxes: (N, 4) xyxy, px, around what is seen of each vehicle. scores: (N,) in [0, 1].
        classes: (N,) indices into `wibam_core.road_users.CLASSES`.
        amodal_boxes: (N, 4) around the whole vehicle within the image, what is hidden included; NaN where unknown.
        amodal_sd: (N, 4) standard deviations of their edges, px; NaN where unknown.
    """

    boxes: FloatArray
    scores: FloatArray
    classes: IntArray
    amodal_boxes: FloatArray
    amodal_sd: FloatArray

    def where(self, rows: IntArray | NDArray[np.bool_]) -> Boxes2D:
        """The selected boxes, in the order of ``rows``, or where these are true."""
        boxes, scores, classes, amodal, amodal_sd = self
        return Boxes2D(boxes[rows], scores[rows], classes[rows], amodal[rows], amodal_sd[rows])


@dataclass(frozen=True, eq=False)
class Detections2D:
    """What a 2D detector saw in one frame.

    Attributes:
        camera_id: whose frame.
        frame_time_ns: when the frame was exposed, reference clock. Differs from the instant it belongs to by up
            to half a frame interval.
        boxes: (N, 4) xyxy, px, around what is seen of each vehicle. scores: (N,) in [0, 1].
        classes: (N,) indices into `wibam_core.road_users.CLASSES`.
        amodal_boxes: (N, 4) xyxy, px, around the whole vehicle within the image, what is hidden included, where known.
        amodal_sd: (N, 4) standard deviations of their edges, px. Both are NaN, or not given, where unknown.
    """

    camera_id: str
    frame_time_ns: int
    boxes: FloatArray
    scores: FloatArray
    classes: IntArray
    amodal_boxes: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    amodal_sd: FloatArray = field(default_factory=lambda: np.empty((0, 4)))

    def __post_init__(self) -> None:
        boxes = np.asarray(self.boxes, dtype=np.float64).reshape(-1, 4)
        scores = np.asarray(self.scores, dtype=np.float64).reshape(-1)
        classes = np.asarray(self.classes, dtype=np.int64).reshape(-1)
        if not len(boxes) == len(scores) == len(classes):
            raise ValueError(f"{len(boxes)} boxes, {len(scores)} scores, {len(classes)} classes")
        if not (np.isfinite(boxes).all() and np.isfinite(scores).all()):
            raise ValueError("detections must be finite")
        if (boxes[:, 2:] < boxes[:, :2]).any():
            raise ValueError("a 2D box needs x0 <= x1 and y0 <= y1")
        if len(classes) and (classes.min() < 0 or classes.max() >= len(CLASSES)):
            raise ValueError(f"a class index must lie in 0..{len(CLASSES) - 1}")
        amodal, sd = (
            np.asarray(given, dtype=np.float64).reshape(-1, 4) if np.size(given) else np.full((len(boxes), 4), np.nan)
            for given in (self.amodal_boxes, self.amodal_sd)
        )
        if not len(boxes) == len(amodal) == len(sd):
            raise ValueError(f"{len(boxes)} boxes, {len(amodal)} amodal boxes, {len(sd)} standard deviations of them")
        if ((~np.isnan(amodal)).any(axis=1) & ~(np.isfinite(amodal) & (sd > 0) & np.isfinite(sd)).all(axis=1)).any():
            raise ValueError("an amodal box must be finite, with standard deviations above 0, or NaN")
        object.__setattr__(self, "amodal_boxes", amodal)
        object.__setattr__(self, "amodal_sd", sd)
        object.__setattr__(self, "boxes", boxes)
        object.__setattr__(self, "scores", scores)
        object.__setattr__(self, "classes", classes)

    def __len__(self) -> int:
        return len(self.boxes)

    def where(self, keep: NDArray[np.bool_] | IntArray) -> Detections2D:
        """The selected detections."""
        names = ("boxes", "scores", "classes", "amodal_boxes", "amodal_sd")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})

    @property
    def whole_boxes(self) -> FloatArray:
        """(N, 4) xyxy, px: amodal boxes where they are known, else those of what is seen."""
        return np.where(np.isnan(self.amodal_boxes), self.boxes, self.amodal_boxes)


@dataclass(frozen=True, eq=False)
class FrameSet:
    """One instant: at most one frame per camera, all exposed close to ``time_ns``.

    Attributes:
        time_ns: the instant, a multiple of the sampling period on the reference clock.
        frame_times_ns: exposure time of each camera's frame, reference clock; cameras without a frame are absent.
        local_times_ns: the same on each camera's own clock: the frame's presentation timestamp in its recording, by
            which frames are stored.
    """

    time_ns: int
    frame_times_ns: Mapping[str, int]
    local_times_ns: Mapping[str, int]


@dataclass(frozen=True)
class MultiViewVehicle:
    """2D boxes of one vehicle at one instant in one or more cameras.

    Attributes:
        obj_id: unique within its instant.
        track_id: the same for one vehicle over time; −1 where it could not be linked.
        vehicle_class: by majority over views, weighted by score.
        x_m, y_m: ground position of the cluster of rays.
        views: camera id -> index into that camera's `Detections2D` at the instant.
    """

    obj_id: int
    track_id: int
    vehicle_class: RoadUserClass
    x_m: float
    y_m: float
    views: Mapping[str, int]


@dataclass(frozen=True, eq=False)
class AnnotatedInstant:
    """One instant with its detections and the multi-view vehicles found among them."""

    time_ns: int
    detections: Mapping[str, Detections2D]
    vehicles: tuple[MultiViewVehicle, ...] = ()


@dataclass(frozen=True, eq=False)
class Vehicles3D:
    """3D boxes at one instant: truth, hand labels, fits or a network's output.

    Attributes:
        time_ns: the instant.
        boxes: (N, 7), see `wibam_core.geometry.box3d`.
        classes: (N,) indices into `wibam_core.road_users.CLASSES`. ids: (N,) vehicle ids, −1 where unknown.
        scores: (N,) confidence in [0, 1]; 1 for truth and labels.
        sd: (N, 7) standard deviations in the units of the boxes; NaN where unknown.
        camera_id: the detecting camera of monocular output, None in the world.
    """

    time_ns: int
    boxes: FloatArray
    classes: IntArray
    ids: IntArray
    scores: FloatArray
    sd: FloatArray
    camera_id: str | None = None

    def __post_init__(self) -> None:
        boxes = np.asarray(self.boxes, dtype=np.float64).reshape(-1, 7)
        n = len(boxes)
        fields = {
            "boxes": boxes,
            "classes": np.asarray(self.classes, dtype=np.int64).reshape(-1),
            "ids": np.asarray(self.ids, dtype=np.int64).reshape(-1),
            "scores": np.asarray(self.scores, dtype=np.float64).reshape(-1),
            "sd": np.asarray(self.sd, dtype=np.float64).reshape(-1, 7),
        }
        lengths = {name: len(value) for name, value in fields.items()}
        if set(lengths.values()) != {n}:
            raise ValueError(f"unequal lengths: {lengths}")
        if not np.isfinite(boxes).all() or (boxes[:, SIZE] <= 0).any():
            raise ValueError("boxes must be finite with positive sizes")
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.boxes)

    @classmethod
    def of(
        cls,
        time_ns: int,
        boxes: FloatArray,
        classes: IntArray | None = None,
        ids: IntArray | None = None,
        scores: FloatArray | None = None,
        sd: FloatArray | None = None,
        camera_id: str | None = None,
    ) -> Vehicles3D:
        """Build with defaults: class car, unknown id, score 1, unknown standard deviation."""
        boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 7)
        n = len(boxes)
        return cls(
            time_ns,
            boxes,
            np.zeros(n, np.int64) if classes is None else classes,
            np.full(n, -1, np.int64) if ids is None else ids,
            np.ones(n) if scores is None else scores,
            np.full((n, 7), np.nan) if sd is None else sd,
            camera_id,
        )

    def where(self, keep: NDArray[np.bool_] | IntArray) -> Vehicles3D:
        """The selected vehicles."""
        return Vehicles3D(
            self.time_ns,
            self.boxes[keep],
            self.classes[keep],
            self.ids[keep],
            self.scores[keep],
            self.sd[keep],
            self.camera_id,
        )


@dataclass(frozen=True, eq=False)
class LabelledInstant:
    """True or hand-labelled vehicles at one instant. Labels only ever evaluate.

    Attributes:
        vehicles: in the world.
        visibility: camera id -> (N,) share of the vehicle's silhouette that the camera sees, in [0, 1];
            0 where it is out of view.
        velocities_mps: (N, 2) along world X and Y; NaN, or not given, where unknown.
        do_not_care: polygons (K, 2) on the ground, m in the world, in which nobody looked closely: nothing there is
            asked for, and nothing that is found there is wrong.
    """

    vehicles: Vehicles3D
    visibility: Mapping[str, FloatArray]
    velocities_mps: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    do_not_care: tuple[FloatArray, ...] = ()

    def __post_init__(self) -> None:
        velocities = np.asarray(self.velocities_mps, dtype=np.float64).reshape(-1, 2)
        if not len(velocities):
            velocities = np.full((len(self.vehicles), 2), np.nan)
        if len(velocities) != len(self.vehicles):
            raise ValueError(f"{len(self.vehicles)} vehicles, {len(velocities)} velocities")
        object.__setattr__(self, "velocities_mps", velocities)
        for camera_id, values in self.visibility.items():
            if np.shape(values) != (len(self.vehicles),):
                raise ValueError(f"visibility of {camera_id} must have one number per vehicle")


@dataclass(frozen=True, eq=False)
class Track:
    """One vehicle over time: 7DoF states, smoothed.

    Attributes:
        track_id: unique within a result.
        vehicle_class: by majority over time.
        times_ns: (T,) strictly increasing, reference clock.
        boxes: (T, 7). sd: (T, 7) standard deviations in the units of the boxes.
        velocities_mps: (T, 2) along world X and Y. yaw_rates_radps: (T,).
    """

    track_id: int
    vehicle_class: RoadUserClass
    times_ns: IntArray
    boxes: FloatArray
    sd: FloatArray
    velocities_mps: FloatArray
    yaw_rates_radps: FloatArray

    def __post_init__(self) -> None:
        n = len(self.times_ns)
        shapes = {
            "boxes": (n, 7),
            "sd": (n, 7),
            "velocities_mps": (n, 2),
            "yaw_rates_radps": (n,),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} must have shape {shape}, got {np.shape(getattr(self, name))}")
        if n == 0 or (np.diff(self.times_ns) <= 0).any():
            raise ValueError("a track needs strictly increasing times")

    def __len__(self) -> int:
        return len(self.times_ns)
