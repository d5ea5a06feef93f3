"""What fine-tuning and detection cost beside an older checkout of this project: CPU seconds of both, in turn.

Each round, each checkout runs in a process of its own with its own code, on images that it renders itself by the same
seed, on one thread: a step of fine-tuning the small network (8 whole images; the median of some), with bfloat16 where
the processor has it and without, and detection with the second look, an image. Setting up is not counted. Printed are
the medians of the rounds, and of their ratios.

Run: OMP_NUM_THREADS=1 python benchmarks/against.py CHECKOUT [--rounds 3] [--steps 6] [--instants 24]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]

#: What each process runs: names that moved since 0.1.0 are looked for in both places.
_WORK = """
import json, os, sys, tempfile, time
from pathlib import Path
import cv2, torch
import wibam_core.training.device as device
from benchmarks.training import make_dataset, step_seconds
from wibam_core.config import DetectConfig
from wibam_core.detection.detector import BUNDLED, load_detector
try:
    from wibam_core.models.weights import bundled
    from wibam_core.networks.registry import load_network
except ImportError:
    from wibam_core.networks.weights import bundled, load_network

torch.set_num_threads(1)
cv2.setNumThreads(1)
steps, instants = map(int, sys.argv[1:])
taken = {}
with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    dataset = make_dataset(folder / "frames", instants)
    for kind in ("bfloat16", "float32"):
        if kind == "float32":
            device.has_bfloat16 = lambda: False
        elif not device.has_bfloat16():
            continue
        network = load_network(bundled("mono_small.safetensors"))
        taken["a training step, " + kind] = step_seconds(
            network, dataset, steps, folder, time.process_time, device="cpu"
        )
    store, config, quiet = dataset.frames, DetectConfig(), lambda *_, **__: None
    detector = load_detector(BUNDLED, min_score=config.min_score, nms_iou=config.nms_iou)
    frame_sets = store.thinned(100)
    start = time.process_time()
    try:
        from wibam_core.detection.instants import frames_of
        from wibam_core.detection.second_look import backgrounds_shown, background_frames, look_again
        from wibam_core.stages.detect import _first_look, _search_all
        from functools import partial
        frames = frames_of(frame_sets)
        times_ns = {camera_id: store.stored_ns(camera_id) for camera_id in store.camera_ids}
        shown = backgrounds_shown(store, times_ns, config.background_s, None)
        first_look = partial(_first_look, store, detector)
        looks = dict(_search_all(store, background_frames(frames, shown), first_look, quiet))
        found = dict(look_again(store, frames, looks, first_look, shown, config, quiet))
        images, boxes = len(found), sum(len(one.boxes) for one in found.values())
    except ImportError:
        from wibam_core.stages.detect import _detect_all
        from wibam_core.stages.edges import refine_all
        seen = list(refine_all(store, list(_detect_all(store, frame_sets, detector, quiet)), config, quiet))
        found = [one for instant in seen for one in instant.detections.values()]
        images, boxes = len(found), sum(len(one.boxes) for one in found)
    taken["detection with the second look, an image"] = (time.process_time() - start) / images
    taken["boxes an image"] = boxes / images
print(json.dumps(taken))
"""


def run(checkout: Path, steps: int, instants: int) -> dict[str, float]:
    """Work -> CPU seconds, as the code of a checkout does it; and how many boxes an image was found to have.

    Raises:
        subprocess.CalledProcessError: it failed.
    """
    done = subprocess.run(
        [sys.executable, "-c", _WORK, str(steps), str(instants)],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"},
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path, help="the other one")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=6)
    parser.add_argument("--instants", type=int, default=24, help="of four images each")
    arguments = parser.parse_args()
    rounds = [
        [run(checkout, arguments.steps, arguments.instants) for checkout in (arguments.checkout.resolve(), HERE)]
        for _ in range(arguments.rounds)
    ]
    for name in rounds[0][1]:
        then, now = np.array([[one[name] for one in pair] for pair in rounds]).T
        print(f"{name}: {np.median(then):.4f}, now {np.median(now):.4f}, ratio {np.median(then / now):.2f}", flush=True)


if __name__ == "__main__":
    main()
