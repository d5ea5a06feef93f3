"""Files of lenses as scripts and tools dump them: names of their own, one number by one, NumPy's arrays."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.recordings import write_recording
from tests.unit.calibration.test_foreign import GROUND, PIXELS, opencv_file, told
from wibam_core.calibration.foreign.base import FoundCamera
from wibam_core.calibration.foreign.registry import read_file, read_named
from wibam_core.errors import InputError
from wibam_core.site import Site

K = [[1100.0, 0.0, 639.5], [0.0, 1090.0, 359.5], [0.0, 0.0, 1.0]]
DIST = [-0.21, 0.05, 0.001, -0.002, 0.01]
BY_NUMBER = {"fx": 1100.0, "fy": 1090.0, "cx": 639.5, "cy": 359.5}


def read(content: dict[str, Any], name: str = "lens.json") -> FoundCamera:
    _, [found] = read_named(name, json.dumps(content))
    return found


def assert_lens(found: FoundCamera, dist: list[float] = DIST) -> None:
    assert found.intrinsics is not None
    np.testing.assert_allclose(found.intrinsics.K, K)
    np.testing.assert_allclose(found.intrinsics.dist, dist)


@pytest.mark.parametrize("name", ["dist_coeff", "dist_coeffs", "distCoeffs", "dist", "distortion_coefficients", "D"])
def test_no_name_of_the_distortion_loses_it(name: str) -> None:
    assert_lens(read({"camera_matrix": K, name: [DIST]}))


def test_a_distortion_by_an_unknown_name_is_refused_and_none_is_said() -> None:
    with pytest.raises(InputError, match="unknown what 'my_distortion' is"):
        read({"K": K, "my_distortion": DIST})
    found = read({"K": K})
    assert_lens(found, [])
    assert any("nothing of distortion" in note for note in found.notes)


@pytest.mark.parametrize(
    "content",
    [
        BY_NUMBER | dict(zip(("k1", "k2", "p1", "p2", "k3"), DIST, strict=True)),
        {"intrinsics": BY_NUMBER, "distortion": dict(zip(("k1", "k2", "p1", "p2", "k3"), DIST, strict=True))},
        {"intrinsics": BY_NUMBER | dict(zip(("k1", "k2", "p1", "p2", "k3"), DIST, strict=True))},
        {"intrinsic_matrix": BY_NUMBER, "dist": DIST},
    ],
)
def test_a_lens_number_by_number(content: dict[str, Any]) -> None:
    assert_lens(read(content))


def test_a_fisheye_number_by_number() -> None:
    found = read(BY_NUMBER | {"lens": "fisheye", "k1": 0.1, "k2": -0.02, "k3": 0.003, "k4": -0.0004})
    assert_lens(found, [0.1, -0.02, 0.003, -0.0004])


def test_arrays_of_numpy(tmp_path: Path) -> None:
    np.savez(tmp_path / "lens.npz", mtx=np.array(K), dist=np.array([DIST]))
    _, [found] = read_file(tmp_path / "lens.npz")
    assert_lens(found)
    np.savez(tmp_path / "objects.npz", mtx=np.array([{}], dtype=object))
    with pytest.raises(InputError, match=r"objects\.npz is no file of NumPy's arrays") as refused:
        read_file(tmp_path / "objects.npz")
    assert "np.savez" in refused.value.hint


def test_a_rotation_matrix_and_a_translation_are_a_pose_and_those_of_a_stereo_pair_are_none() -> None:
    rvec = np.array([1.9, 0.2, -0.1])
    pose = {"R": cv2.Rodrigues(rvec)[0].tolist(), "T": [[0.5], [2.0], [15.0]]}
    found = read({"K": K, "D": DIST} | pose)
    np.testing.assert_allclose(found.rvec, rvec, atol=1e-9)
    np.testing.assert_allclose(found.tvec, [0.5, 2.0, 15.0])
    pair = read({"M1": K, "D1": DIST, "M2": K, "D2": DIST} | pose)
    assert pair.rvec is None
    assert any("two cameras" in note for note in pair.notes)


def message(**more: object) -> str:
    """What ROS prints of a ``camera_info``."""
    lines = {
        "height": 720, "width": 1280, "distortion_model": "plumb_bob", "D": DIST, "K": np.ravel(K).tolist(),
        "R": [1, 0, 0, 0, 1, 0, 0, 0, 1], "P": [1100, 0, 639.5, 0, 0, 1090, 359.5, 0, 0, 0, 1, 0], "binning_x": 0,
    } | more  # fmt: skip
    return "".join(f"{name}: {json.dumps(value)}\n" for name, value in lines.items()) + "---\n"


def test_a_printed_message_of_ros() -> None:
    _, [found] = read_named("info.yaml", message())
    assert_lens(found)
    assert found.rvec is None


@pytest.mark.parametrize("more", [{"binning_x": 2}, {"roi": {"x_offset": 10, "y_offset": 0}}])
def test_numbers_of_other_pictures_than_those_recorded_are_refused(more: dict[str, object]) -> None:
    with pytest.raises(InputError, match="binned, or a part"):
        read_named("info.yaml", message(**more))


def test_the_size_is_that_of_the_camera_s_chapters_whatever_lies_beside(tmp_path: Path) -> None:
    """The lens was calibrated on pictures of twice the size."""
    chapters = tmp_path / "recordings" / "north"
    chapters.mkdir(parents=True)
    for name in ("GX010042.MP4", "GX020042.MP4"):
        write_recording(chapters / name, width_px=640, height_px=360)
    (chapters / "GX010042.THM").write_bytes(b"a picture")
    lens = opencv_file(tmp_path, "yaml")
    points = tmp_path / "points.csv"
    half = (np.array(PIXELS) + 0.5) / 2 - 0.5
    rows = [f"{x},{y},{z},{u},{v}" for (x, y, z), (u, v) in zip(GROUND.tolist(), half.tolist(), strict=True)]
    points.write_text("\n".join(["x,y,z,u,v", *rows]))
    told(tmp_path, "north", lens, points)
    [camera] = Site.load(tmp_path / "site.json").cameras
    assert (camera.width_px, camera.height_px) == (640, 360)
