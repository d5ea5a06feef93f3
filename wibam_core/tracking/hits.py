"""What was seen of one road user at one instant: a fused box, and what each camera measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import POSE, XY
from wibam_core.road_users import CLASSES
from wibam_core.tracking.fusion import Fused
from wibam_core.tracking.motion import Measurement

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: So many times the fewest hits, seen often enough, prove a road user for good.
_MANY = 3
#: How many numbers each array of a hit has, and each of what a camera saw of it.
_WIDTHS = {"box": 7, "sd": 7, "votes": len(CLASSES), "headings": 2}
_VIEW_WIDTHS = {"poses": 3, "pose_sd": 3}


@dataclass(frozen=True, eq=False)
class Hit:
    """A vehicle's fused box at one instant.

    Attributes:
        box, sd: (7,). votes: (C,) by class. headings: (2,) votes for the box's yaw and for the opposite one.
        cameras: (V,) numbers of those that saw it, each once.
        poses, pose_sd: (V, 3) centre and yaw that each saw, m and rad; the yaw is known up to half a turn.
    """

    time_ns: int
    box: Array
    sd: Array
    votes: Array
    headings: Array
    cameras: Indices
    poses: Array
    pose_sd: Array

    @classmethod
    def of(cls, time_ns: int, fused: Fused, number: int) -> Hit:
        """One of the fused boxes of an instant."""
        members, rows = fused.members, fused.made_of(number)
        return cls(
            time_ns,
            fused.boxes[number],
            fused.sd[number],
            fused.votes[number],
            fused.headings[number],
            members.cameras[rows],
            members.boxes[rows][:, POSE],
            members.sd[rows][:, POSE],
        )

    @property
    def measurement(self) -> Measurement:
        """Its place and heading."""
        return Measurement(self.box[POSE], self.sd[POSE])


def seen_often(hits: Sequence[Hit], instants: Indices, fewest: int, share: float) -> bool:
    """Whether a road user was seen ``fewest`` times and at such a share of the instants that it lasted; or at some time
    by many hits in a row: who parked in full view may be seen now and then only, once others stand in front."""
    if len(hits) < fewest:
        return False
    at = np.searchsorted(instants, [hit.time_ns for hit in hits])
    if len(hits) >= share * (at[-1] - at[0] + 1):
        return True
    many = _MANY * fewest
    return len(hits) >= many and bool((many >= share * (at[many - 1 :] - at[: len(at) - many + 1] + 1)).any())


def came_nowhere(hits: Sequence[Hit], least_s: float, slowest_mps: float) -> bool:
    """Whether somebody was unseen for longer than ``least_s`` between two hits, and hardly elsewhere afterwards."""
    if len(hits) < 2 or hits[1].time_ns - hits[0].time_ns <= least_s * 1e9:
        return False
    way_m = float(np.hypot(*(hits[1].box[XY] - hits[0].box[XY])))
    return way_m < slowest_mps * (hits[1].time_ns - hits[0].time_ns) * 1e-9


def hits_to_arrays(hits: Sequence[Hit]) -> dict[str, NDArray[Any]]:
    """Hits as arrays by name, for `hits_of_arrays`."""
    return {
        "hit_times_ns": np.array([hit.time_ns for hit in hits], np.int64),
        "hit_views": np.array([len(hit.cameras) for hit in hits], np.int64),
        **{
            f"hit_{name}": np.array([getattr(hit, name) for hit in hits]).reshape(len(hits), width)
            for name, width in _WIDTHS.items()
        },
        "view_cameras": np.concatenate([np.empty(0, np.int64), *(hit.cameras for hit in hits)]),
        **{
            f"view_{name}": np.concatenate([np.empty((0, width)), *(getattr(hit, name) for hit in hits)])
            for name, width in _VIEW_WIDTHS.items()
        },
    }


def hits_of_arrays(arrays: Mapping[str, NDArray[Any]]) -> list[Hit]:
    """The hits of which `hits_to_arrays` gave these."""
    views = np.cumsum(arrays["hit_views"]).tolist()
    return [
        Hit(
            int(time_ns),
            *(arrays[f"hit_{name}"][k] for name in _WIDTHS),
            *(arrays[f"view_{name}"][first:end] for name in ("cameras", *_VIEW_WIDTHS)),
        )
        for k, (time_ns, first, end) in enumerate(zip(arrays["hit_times_ns"], [0, *views], views, strict=False))
    ]


def of_fused_boxes(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """What is missing in arrays of versions before 0.7, which kept fused boxes alone: each counts as one camera's."""
    count = len(arrays["hit_times_ns"])
    return {
        "cameras": np.array(["fused"], np.str_),
        "hit_views": np.ones(count, np.int64),
        "view_cameras": np.zeros(count, np.int64),
        "view_poses": arrays["hit_box"][:, POSE],
        "view_pose_sd": arrays["hit_sd"][:, POSE],
    }
