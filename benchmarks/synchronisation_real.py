"""How well the traffic alone synchronises a real site whose cameras share a true clock.

    python -m benchmarks.synchronisation_real SITE_FOLDER --draws 4

The stamps of the recordings are those of one clock. Whether they say when frames were exposed is asked first: in a
frame whose stamp is later than an even one, vehicles either are farther on, or it only arrived late. Each draw shifts
every camera's by up to a minute and lets its clock drift, as if the recordings had been started by hand, and finds
the clocks again from vehicles that the bundled detector sees. SITE_FOLDER is by default ``state_ellsworth`` in the
folder ``real`` beside ``$WIBAM_TEST_ASSETS``.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.association.tracklets import tracklets
from wibam_core.calibration.rig import calibrate
from wibam_core.config import CalibrateConfig
from wibam_core.detection.detector import BUNDLED, load_detector
from wibam_core.errors import WibamError
from wibam_core.geometry.pixels import resized_px, scale_of, shrunk_image
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D
from wibam_core.site import Site
from wibam_core.sync.paths import ground_paths
from wibam_core.sync.witnesses import synchronise
from wibam_core.synthetic.clocks import CameraClock
from wibam_core.video.decode import decode
from wibam_core.video.recording import Recording

FloatArray = NDArray[np.float64]

_WIDTH_PX = 960
#: A stamp is late from here on, and as usual up to there, s.
_LATE_S, _EVEN_S = 0.03, 0.01
#: A vehicle's way is a parabola through this many frames before and after; slower ones tell no time.
_NEAR_FRAMES, _LEAST_SPEED_PX_S = 6, 25.0
_FEWEST_SIGHTINGS = 5


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


def late_frames(frames: list[Detections2D]) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """How late vehicles are seen in frames with late stamps.

    Args:
        frames: of one camera that exposes them at an even rate or is thought to.

    Returns:
        How many stamps are late; and of each sighting (N,) in them by how much later than an even one the stamp is (s),
        by how much later the vehicle's way by the other frames has it there (s), and its weight.
    """
    times_s = np.array([frame.frame_time_ns / 1e9 for frame in frames])
    number = np.rint((times_s - times_s[0]) / np.median(np.diff(times_s)))
    line = np.polyfit(number, times_s, 1)
    for _ in range(10):
        off = times_s - np.polyval(line, number)
        usual = np.abs(off - np.median(off)) < _EVEN_S
        line = np.polyfit(number[usual], times_s[usual], 1)
    even_s = np.polyval(line, number)
    late_s = times_s - even_s
    even = [replace(f, frame_time_ns=round(1e9 * t)) for f, t in zip(frames, even_s, strict=True)]
    camera_id = frames[0].camera_id
    followed = tracklets([AnnotatedInstant(f.frame_time_ns, {camera_id: f}) for f in even], [camera_id], 1.0)
    ways: dict[int, list[tuple[int, float, float]]] = {}
    for k, (frame, numbers) in enumerate(zip(even, followed, strict=True)):
        for box, way in zip(frame.boxes, numbers[camera_id].tolist(), strict=True):
            ways.setdefault(way, []).append((k, *(0.5 * (box[:2] + box[2:])).tolist()))
    rows = []
    for way in ways.values():
        at, px = np.array([k for k, _, _ in way]), np.array([point for _, *point in way])
        for k in np.flatnonzero(np.abs(late_s[at]) > _LATE_S).tolist():
            near = (np.abs(at - at[k]) <= _NEAR_FRAMES) & (np.abs(late_s[at]) < _EVEN_S)
            if min((near & (at < at[k])).sum(), (near & (at > at[k])).sum()) < 2 or near.sum() < 6:
                continue
            powers = np.vander(even_s[at[near]] - even_s[at[k]], 3)
            fit = np.linalg.lstsq(powers, px[near], rcond=None)[0]
            speed = float(np.linalg.norm(fit[1]))
            if speed >= _LEAST_SPEED_PX_S:
                left_px = max(float((px[near] - powers @ fit).std()), 0.5)
                rows.append((late_s[at[k]], (px[k] - fit[2]) @ fit[1] / speed**2, (speed / left_px) ** 2))
    table = np.array(rows).reshape(-1, 3)
    return int((np.abs(late_s) > _LATE_S).sum()), table[:, 0], table[:, 1], table[:, 2]


def tell_stamps(frames: list[Detections2D]) -> None:
    """Print by how much vehicles follow the stamps that are late: 1 where those are the exposures', 0 where not."""
    count, stamp_s, seen_s, weight = late_frames(frames)
    told = f"{frames[0].camera_id}: {count} of {len(frames)} stamps are {1e3 * _LATE_S:.0f} ms off even ones"
    if len(weight) >= _FEWEST_SIGHTINGS:
        weight = np.minimum(weight, np.percentile(weight, 80))
        squares = (weight * stamp_s**2).sum()
        slope = (weight * stamp_s * seen_s).sum() / squares
        left = weight * stamp_s * (seen_s - slope * stamp_s)
        sd = np.sqrt((left**2).sum()) / squares
        told += f"; vehicles follow them by {slope:.2f} ± {sd:.2f} ({len(weight)} sightings)"
    print(told, flush=True)


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
    for frames in seen.values():
        tell_stamps(frames)
    rng = np.random.default_rng(0)
    for _ in range(arguments.draws):
        starts_s = rng.uniform(-1, 1, len(seen)) * arguments.max_offset_s
        drifts = 1e-6 * rng.uniform(-1, 1, len(seen)) * arguments.max_drift_ppm
        clocks = [CameraClock(float(s), float(d), 0) for s, d in zip(starts_s, drifts, strict=True)]
        draw(seen, rig, clocks)


if __name__ == "__main__":
    main()
