"""Rigid transforms. Frame names cancel: ``x_world = T_world_cam.apply(x_cam)``."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def normalise_angle(angle_rad: ArrayLike) -> Array:
    """Wrap angles to (−π, π]. Any shape in, the same shape out."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    return angle - 2 * np.pi * np.ceil((angle - np.pi) / (2 * np.pi))


@dataclass(frozen=True, eq=False)
class SE3:
    """A rigid transform ``T_a_b`` that takes points from frame b to frame a.

    Attributes:
        rotation: (3, 3), orthonormal with determinant +1.
        translation: (3,), metres; the origin of frame b seen in frame a.

    Raises:
        ValueError: if the rotation is not a proper rotation (a mirrored calibration has determinant −1).
    """

    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        rotation = np.array(self.rotation, dtype=np.float64)
        translation = np.array(self.translation, dtype=np.float64).reshape(-1)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise ValueError(f"need a 3x3 rotation and 3 translations, got {rotation.shape} and {translation.shape}")
        if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
            raise ValueError("rotation and translation must be finite")
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-5):
            raise ValueError("rotation is not orthonormal")
        if np.linalg.det(rotation) < 0:
            raise ValueError("rotation is mirrored (determinant -1); a left-handed calibration needs one axis flipped")
        u, _, vt = np.linalg.svd(rotation)
        rotation = u @ vt
        rotation.setflags(write=False)
        translation.setflags(write=False)
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def identity(cls) -> SE3:
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> SE3:
        """From a (4, 4) or (3, 4) homogeneous matrix."""
        m = np.asarray(matrix, dtype=np.float64)
        return cls(m[:3, :3], m[:3, 3])

    @classmethod
    def from_rvec_tvec(cls, rvec: ArrayLike, tvec: ArrayLike) -> SE3:
        """From OpenCV's Rodrigues vector and translation. OpenCV's pair is ``T_cam_world``."""
        rotation, _ = cv2.Rodrigues(np.asarray(rvec, dtype=np.float64).reshape(3, 1))
        return cls(rotation, np.asarray(tvec, dtype=np.float64).reshape(3))

    def to_rvec_tvec(self) -> tuple[Array, Array]:
        """OpenCV's (3,) Rodrigues vector and (3,) translation of this transform."""
        rvec, _ = cv2.Rodrigues(np.array(self.rotation))
        return rvec.reshape(3).astype(np.float64), np.array(self.translation)

    @property
    def matrix(self) -> Array:
        """The (4, 4) homogeneous matrix."""
        m = np.eye(4)
        m[:3, :3] = self.rotation
        m[:3, 3] = self.translation
        return m

    def inverse(self) -> SE3:
        """``T_b_a`` for this ``T_a_b``."""
        return SE3(self.rotation.T, -self.rotation.T @ self.translation)

    def compose(self, other: SE3) -> SE3:
        """``T_a_b.compose(T_b_c) == T_a_c``."""
        return SE3(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def __matmul__(self, other: SE3) -> SE3:
        return self.compose(other)

    def apply(self, points: ArrayLike) -> Array:
        """Transform points (..., 3) from frame b to frame a."""
        return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation

    def rotate(self, vectors: ArrayLike) -> Array:
        """Rotate directions (..., 3) from frame b to frame a."""
        return np.asarray(vectors, dtype=np.float64) @ self.rotation.T
