"""Kalibr's camchain.yaml. Its poses lead from camera to camera, not to a road: points have to say where cameras are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wibam_core.calibration.foreign.base import FoundCamera, Intrinsics, Reader, vector
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
    if models not in _LENSES:
        raise InputError(
            f"{name}: the lens model {models[0]} with {models[1]} is not read",
            hint="Calibrate with pinhole-radtan, pinhole-equi or omni-radtan.",
        )
    lens = _LENSES[models]
    numbers = vector(entry["intrinsics"], f"{name}: intrinsics")
    if numbers.size != (5 if lens == "omnidirectional" else 4):
        raise InputError(f"{name}: intrinsics must have {5 if lens == 'omnidirectional' else 4} numbers")
    fu, fv, pu, pv = numbers[-4:]
    bent = models[1] != "none"
    size = vector(entry.get("resolution"), f"{name}: resolution")
    notes = ("The poses of a camera chain are left out: they do not say where the road is.",)
    return FoundCamera(
        name,
        Intrinsics(
            np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1.0]]),
            vector(entry.get("distortion_coeffs") if bent else None, f"{name}: distortion_coeffs"),
            lens,
            float(numbers[0]) if lens == "omnidirectional" else 0.0,
            (int(size[0]), int(size[1])) if size.size == 2 else None,
        ),
        notes=notes if any(key.startswith("T_c") for key in entry) else (),
    )


KALIBR = Reader("Kalibr camchain", _recognises, _read)
