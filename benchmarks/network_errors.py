"""Detections of traffic that nobody rendered, that err as a fine-tuned network does on rendered sites.

How it errs is measured by `benchmarks/measure_network_errors.py`, and stands in `network_errors.json`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, SIZE, XY, XYZ, YAW
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import normalise_angle
from wibam_core.scene import Vehicles3D

Array = NDArray[np.float64]

#: Distances from the camera (m) and shares hidden at which bins end.
DISTANCES_M = np.array([15.0, 22.0, 30.0, 40.0, 50.0, 70.0])
HIDDEN = np.array([0.05, 0.25, 0.5, 0.75, 1.01])
LONG_M = 7.0
#: Columns of errors: along the line of sight and across it (m), z, length, width, height (m), yaw (rad).
COLUMNS = ("along", "across", "z", "length", "width", "height", "yaw")
MEASURED = Path(__file__).with_suffix(".json")


@dataclass(frozen=True)
class Errors:
    """All parameters of the errors; lists over `COLUMNS`, bins of `DISTANCES_M` and of `HIDDEN`.

    Attributes:
        sd: (D, 7) standard deviation of what is detected, hidden by less than a quarter.
        hidden_factor: (H,) times so much where so much is hidden.
        tails: quantiles at which standardised errors lie, per column, from 2.5 % to 97.5 % in 20 steps.
        lasting, slow: (7,) shares of the variance that stay with a vehicle, and that fade within ``slow_s``.
        slow_s: time in which the correlation of the slow part falls to 1/e.
        stated: (D, 7) stated standard deviations, median. spread: of their logarithm.
        missed: (D, H) shares of vehicles without a detection. missing_s: how long that lasts, as ``slow_s``.
        doubled: second boxes for one detected vehicle. cut: of detected long vehicles, share seen as two.
        false_boxes: of nobody, a picture. turned: share of headings that point backwards.
        scores: quartiles.
    """

    sd: list[list[float]]
    hidden_factor: list[float]
    tails: list[list[float]]
    lasting: list[float]
    slow: list[float]
    slow_s: float
    stated: list[list[float]]
    spread: float
    missed: list[list[float]]
    missing_s: float
    doubled: float
    cut: float
    false_boxes: float
    turned: float
    scores: list[float]
    sites: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path = MEASURED) -> Errors:
        return cls(**json.loads(path.read_text(encoding="utf-8")))


QUANTILES = np.linspace(0.025, 0.975, 20)


def hidden_shares(camera: Camera, boxes: Array) -> tuple[Array, Array]:
    """(N,) distances of boxes from the camera on the ground, and (N,) shares of each one's image box that the image box
    of a nearer one covers most; NaN for those outside the picture."""
    distances = np.hypot(*(boxes[:, XY] - camera.T_world_cam.translation[:2]).T)
    pixels, depth = camera.project(boxes[:, XYZ])
    inside = (depth > 1) & (pixels[:, 0] > 0) & (pixels[:, 0] < camera.width_px - 1)
    inside &= (pixels[:, 1] > 0) & (pixels[:, 1] < camera.height_px - 1)
    hidden = np.full(len(boxes), np.nan)
    rows = np.flatnonzero(inside)
    image = project_boxes(camera, boxes[rows])
    areas = (image[:, 2] - image[:, 0]) * (image[:, 3] - image[:, 1])
    low = np.maximum(image[:, None, :2], image[None, :, :2])
    high = np.minimum(image[:, None, 2:], image[None, :, 2:])
    common = np.maximum(high - low, 0).prod(axis=-1) / np.maximum(areas[:, None], 1e-9)
    nearer = distances[rows][None, :] < distances[rows][:, None]
    hidden[rows] = np.where(nearer, common, 0.0).max(axis=1, initial=0.0)
    return distances, np.nan_to_num(hidden, nan=np.nan)


class SimulatedNetwork:
    """One camera's detections, with errors as measured."""

    def __init__(
        self, camera_id: str, camera: Camera, errors: Errors, rng: np.random.Generator, period_s: float
    ) -> None:
        self.camera_id = camera_id
        self._camera, self._errors, self._rng = camera, errors, rng
        self._sd, self._stated = np.array(errors.sd), np.array(errors.stated)
        self._missed, self._tails = np.array(errors.missed), np.array(errors.tails)
        self._lasting, self._slow = np.array(errors.lasting), np.array(errors.slow)
        self._keep = np.exp(-period_s / errors.slow_s)
        self._keep_missing = np.exp(-period_s / errors.missing_s)
        self._of: dict[int, tuple[Array, Array, float]] = {}

    def detect(self, instant_ns: int, ids: Sequence[int], boxes: Array, classes: Array) -> Vehicles3D:
        """Of vehicles (N,) with true boxes (N, 7) when the picture was taken."""
        rng, errors = self._rng, self._errors
        distances, hidden = hidden_shares(self._camera, boxes)
        found: list[Array] = []
        stated: list[Array] = []
        kinds: list[int] = []
        for vehicle, box, distance, share, kind in zip(
            ids, boxes, distances.tolist(), hidden.tolist(), classes.tolist(), strict=True
        ):
            lasting, slow, missing = self._of.get(vehicle) or (
                rng.normal(size=7),
                rng.normal(size=7),
                float(rng.normal()),
            )
            slow = self._keep * slow + np.sqrt(1 - self._keep**2) * rng.normal(size=7)
            missing = float(self._keep_missing * missing + np.sqrt(1 - self._keep_missing**2) * rng.normal())
            self._of[vehicle] = lasting, slow, missing
            if np.isnan(share) or distance >= DISTANCES_M[-1]:
                continue
            d, h = int(np.searchsorted(DISTANCES_M, distance)), int(np.searchsorted(HIDDEN, share))
            if _uniform(missing) < self._missed[d, h]:
                continue
            fast = np.sqrt(np.maximum(1 - self._lasting - self._slow, 0.0))
            normal = np.sqrt(self._lasting) * lasting + np.sqrt(self._slow) * slow + fast * rng.normal(size=7)
            own = [float(np.interp(_uniform(z), QUANTILES, tail)) for z, tail in zip(normal, self._tails, strict=True)]
            factor = errors.hidden_factor[h]
            error = np.array(own) * self._sd[d] * factor
            says = self._stated[d] * factor * np.exp(errors.spread * rng.normal())
            seen = self._erring(box, error)
            if rng.random() < errors.turned:
                seen[YAW] = normalise_angle(seen[YAW] + np.pi)
            halves = box[LENGTH] > LONG_M and rng.random() < errors.cut
            for part in (-0.25, 0.25) if halves else (0.0,):
                one = seen.copy()
                if halves:
                    one[XY] += part * box[LENGTH] * np.array([np.cos(box[YAW]), np.sin(box[YAW])])
                    one[LENGTH] *= 0.5
                found.append(one)
                stated.append(self._in_world(box, says))
                kinds.append(kind)
            if rng.random() < errors.doubled:
                second = seen + np.concatenate([rng.normal(size=2) * 0.8, np.zeros(5)])
                found.append(second)
                stated.append(self._in_world(box, says * 1.5))
                kinds.append(kind)
        for _ in range(rng.poisson(errors.false_boxes)):
            place = self._somewhere()
            found.append(np.array([*place, 0.75, 4.4, 1.8, 1.5, rng.uniform(-np.pi, np.pi)]))
            stated.append(self._in_world(found[-1], self._stated[2] * 1.5))
            kinds.append(0)
        n = len(found)
        return Vehicles3D.of(
            instant_ns,
            np.array(found).reshape(-1, 7),
            np.array(kinds, np.int64),
            scores=np.interp(rng.random(n), [0, 0.25, 0.5, 0.75, 1], errors.scores),
            sd=np.array(stated).reshape(-1, 7),
            camera_id=self.camera_id,
        )

    def _erring(self, box: Array, error: Array) -> Array:
        sight = box[XY] - self._camera.T_world_cam.translation[:2]
        sight = sight / np.hypot(*sight)
        seen = box.copy()
        seen[XY] += error[0] * sight + error[1] * np.array([-sight[1], sight[0]])
        seen[2:] += error[2:]
        seen[SIZE] = np.maximum(seen[SIZE], 0.5)
        seen[YAW] = normalise_angle(seen[YAW])
        return seen

    def _in_world(self, box: Array, sd: Array) -> Array:
        sight = box[XY] - self._camera.T_world_cam.translation[:2]
        c, s = sight / np.hypot(*sight)
        return np.concatenate([[np.hypot(c * sd[0], s * sd[1]), np.hypot(s * sd[0], c * sd[1])], sd[2:]])

    def _somewhere(self) -> Array:
        rng = self._rng
        for _ in range(100):
            place = rng.uniform(-40, 40, 2)
            pixels, depth = self._camera.project(np.array([[*place, 0.75]]))
            if depth[0] > 1 and 0 < pixels[0, 0] < self._camera.width_px and 0 < pixels[0, 1] < self._camera.height_px:
                return np.asarray(place)
        return rng.uniform(-20, 20, 2)


def _uniform(z: float) -> float:
    """Where a standard normal number lies among all."""
    return 0.5 * (1.0 + math.erf(z / math.sqrt(2.0)))
