"""Small, exact things for tests to start from."""

from __future__ import annotations

import numpy as np

from wibam_core.documents.warnings import StageWarning
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3
from wibam_core.scene import CameraRig
from wibam_core.site import Site


def look_at(
    position: tuple[float, float, float],
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    focal_px: float = 500.0,
    width_px: int = 640,
    height_px: int = 360,
    dist: tuple[float, ...] = (),
) -> Camera:
    """A level camera at ``position`` (m) whose optical axis meets ``target`` (m)."""
    z = np.asarray(target, dtype=float) - np.asarray(position, dtype=float)
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    K = np.array([[focal_px, 0, (width_px - 1) / 2], [0, focal_px, (height_px - 1) / 2], [0, 0, 1]])
    return Camera(K, np.array(dist), SE3(rotation, np.asarray(position, dtype=float)), width_px, height_px)


def corner_rig(
    count: int = 4, *, radius_m: float = 22.0, height_m: float = 8.0, dist: tuple[float, ...] = ()
) -> CameraRig:
    """Elevated cameras on a circle, all looking at the middle of the intersection."""
    angles = np.pi / 4 + 2 * np.pi * np.arange(count) / count
    return CameraRig(
        {
            f"cam{i + 1}": look_at((radius_m * np.cos(a), radius_m * np.sin(a), height_m), dist=dist)
            for i, a in enumerate(angles)
        }
    )


def site_of(rig: CameraRig | None = None, name: str = "crossing") -> Site:
    """A site whose cameras have ready matrices."""
    rig = rig or corner_rig()
    return Site.model_validate(
        {
            "name": name,
            "cameras": [
                {
                    "id": camera_id,
                    "width_px": camera.width_px,
                    "height_px": camera.height_px,
                    "calibration": {
                        "kind": "matrices",
                        "K": camera.K.tolist(),
                        "dist": camera.dist.tolist(),
                        **dict(
                            zip(("rvec", "tvec"), (v.tolist() for v in camera.T_cam_world.to_rvec_tvec()), strict=True)
                        ),
                    },
                }
                for camera_id, camera in rig.items()
            ],
        }
    )


AMBIGUOUS = StageWarning(
    stage="sync",
    code="ambiguous_clock",
    message="The clock of cam3 is ambiguous: 24 light changes also meet with an offset of +45.00 s",
    hint="Compare a moving vehicle in two cameras, or record for longer.",
    details={"camera": "cam3"},
)
