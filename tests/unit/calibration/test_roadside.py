"""Our conventions against a real, pitched roadside camera with hand-made 3D and 2D labels."""

from pathlib import Path

import numpy as np
import pytest

from wibam_core.geometry.box3d import corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3


def roadside_camera(folder: Path) -> Camera:
    """World: Z along the ground plane's normal, origin below the camera, X the way the camera looks."""
    P = np.array((folder / "calib.txt").read_text().split()[1:], dtype=float).reshape(3, 4)
    *normal, height = map(float, (folder / "denorm.txt").read_text().split())
    up = np.array(normal) / np.linalg.norm(normal)
    forward = np.array([0.0, 0.0, 1.0]) - up[2] * up
    forward /= np.linalg.norm(forward)
    rotation = np.stack([forward, np.cross(up, forward), up])
    return Camera(P[:, :3], np.zeros(0), SE3(rotation, np.array([0, 0, height])), 1920, 1080)


@pytest.mark.assets
def test_convention_boxes_of_a_real_pitched_camera_project_onto_their_2d_labels(assets: Path):
    folder = assets / "roadside"
    camera = roadside_camera(folder)
    limit = np.array([1919.0, 1079.0])
    overlaps, bottoms = [], []
    for line in (folder / "label_2.txt").read_text().splitlines():
        name, *numbers = line.split()
        values = np.array(numbers, dtype=float)
        if name != "car" or (values[7:10] <= 0).any():
            continue
        height, width, length = values[7:10]
        bottom = camera.T_world_cam.apply(values[10:13])
        bottoms.append(bottom[2])
        heading = camera.T_world_cam.rotate([np.cos(values[13]), 0.0, -np.sin(values[13])])
        yaw = np.arctan2(heading[1], heading[0])
        box = np.array([bottom[0], bottom[1], bottom[2] + height / 2, length, width, height, yaw])
        pixels, depths = camera.project(corners(box))
        assert (depths > 0).all()
        low, high = np.clip(pixels.min(0), 0, limit), np.clip(pixels.max(0), 0, limit)
        label_low, label_high = values[3:5], values[5:7]
        inner = np.clip(np.minimum(high, label_high) - np.maximum(low, label_low), 0, None).prod()
        union = (high - low).prod() + (label_high - label_low).prod() - inner
        overlaps.append(inner / union)
    assert len(overlaps) == 15
    assert np.median(overlaps) == pytest.approx(0.977, abs=0.003)
    assert min(overlaps) > 0.95
    assert np.abs(bottoms).max() < 0.4
