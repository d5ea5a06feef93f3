"""Cameras as they hang at a site, and what is looked at of them. Nothing here needs torch, which is slow to import."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wibam_core.scene import CameraRig, FloatArray, IntArray


def mounts_of(rig: CameraRig) -> tuple[IntArray, FloatArray]:
    """Of what is looked at, views and pinholes (V): the number of the camera that it is or is cut from, and (V, 3, 3)
    how that camera's axes lie in its own."""
    numbers = {name: number for number, name in enumerate(rig.mounted)}
    turned = {view.id: view.R_cam_view.T for views in rig.views.values() for view in views}
    mounts = np.array([numbers[rig.mounted_id(name)] for name in rig], dtype=np.int64)
    return mounts, np.stack([turned.get(name, np.eye(3)) for name in rig])


def of_what_is_seen(rig: CameraRig, covariances: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Covariances (6, 6) of the rotation about its axes and the position of each pinhole, and each view of a wide lens.

    Args:
        rig: the cameras.
        covariances: camera id -> (6 or more, 6 or more) of the same of cameras as they hang at the site.
    """
    mounts, turns = mounts_of(rig)
    names, found = tuple(rig.mounted), {}
    for name, mount, turn in zip(rig, mounts.tolist(), turns, strict=True):
        if names[mount] in covariances:
            whole = np.eye(6)
            whole[:3, :3] = turn
            found[name] = whole @ covariances[names[mount]][:6, :6] @ whole.T
    return found
