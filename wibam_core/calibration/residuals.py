"""How well a camera fits the points it was solved from, and what a pixel means on the ground, near and far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.calibration.matrices import visible_ground
from wibam_core.documents.base import finite
from wibam_core.documents.calibration import CameraResiduals, PointResidual, Zone
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane

Array = NDArray[np.float64]

#: Bands of horizontal distance from the camera, m.
ZONES_M = ((0.0, 15.0), (15.0, 30.0), (30.0, 50.0), (50.0, 80.0), (80.0, 200.0))


@dataclass(frozen=True, eq=False)
class Residuals:
    """What one camera's calibration rests on.

    Attributes:
        kind: "matrices", "pnp" or "homography".
        camera: the result.
        world: (N, 3) surveyed points, m; none for ready matrices.
        pixels: (N, 2) where the user saw them.
        used: (N,) which of them the camera rests on.
        error_px: (N,) reprojection errors.
        error_m: (N,) distances between each point and where its pixel's ray meets the point's height; NaN where
            it does not.
    """

    kind: str
    camera: Camera
    world: Array
    pixels: Array
    used: NDArray[np.bool_]
    error_px: Array
    error_m: Array

    @classmethod
    def of(
        cls, kind: str, camera: Camera, world: Array, pixels: Array, used: NDArray[np.bool_] | None = None
    ) -> Residuals:
        """Measure the errors of points (N, 3) seen at pixels (N, 2)."""
        world, pixels = world.reshape(-1, 3), pixels.reshape(-1, 2)
        projected, _ = camera.project(world)
        ground = intersect_plane(camera, pixels, world[:, 2])
        return cls(
            kind,
            camera,
            world,
            pixels,
            np.ones(len(world), dtype=bool) if used is None else used,
            np.linalg.norm(projected - pixels, axis=1),
            np.linalg.norm((ground - world)[:, :2], axis=1),
        )

    @property
    def median_px(self) -> float | None:
        """Median reprojection error of all points; None without points."""
        return _median(self.error_px)

    def document(self) -> CameraResiduals:
        """The camera's figures, one entry per point, and one per zone of `ZONES_M`."""
        rms = float(np.sqrt(np.nanmean(self.error_px**2))) if len(self.error_px) else None
        return CameraResiduals(
            kind=self.kind,
            position_m=self.camera.centre_m.tolist(),
            focal_px=[float(self.camera.K[0, 0]), float(self.camera.K[1, 1])],
            points=len(self.world),
            rejected=int((~self.used).sum()),
            median_px=self.median_px,
            rms_px=rms,
            max_px=float(np.nanmax(self.error_px)) if len(self.error_px) else None,
            median_m=_median(self.error_m),
            zones=self._zones(),
            residuals=[
                PointResidual(
                    world=world.tolist(),
                    pixel=pixel.tolist(),
                    used=bool(used),
                    error_px=finite(error_px),
                    error_m=finite(error_m),
                )
                for world, pixel, used, error_px, error_m in zip(
                    self.world, self.pixels, self.used, self.error_px, self.error_m, strict=True
                )
            ],
        )

    def _zones(self) -> list[Zone]:
        centre = self.camera.centre_m[:2]
        distance = np.linalg.norm(self.world[:, :2] - centre, axis=1)
        ground = visible_ground(self.camera)
        ground_distance = np.linalg.norm(ground[:, :2] - centre, axis=1)
        per_px = metres_per_pixel(self.camera, ground)
        zones = []
        for low, high in ZONES_M:
            here = (distance >= low) & (distance < high)
            seen = (ground_distance >= low) & (ground_distance < high)
            zones.append(
                Zone(
                    from_m=low,
                    to_m=high,
                    points=int(here.sum()),
                    median_px=_median(self.error_px[here]),
                    median_m=_median(self.error_m[here]),
                    m_per_px=_median(per_px[seen]),
                )
            )
        return zones


def metres_per_pixel(camera: Camera, ground: Array) -> Array:
    """(N,) how far ground points (N, 3) move when their pixel moves by one, in the worst direction, m."""
    step = 1e-3
    pixels, _ = camera.project(ground)
    right, _ = camera.project(ground + np.array([step, 0.0, 0.0]))
    up, _ = camera.project(ground + np.array([0.0, step, 0.0]))
    jacobian = np.stack([right - pixels, up - pixels], axis=-1) / step
    smallest = np.linalg.svd(jacobian, compute_uv=False)[..., -1] if len(ground) else np.zeros(0)
    return np.asarray(1.0 / np.maximum(smallest, 1e-12))


def _median(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
