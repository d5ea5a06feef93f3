"""Our content as the files of the WIBAM data set."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from wibam_core.errors import InputError
from wibam_core.exchange.base import Content
from wibam_core.exchange.boxes import corner_xywh
from wibam_core.exchange.wibam import hand_labels
from wibam_core.exchange.wibam.layout import PERIOD_NS
from wibam_core.geometry.camera import Camera
from wibam_core.road_users import CLASSES
from wibam_core.traits import NUSCENES_CLASSES


def write(content: Content, root: Path) -> Iterator[Path]:
    """Write all files of a content that has a rig and instants below ``root``; frames as one goes through the paths."""
    assert content.rig is not None
    cameras = list(content.rig)
    numbers = _frame_numbers(sorted(instant.time_ns for instant in content.instants or ()))
    paths = [
        _write_json(root / "annotations" / "wibam_all.json", _document(content, cameras, numbers)),
        *(_write_calibration(root / "calib", n, camera) for n, camera in enumerate(content.rig.values())),
    ]
    for subset, times in content.splits.items():
        path = root / "image_sets" / f"{subset}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            "".join(f"{numbers[time] * len(cameras)}\n" for time in times if time in numbers), encoding="utf-8"
        )
        paths.append(path)
    for name, objects in hand_labels.documents(content.labels or (), cameras, numbers).items():
        paths.append(_write_json(root / "annotations" / "hand_labels" / name, objects))
    return chain(paths, _frames(content, root / "frames", cameras, numbers))


def _frames(content: Content, folder: Path, cameras: Sequence[str], numbers: Mapping[int, int]) -> Iterator[Path]:
    if content.jpeg is None:
        return
    for instant in content.instants or ():
        for camera_id, seen in instant.detections.items():
            path = folder / _frame_name(cameras.index(camera_id), numbers[instant.time_ns])
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.jpeg(camera_id, seen.frame_time_ns))
            yield path


def _frame_numbers(times_ns: Sequence[int]) -> dict[int, int]:
    """Time -> number of the frame; the first may be no negative one."""
    shift = min(0, round(times_ns[0] / PERIOD_NS)) if times_ns else 0
    numbers = {time: round(time / PERIOD_NS) - shift for time in times_ns}
    for a, b in pairwise(times_ns):
        if numbers[a] == numbers[b]:
            raise InputError(
                f"the instants at {a} and {b} ns fall into one period of the data set, of {PERIOD_NS} ns",
                hint="Export at 12.5 frames a second or less.",
            )
    return numbers


def _frame_name(cam: int, number: int) -> str:
    return f"{cam}/{number}.jpg"


def _document(content: Content, cameras: Sequence[str], numbers: Mapping[int, int]) -> dict[str, Any]:
    assert content.rig is not None
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    category = {name: i for i, name in enumerate(NUSCENES_CLASSES, 1)}
    for instant in content.instants or ():
        owners = {(camera, i): vehicle.obj_id for vehicle in instant.vehicles for camera, i in vehicle.views.items()}
        for camera_id, seen in instant.detections.items():
            cam = cameras.index(camera_id)
            image_id = numbers[instant.time_ns] * len(cameras) + cam
            camera = content.rig[camera_id]
            rvec, tvec = camera.T_cam_world.to_rvec_tvec()
            images.append(
                {
                    "id": image_id,
                    "file_name": _frame_name(cam, numbers[instant.time_ns]),
                    "cam": cam,
                    "num_cams": len(cameras),
                    "width": camera.width_px,
                    "height": camera.height_px,
                    "P": camera.K.tolist(),
                    "dist_coefs": camera.dist.tolist(),
                    "rvec": rvec.tolist(),
                    "tvec": tvec.tolist(),
                    "theta_X_d": _heading_deg(camera),
                }
            )
            for i, bbox in enumerate(corner_xywh(seen.boxes).tolist()):
                name = CLASSES[seen.classes[i]].traits.elsewhere.nuscenes.written
                if name is None:
                    continue
                annotations.append(
                    {
                        "id": len(annotations) + 1,
                        "image_id": image_id,
                        "bbox": bbox,
                        "category_id": category[name],
                        "score": float(seen.scores[i]),
                        "obj_id": owners.get((camera_id, i)),
                    }
                )
    categories = [{"id": i, "name": name} for name, i in category.items()]
    return {"images": images, "annotations": annotations, "categories": categories}


def _heading_deg(camera: Camera) -> float:
    """Direction of the optical axis over the ground, counter-clockwise from world X: theta_X_d."""
    x, y, _ = camera.T_world_cam.rotate([0.0, 0.0, 1.0])
    return float(np.degrees(np.arctan2(y, x)))


def _write_json(path: Path, document: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
    return path


def _write_calibration(folder: Path, cam: int, camera: Camera) -> Path:
    rvec, tvec = camera.T_cam_world.to_rvec_tvec()
    path = folder / f"calibration_{cam}.npz"
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(
        path,
        camera_matrix=camera.K,
        dist_coefs=camera.dist[None],
        rvec=rvec[:, None],
        tvec=tvec[:, None],
        theta_X_d=np.array(_heading_deg(camera)),
    )
    return path
