"""How long association takes, and how that grows with the recording.

Boxes are those of simulated traffic in four cameras, with jitter, misses and false ones; no images are made. Two
minutes of it are repeated, each time with other errors, until there are enough instants. CPU time, one thread, the
best of some repetitions.

    OMP_NUM_THREADS=1 python benchmarks/association.py --instants 827 8270
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numpy.typing import NDArray

from wibam_core.association.associate import associate, association_statistics
from wibam_core.config import AssociateConfig
from wibam_core.geometry.box3d import XY
from wibam_core.geometry.boxes2d import clipped_to_image, sides_px
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import project_boxes
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D
from wibam_core.synthetic.cameras import site_cameras
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.traffic import Traffic, simulate_traffic

Array = NDArray[np.float64]

PERIOD_NS = 160_000_000
REPEATED_S = 120.0
SIZE_PX = (640, 360)
FALSE_SIZE_PX = np.array([40, 30])
MIN_SIDE_PX = 8.0
RANGE_M = 50.0
RECALL, FALSE_BOXES, JITTER, JITTER_PX = 0.9, 0.1, 0.02, 0.5


def true_boxes(traffic: Traffic, camera: Camera, time_s: float) -> tuple[Array, NDArray[np.int64]]:
    """Image boxes (N, 4), in px, of the vehicles near a camera, and their classes (N,)."""
    present, boxes = traffic.at(time_s)
    classes = np.array([vehicle.model.vehicle_class.number for vehicle in present], np.int64)
    near = np.hypot(*(boxes[:, XY] - camera.centre_m[:2]).T) < RANGE_M
    seen = project_boxes(camera, boxes[near])
    large = sides_px(seen).min(axis=1, initial=np.inf) >= MIN_SIDE_PX
    return seen[large], classes[near][large]


def detected(
    camera_id: str, time_ns: int, true: tuple[Array, NDArray[np.int64]], rng: np.random.Generator
) -> Detections2D:
    """What a detector makes of true boxes."""
    found = rng.random(len(true[0])) < RECALL
    boxes, classes = true[0][found], true[1][found]
    boxes = boxes + rng.normal(size=boxes.shape) * np.hypot(JITTER_PX, JITTER * np.tile(sides_px(boxes), 2))
    corners = rng.uniform([0, 0], SIZE_PX - FALSE_SIZE_PX, (rng.poisson(FALSE_BOXES), 2))
    boxes = clipped_to_image(np.concatenate([boxes, np.hstack([corners, corners + FALSE_SIZE_PX])]), *SIZE_PX)
    boxes[:, 2:] = np.maximum(boxes[:, 2:], boxes[:, :2] + 1)
    scores = rng.uniform(0.4, 0.9, len(boxes))
    return Detections2D(camera_id, time_ns, boxes, scores, np.append(classes, np.zeros(len(corners), np.int64)))


def recording(count: int, seed: int) -> tuple[CameraRig, list[AnnotatedInstant]]:
    """Four cameras, and so many instants of what they detect."""
    rng = np.random.default_rng(seed)
    layout = make_layout(seed)
    rig = CameraRig({f"cam{k}": c for k, c in enumerate(site_cameras(layout, rng, 4, SIZE_PX, distortion=True))})
    traffic = simulate_traffic(layout, seed, REPEATED_S, SignalProgram())
    steps = round(REPEATED_S * 1e9 / PERIOD_NS)
    truth = [
        {name: true_boxes(traffic, camera, k * PERIOD_NS * 1e-9) for name, camera in rig.items()}
        for k in range(min(count, steps))
    ]
    return rig, [
        AnnotatedInstant(
            k * PERIOD_NS, {name: detected(name, k * PERIOD_NS, truth[k % steps][name], rng) for name in rig}
        )
        for k in range(count)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--instants", type=int, nargs="+", default=[827, 8270])
    parser.add_argument("--repetitions", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print("instants  boxes/instant  vehicles  tracks    CPU s  ms/instant  times the first")
    first_s = 0.0
    for count in arguments.instants:
        rig, instants = recording(count, arguments.seed)
        taken = []
        for _ in range(arguments.repetitions):
            start = time.process_time()
            found = associate(instants, rig, AssociateConfig())
            taken.append(time.process_time() - start)
        seconds = min(taken)
        first_s = first_s or seconds
        counts = association_statistics(found)
        print(
            f"{count:8d}  {counts.boxes / count:13.1f}  {counts.vehicles:8d}  {counts.tracks:6d}  {seconds:7.2f}"
            f"  {1e3 * seconds / count:10.2f}  {seconds / first_s:15.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
