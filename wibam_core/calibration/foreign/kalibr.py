"""Kalibr's camchain.yaml. Its poses lead from camera to camera, not to a road: points have to say where cameras are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wibam_core.calibration.foreign.base import Array, FoundCamera, Intrinsics, Reader, vector
from wibam_core.calibration.foreign.fitted import as_fisheye
from wibam_core.calibration.foreign.opencv import parsed_yaml
from wibam_core.errors import InputError
from wibam_core.site import Lens

#: Camera model and distortion model -> our lens.
_LENSES: Mapping[tuple[str, str], Lens] = {
    ("pinhole", "radtan"): "pinhole",
    ("pinhole", "none"): "pinhole",
    ("pinhole", "equidistant"): "fisheye",
    ("omni", "radtan"): "omnidirectional",
    ("omni", "none"): "omnidirectional",
}

_SPHERES = {"ds": "double sphere", "eucm": "enhanced unified camera"}
_WIDEST_DEG = 120.0


def _cameras(text: str) -> dict[str, Mapping[str, Any]]:
    content = parsed_yaml(text) or {}
    return {
        str(name): entry
        for name, entry in content.items()
        if isinstance(entry, dict) and {"camera_model", "intrinsics"} <= entry.keys()
    }


def _recognises(name: str, text: str) -> bool:
    return name.endswith((".yaml", ".yml")) and bool(_cameras(text))


def _read(text: str) -> Sequence[FoundCamera]:
    return [_camera(name, entry) for name, entry in _cameras(text).items()]


def _camera(name: str, entry: Mapping[str, Any]) -> FoundCamera:
    models = str(entry["camera_model"]), str(entry.get("distortion_model") or "none")
    if models[0] in _SPHERES and models[1] == "none":
        return _of_spheres(name, entry)
    if models not in _LENSES:
        raise InputError(
            f"{name}: the lens model {models[0]} with {models[1]} is not read",
            hint="Calibrate with pinhole-radtan, pinhole-equi, omni-radtan, ds-none or eucm-none.",
        )
    lens = _LENSES[models]
    numbers = vector(entry["intrinsics"], f"{name}: intrinsics")
    if numbers.size != (5 if lens == "omnidirectional" else 4):
        raise InputError(f"{name}: intrinsics must have {5 if lens == 'omnidirectional' else 4} numbers")
    fu, fv, pu, pv = numbers[-4:]
    bent = models[1] != "none"
    size = vector(entry.get("resolution"), f"{name}: resolution")
    return FoundCamera(
        name,
        Intrinsics(
            np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1.0]]),
            vector(entry.get("distortion_coeffs") if bent else None, f"{name}: distortion_coeffs"),
            lens,
            float(numbers[0]) if lens == "omnidirectional" else 0.0,
            (int(size[0]), int(size[1])) if size.size == 2 else None,
        ),
        notes=_notes(entry),
    )


def _notes(entry: Mapping[str, Any]) -> tuple[str, ...]:
    chained = any(key.startswith("T_c") for key in entry)
    return ("The poses of a camera chain are left out: they do not say where the road is.",) if chained else ()


def _of_spheres(name: str, entry: Mapping[str, Any]) -> FoundCamera:
    """The double sphere (Usenko, Demmel & Cremers, 3DV 2018) and the enhanced unified model (Khomutenko, Garcia &
    Martinet, RA-L 2016), which are no lens here but look like a fisheye."""
    model = str(entry["camera_model"])
    numbers = vector(entry["intrinsics"], f"{name}: intrinsics")
    size = vector(entry.get("resolution"), f"{name}: resolution")
    if numbers.size != 6 or size.size != 2:
        raise InputError(f"{name}: a lens of the model {model} needs 6 intrinsics and its resolution")
    one, two, fu, fv, pu, pv = numbers.tolist()
    alpha = two if model == "ds" else one
    if not (0 <= alpha < 1 and min(fu, fv) > 0 and (model == "ds" or two > 0) and abs(one) < 10):
        raise InputError(f"{name}: its intrinsics are not those of a lens of the model {model}")

    def radius(angle: Array) -> Array:
        across, along = np.sin(angle), np.cos(angle)
        if model == "ds":
            shifted = one + along
            return np.asarray(across / (alpha * np.hypot(across, shifted) + (1 - alpha) * shifted))
        return np.asarray(across / (alpha * np.sqrt(two * across**2 + along**2) + (1 - alpha) * along))

    angles = np.linspace(0.0, np.radians(_WIDEST_DEG), 1000)[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        grows = (np.diff(radius(angles), prepend=0.0) > 0).cumprod().astype(bool)
    widest = float(angles[grows][-1]) if grows.any() else 0.0
    lens, off_px = as_fisheye(radius, widest, (fu, fv), (pu, pv), (int(size[0]), int(size[1])), _SPHERES[model])
    said = f"A {_SPHERES[model]} is taken as the fisheye (cv2.fisheye) that differs from it by {off_px:.2g} px at most."
    return FoundCamera(name, lens, notes=(*_notes(entry), said))


KALIBR = Reader("Kalibr camchain", _recognises, _read)
