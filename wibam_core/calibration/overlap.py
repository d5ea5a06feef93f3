"""How much of the road cameras see together: where only one looks, nothing can be seen from two sides."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wibam_core.documents.calibration import Overlap, PairOverlap
from wibam_core.documents.warnings import Caution
from wibam_core.geometry.camera import Camera

#: Ground within this distance of the middle of the cameras is looked at, as `associate.range_m` is usually.
WITHIN_M = 60.0
#: Side of the cells that ground is counted by, m.
_CELL_M = 1.0
#: A camera that shares less ground than this with the others sees few vehicles together with them: a lane 3.5 m wide
#: over 60 m, which a vehicle passes in 4 s.
_LEAST_SHARED_M2 = 210.0


def overlap_of(cameras: Mapping[str, Camera]) -> Overlap:
    """Areas of road that each camera, each pair, and so many cameras at least see, near the middle of all cameras."""
    seen = seen_ground(cameras)[1]
    area = _CELL_M**2
    pairs = []
    for (one, mine), (other, theirs) in combinations(zip(cameras, seen, strict=True), 2):
        shared, smaller = int((mine & theirs).sum()), min(int(mine.sum()), int(theirs.sum()))
        pairs.append(
            PairOverlap(cameras=[one, other], area_m2=shared * area, share=shared / smaller if smaller else 0.0)
        )
    count = seen.sum(axis=0)
    return Overlap(
        within_m=WITHIN_M,
        area_m2={camera_id: int(own.sum()) * area for camera_id, own in zip(cameras, seen, strict=True)},
        pairs=pairs,
        seen_by_m2={str(n): int((count >= n).sum()) * area for n in range(1, len(cameras) + 1)},
    )


def seen_ground(cameras: Mapping[str, Camera]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ground points (N, 2), a cell of a grid each, and which of them each camera sees (C, N)."""
    middle = np.mean([camera.centre_m[:2] for camera in cameras.values()], axis=0)
    along = np.arange(-WITHIN_M, WITHIN_M + _CELL_M / 2, _CELL_M)
    x, y = np.meshgrid(along, along)
    inside = np.hypot(x, y) <= WITHIN_M
    points = np.stack([x[inside], y[inside]], axis=1) + middle
    return points, np.stack([_sees(camera, points) for camera in cameras.values()])


def _sees(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    pixels, _ = camera.project(np.column_stack([points, np.zeros(len(points))]))
    return camera.contains(pixels)


def overlap_cautions(overlap: Overlap) -> list[Caution]:
    """Cameras that see too little together with any other."""
    found = []
    for camera_id in overlap.area_m2 if len(overlap.area_m2) > 1 else ():
        own = [pair for pair in overlap.pairs if camera_id in pair.cameras]
        most = max(own, key=lambda pair: pair.area_m2)
        if most.area_m2 < _LEAST_SHARED_M2:
            other = next(name for name in most.cameras if name != camera_id)
            shared = f"{most.area_m2:.0f} m² with {other}, and less with others" if most.area_m2 else "none at all"
            found.append(
                Caution(
                    code="little_overlap",
                    message=f"the road that it shares with another camera within {overlap.within_m:.0f} m of the "
                    f"middle of all is little: {shared}",
                    hint="Only vehicles that two cameras see at once teach anything. Turn the camera to the ground "
                    "that the others see, and check its calibration.",
                    details={"shared_m2": most.area_m2, "with": other},
                ).of_camera(camera_id)
            )
    return found
