"""How well a camera fits the points it was solved from, and what a pixel means on the ground, near and far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wibam_core.calibration.covariance import CameraCovariance
from wibam_core.calibration.points import place
from wibam_core.calibration.robust import MIN_POINTS
from wibam_core.calibration.view import visible_ground
from wibam_core.documents.base import finite
from wibam_core.documents.calibration import CameraResiduals, PointResidual, Zone
from wibam_core.documents.warnings import Caution
from wibam_core.errors import CalibrationError
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane

Array = NDArray[np.float64]

#: Bands of horizontal distance from the camera, m.
ZONES_M = ((0.0, 15.0), (15.0, 30.0), (30.0, 50.0), (50.0, 80.0), (80.0, 200.0))
#: Points that a sentence names, at most.
_NAMED_POINTS = 3
#: Points are clicked to this, at the median.
_CLICK_PX = 3.0
#: How well the ground is known is judged this near to a camera; beyond this standard deviation, boxes of one vehicle in
#: several cameras stop meeting.
_NEAR_M = 50.0
_LOOSE_M = 1.0


@dataclass(frozen=True, eq=False)
class Residuals:
    """What one camera's calibration rests on.

    Attributes:
        kind: "matrices", "pnp", "homography" or "points".
        camera: the result.
        world: (N, 3) surveyed points, m; none for ready matrices.
        pixels: (N, 2) where the user saw them.
        used: (N,) which of them the camera rests on.
        error_px: (N,) reprojection errors.
        error_m: (N,) distances between each point and where its pixel's ray meets the point's height; NaN where
            it does not.
        covariance: of the camera; None for ready matrices, and where there are too few points to tell.
        cautions: what is doubtful about it.
    """

    kind: str
    camera: Camera
    world: Array
    pixels: Array
    used: NDArray[np.bool_]
    error_px: Array
    error_m: Array
    covariance: CameraCovariance | None = None
    cautions: tuple[Caution, ...] = ()

    @classmethod
    def of(
        cls,
        kind: str,
        camera: Camera,
        world: Array,
        pixels: Array,
        used: NDArray[np.bool_] | None = None,
        covariance: CameraCovariance | None = None,
        cautions: Sequence[Caution] = (),
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
            covariance,
            tuple(cautions),
        )

    @property
    def median_px(self) -> float | None:
        """Median reprojection error of all points; None without points."""
        return _median(self.error_px)

    @property
    def ground_sd_m(self) -> float | None:
        """Median standard deviation of places on the ground near the camera; None where it is not known."""
        if self.covariance is None:
            return None
        ground = visible_ground(self.camera)
        near = ground[np.linalg.norm((ground - self.camera.centre_m)[:, :2], axis=1) <= _NEAR_M]
        return _median(self.covariance.ground_sd_m(near))

    def document(self) -> CameraResiduals:
        """The camera's figures, one entry per point, and one per zone of `ZONES_M`."""
        rms = float(np.sqrt(np.nanmean(self.error_px**2))) if len(self.error_px) else None
        return CameraResiduals(
            kind=self.kind,
            lens=self.camera.lens,
            position_m=self.camera.centre_m.tolist(),
            focal_px=[float(self.camera.K[0, 0]), float(self.camera.K[1, 1])],
            position_sd_m=None if self.covariance is None else self.covariance.position_sd_m,
            rotation_sd_deg=None if self.covariance is None else self.covariance.rotation_sd_deg,
            focal_sd_px=None if self.covariance is None else self.covariance.focal_sd_px,
            k1=float(self.camera.dist[0]) if self.kind == "points" else None,
            k1_sd=None if self.covariance is None else self.covariance.k1_sd,
            ground_sd_m=self.ground_sd_m,
            covariance=None if self.covariance is None else self.covariance.matrix.tolist(),
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


def misfit_problem(residuals: Residuals, max_error_px: float) -> CalibrationError | None:
    """Why a camera does not fit the points that it was solved from; None where it does.

    Args:
        residuals: of a camera with points.
        max_error_px: the largest median reprojection error that passes.
    """
    unseen = residuals.used & ~np.isfinite(residuals.error_px)
    if unseen.any():
        return CalibrationError(
            f"{int(unseen.sum())} of {len(unseen)} points come out behind the camera, e.g. "
            f"{place(residuals.world[unseen][0])}",
            hint="Check that each pixel belongs to its world point.",
        )
    median_px = residuals.median_px
    if median_px is not None and median_px > max_error_px:
        return CalibrationError(
            f"the points are off by {median_px:.1f} px at the median, more than {max_error_px:g} px",
            hint="Check pixels against world points, units (metres) and the intrinsics; "
            "or raise calibrate.max_error_px.",
            median_px=median_px,
        )
    return None


def fit_cautions(residuals: Residuals) -> list[Caution]:
    """What is doubtful about the points that a camera rests on."""
    left_out, found = np.flatnonzero(~residuals.used), []
    if len(left_out):
        named = ", ".join(
            f"{place(residuals.world[row])}" + _off_by(residuals.error_px[row]) for row in left_out[:_NAMED_POINTS]
        )
        more = f" and {len(left_out) - _NAMED_POINTS} more" if len(left_out) > _NAMED_POINTS else ""
        found.append(
            Caution(
                code="points_left_out",
                message=f"{len(left_out)} of {len(residuals.used)} points contradict the others and were left out: "
                f"{named}{more}",
                hint="Check their pixels and their coordinates.",
                details={"points": left_out.tolist()},
            )
        )
    if len(residuals.used) < MIN_POINTS:
        found.append(
            Caution(
                code="few_points",
                message=f"{len(residuals.used)} points fix the camera, but leave little to check them by",
                hint=f"Give at least {MIN_POINTS}, well spread: among fewer, a wrong click goes unnoticed.",
                details={"points": len(residuals.used)},
            )
        )
    median_px = residuals.median_px
    if median_px is not None and median_px > _CLICK_PX:
        found.append(
            Caution(
                code="poor_fit",
                message=f"the points are off by {median_px:.1f} px at the median, more than clicks are",
                hint="Check the intrinsics, the coordinates and heights of the points, and that these stand still.",
                details={"median_px": median_px},
            )
        )
    ground_sd_m = residuals.ground_sd_m
    if ground_sd_m is not None and ground_sd_m > _LOOSE_M:
        found.append(
            Caution(
                code="loose_camera",
                message=f"the points fix places on the ground within {_NEAR_M:.0f} m to {ground_sd_m:.1f} m only "
                "(standard deviation)",
                hint="Give more points, spread wider: to the left and right, near and far, and raised ones.",
                details={"ground_sd_m": ground_sd_m},
            )
        )
    return found


def _off_by(error_px: float) -> str:
    return f" by {error_px:.0f} px" if np.isfinite(error_px) else ", which it does not see"


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
