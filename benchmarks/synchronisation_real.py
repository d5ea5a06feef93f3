"""How well the traffic alone synchronises a real site whose cameras share a true clock.

    python -m benchmarks.synchronisation_real SITE_FOLDER --draws 4

The stamps of the recordings are those of one clock. Each draw shifts every camera's by up to a minute and lets its
clock drift, as if the recordings had been started by hand, and finds the clocks again from vehicles that the bundled
detector sees. SITE_FOLDER is by default ``state_ellsworth`` in the folder ``real`` beside ``$WIBAM_TEST_ASSETS``.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from wibam_core.calibration.rig import calibrate
from wibam_core.config import CalibrateConfig
from wibam_core.detection.detector import BUNDLED, load_detector
from wibam_core.errors import WibamError
from wibam_core.geometry.pixels import resized_px, scale_of, shrunk_image
from wibam_core.scene import CameraRig, Detections2D
from wibam_core.site import Site
from wibam_core.sync.paths import ground_paths
from wibam_core.sync.witnesses import synchronise
from wibam_core.synthetic.clocks import CameraClock
from wibam_core.video.decode import decode
from wibam_core.video.recording import Recording

_WIDTH_PX = 960


def detected(folder: Path, site: Site) -> dict[str, list[Detections2D]]:
    """Camera id -> vehicles in every frame of its recording, which is one file."""
    found: dict[str, list[Detections2D]] = {}
    for camera in site.cameras:
        detector = load_detector(BUNDLED, min_score=0.3, nms_iou=0.6)
        [path] = (folder / "recordings").glob(f"{camera.id}.*")
        found[camera.id] = []
        for time_ns, image in decode(Recording.at(path)):
            small = shrunk_image(image, _WIDTH_PX)
            boxes = detector.detect(small)
            scale = scale_of((small.shape[1], small.shape[0]), (image.shape[1], image.shape[0]), 4)
            seen = Detections2D(camera.id, time_ns, resized_px(boxes.boxes, scale), boxes.scores, boxes.classes)
            found[camera.id].append(seen)
    return found


def draw(seen: dict[str, list[Detections2D]], rig: CameraRig, clocks: list[CameraClock]) -> None:
    """Find the clocks and print how wrong they are in the middle of the recordings, and by how many sd."""
    shifted = {
        camera_id: [replace(f, frame_time_ns=clock.local_ns(f.frame_time_ns / 1e9)) for f in frames]
        for (camera_id, frames), clock in zip(seen.items(), clocks, strict=True)
    }
    spans = {c: (frames[0].frame_time_ns / 1e9, frames[-1].frame_time_ns / 1e9) for c, frames in shifted.items()}
    reference_id = next(iter(seen))
    try:
        found = synchronise(spans, reference_id, paths={c: ground_paths(f, rig[c]) for c, f in shifted.items()})
    except WibamError as error:
        print(f"refused: {error.message}")
        return
    middle_s = float(np.median([f.frame_time_ns for frames in seen.values() for f in frames])) / 1e9
    true_ns = clocks[0].local_ns(middle_s)
    errors_s, scaled = [], []
    for camera_id, clock in zip(seen, clocks, strict=True):
        local_ns = clock.local_ns(middle_s)
        errors_s.append((int(found.result.clocks[camera_id].to_reference_ns(local_ns)) - true_ns) / 1e9)
        if camera_id != reference_id:
            scaled.append(errors_s[-1] / found.result.sd_s(camera_id, local_ns / 1e9))
    told = ", ".join(f"{c} {1e3 * e:+.0f} ms" for c, e in zip(seen, errors_s, strict=True))
    print(
        f"worst pair {1e3 * (max(errors_s) - min(errors_s)):.0f} ms ({told}); errors over sd "
        + " ".join(f"{x:.1f}" for x in scaled),
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    assets = Path(os.environ.get("WIBAM_TEST_ASSETS", Path(__file__).resolve().parents[2] / "shared" / "data"))
    parser.add_argument("site", type=Path, nargs="?", default=assets.parent / "real" / "state_ellsworth")
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--max-offset-s", type=float, default=60.0)
    parser.add_argument("--max-drift-ppm", type=float, default=100.0)
    arguments = parser.parse_args()
    site = Site.load(arguments.site / "site.json")
    rig, _ = calibrate(site, CalibrateConfig())
    seen = detected(arguments.site, site)
    rng = np.random.default_rng(0)
    for _ in range(arguments.draws):
        starts_s = rng.uniform(-1, 1, len(seen)) * arguments.max_offset_s
        drifts = 1e-6 * rng.uniform(-1, 1, len(seen)) * arguments.max_drift_ppm
        clocks = [CameraClock(float(s), float(d), 0) for s, d in zip(starts_s, drifts, strict=True)]
        draw(seen, rig, clocks)


if __name__ == "__main__":
    main()
