"""What a pose may mean that is none of a camera over a road: the same numbers, read by other conventions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from wibam_core.calibration.view import LIKELY_HEIGHTS_M, is_plausible, roll_rad
from wibam_core.documents.warnings import Caution
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.se3 import SE3

Array = NDArray[np.float64]

#: A camera on a pole is level to this; a pose that is read wrongly hardly ever is.
_LEVEL_RAD = np.radians(10.0)
#: So many ways to read three numbers as a rotation are tried that one may come out level by chance: more is asked then.
_EXACTLY_LEVEL_RAD = np.radians(4.0)
#: A camera is tried at this height, m, where its own may count from elsewhere: between these. Still higher ones are
#: told by their units.
_POLE_M = 8.0
_ELSEWHERE_M = (15.0, 500.0)
#: Two cameras closer together and more alike in direction than this are one calibration, entered twice.
_SAME_M, _SAME_RAD = 0.05, np.radians(0.5)
#: From camera coordinates of OpenCV to those of OpenGL (y up, z backwards), and back; the same turns a world over
#: whose Z points down.
_FLIPPED = np.diag([1.0, -1.0, -1.0])
#: Columns are the world's X, Y and Z (Z up) in worlds whose Y points up, and whose Y points down.
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_Y_DOWN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
#: From camera coordinates of OpenCV to axes of a body as ROS has them (x forward, y left, z up).
_BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

_CONVENTIONS = (
    "rvec and tvec look like camera to world: give their inverse, world to camera.",
    "tvec looks like the camera's position C: give -R C.",
    "tvec looks like the camera's position C with its sign changed: give -R C.",
    "The world's Z axis looks to point down: change the signs of y and z.",
    "The camera's axes look like OpenGL's (y up, z backwards): change the signs of the second and third row of R and "
    "of tvec.",
    "rvec and tvec look like camera to world with OpenGL's axes (y up, z backwards): change the signs of the second "
    "and third column of R, and give the inverse, world to camera.",
    "The world's Y axis looks to point up: turn the world so that Z does.",
    "The world's Y axis looks to point down: turn the world so that Z points up.",
    "The camera's axes look like those of ROS (x forward, y left, z up): its x right, y down and z forward are -y, -z "
    "and x of these.",
    "rvec and tvec look like a pose in the world with axes of ROS (x forward, y left, z up): x right, y down and z "
    "forward are -y, -z and x of these; then give the inverse, world to camera.",
)
_ELSEWHERE = (
    "Heights look counted from elsewhere than the road, e.g. from the sea: with h the road's height there, add "
    "R (0, 0, h) to tvec."
)


def _read(given: SE3) -> Iterator[SE3]:
    """T_world_cam by each of `_CONVENTIONS`, of what was given as T_cam_world."""
    turned = given.rotation.T
    flip, up, down, body = (SE3(matrix, np.zeros(3)) for matrix in (_FLIPPED, _Y_UP, _Y_DOWN, _BODY))
    yield given
    yield SE3(turned, given.translation)
    yield SE3(turned, -given.translation)
    yield flip @ given.inverse()
    yield (flip @ given).inverse()
    yield given @ flip
    yield (given @ up).inverse()
    yield (given @ down).inverse()
    yield given.inverse() @ body
    yield given @ body


def rotation_meant_by(camera: Camera, rvec: ArrayLike, tvec: ArrayLike) -> str | None:
    """What three numbers may be that make no level camera as a rotation vector, in a sentence; None: nothing known.

    Args:
        camera: its intrinsics count.
        rvec: (3,) what was given as rotation vector.
        tvec: (3,) m, as given.
    """
    numbers, moved = np.asarray(rvec, dtype=np.float64).reshape(3), np.asarray(tvec, dtype=np.float64).reshape(3)
    for what, rotation in _rotations(numbers):
        matrix = rotation.as_matrix()
        for way, turned in (("world to camera", matrix), ("camera to world", matrix.T)):
            for place, pose in (
                ("", SE3(turned, moved).inverse()),
                (", and tvec the camera's position C", SE3(turned.T, moved)),
            ):
                read = replace(camera, T_world_cam=pose)
                if _is_usual(read) and (read.is_wide or abs(roll_rad(read)) <= _EXACTLY_LEVEL_RAD):
                    return (
                        f"rvec looks like {what}, {way}{place}: give OpenCV's rotation vector (cv2.Rodrigues of the "
                        "matrix), and tvec = -R C, world to camera."
                    )
    return None


def _rotations(numbers: Array) -> Iterator[tuple[str, Rotation]]:
    """What three numbers say by other conventions than that of a rotation vector."""
    for order, said in (
        ("xyz", "roll, pitch and yaw about fixed axes"),
        ("XYZ", "angles about X, then Y, then Z, each turned by those before"),
        ("ZYX", "yaw, pitch and roll"),
        ("zyx", "angles about fixed Z, Y and X axes"),
    ):
        yield f"{said} (Euler angles, {order!r} in SciPy)", Rotation.from_euler(order, numbers)
    if (square := float(numbers @ numbers)) <= 1.0:
        yield "x, y and z of a quaternion", Rotation.from_quat([*numbers, np.sqrt(1.0 - square)])


def meant_by(cameras: Mapping[str, Camera]) -> list[tuple[str, dict[str, Camera]]]:
    """Conventions by which all cameras are level and look at a road from a usual height, though as given they do not.

    Args:
        cameras: with the poses that were given, by camera id.

    Returns:
        what to do, in a sentence, and the cameras by that convention; several where the numbers allow them.
    """
    given = {camera_id: camera.T_world_cam.inverse() for camera_id, camera in cameras.items()}
    poses = [list(_read(pose)) for pose in given.values()]
    found = []
    for number, sentence in enumerate(_CONVENTIONS):
        read = {
            camera_id: replace(camera, T_world_cam=poses[k][number])
            for k, (camera_id, camera) in enumerate(cameras.items())
        }
        if all(_is_usual(camera) for camera in read.values()):
            found.append((sentence, read))
    if all(_ELSEWHERE_M[0] < camera.centre_m[2] <= _ELSEWHERE_M[1] for camera in cameras.values()):
        lowered = {camera_id: _at_pole(camera) for camera_id, camera in cameras.items()}
        if all(_is_usual(camera) for camera in lowered.values()):
            found.insert(0, (_ELSEWHERE, lowered))
    return found


def _at_pole(camera: Camera) -> Camera:
    pose = camera.T_world_cam
    return replace(camera, T_world_cam=SE3(pose.rotation, np.append(pose.translation[:2], _POLE_M)))


def _is_usual(camera: Camera) -> bool:
    low, high = LIKELY_HEIGHTS_M
    level = camera.is_wide or abs(roll_rad(camera)) <= _LEVEL_RAD
    return bool(level and low <= camera.centre_m[2] <= high and is_plausible(camera))


def repeated_cautions(cameras: Mapping[str, Camera]) -> dict[str, Caution]:
    """By camera id: that a camera stands where an earlier one stands, and looks whither it looks."""
    found: dict[str, Caution] = {}
    listed = list(cameras.items())
    for k, (camera_id, camera) in enumerate(listed):
        for other_id, other in listed[:k]:
            apart = other.T_world_cam.inverse() @ camera.T_world_cam
            turn, shift = (float(np.linalg.norm(part)) for part in apart.to_rvec_tvec())
            if shift <= _SAME_M and turn <= _SAME_RAD:
                found[camera_id] = Caution(
                    code="same_pose",
                    message=f"it stands where camera {other_id} stands, and looks the same way",
                    hint="Was one calibration entered for both? Two views of one place teach no more than one.",
                    details={"with": other_id},
                )
                break
    return found
