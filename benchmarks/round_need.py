"""How much a detector overlooks by the views' agreement, before any round: what decides whether one is run.

Of the outputs of ``wibam run SITE --until rounds``, the judging alone is done and timed; nothing is taught. With
``--overlooking`` a share of the boxes is left out at random, as a worse detector would.

Run: python -m benchmarks.round_need SITE [SITE ...] --overlooking 0 0.2 0.4 --seed 0
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.config import PipelineConfig
from wibam_core.documents.rounds import HeldOutAgreement
from wibam_core.models.weights import bundled
from wibam_core.rounds.rounds import first_agreement
from wibam_core.rounds.settled import settled
from wibam_core.rounds.world import Options, World
from wibam_core.scene import Boxes2D, FrameKey
from wibam_core.stages.runner import SiteFolder, latest
from wibam_core.stages.store import StageStore


def judged(
    outputs: ArtifactReader, config: PipelineConfig, detected: Mapping[FrameKey, Boxes2D]
) -> tuple[HeldOutAgreement, float]:
    """The agreement that decides, and the CPU seconds that it takes."""
    covariances = outputs.read(catalogue.DETECTOR_REFINEMENT).covariances
    options = Options(config.rounds, config.detect, config.associate, config.dataset, config.lift)
    with tempfile.TemporaryDirectory() as scratch:
        world = World(
            outputs.read(catalogue.DETECTOR_RIG),
            {name: np.array(matrix) for name, matrix in covariances.items()},
            outputs.read(catalogue.FRAMES),
            outputs.read(catalogue.SEARCHED_INSTANTS),
            {},
            bundled("mono_small.safetensors"),
            options,
            Path(scratch),
        )
        began = time.process_time()
        need = first_agreement(world, settled(world, detected))
        return need, time.process_time() - began


def worse(detected: Mapping[FrameKey, Boxes2D], share: float, seed: int) -> dict[FrameKey, Boxes2D]:
    """Without a share of the boxes, drawn at random."""
    rng = np.random.default_rng(seed)
    kept = {frame: rng.random(len(detected[frame].boxes)) >= share for frame in sorted(detected)}
    return {frame: Boxes2D(*(values[rows] for values in detected[frame])) for frame, rows in kept.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sites", type=Path, nargs="+", help="site folders that were run until rounds")
    parser.add_argument("--outputs", type=Path, help="where the stages' outputs are; without: SITE/outputs")
    parser.add_argument("--overlooking", type=float, nargs="+", default=[0.0], help="shares of boxes to leave out")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print("| site | boxes left out | boxes an image | held-out sightings | found | CPU s |\n|---|---|---|---|---|---|")
    for site in arguments.sites:
        outputs = latest(SiteFolder.load(site), StageStore(arguments.outputs or site / "outputs"))
        everything = outputs.read(catalogue.DETECTIONS)
        for share in arguments.overlooking:
            detected = worse(everything, share, arguments.seed)
            need, seconds = judged(outputs, PipelineConfig(), detected)
            boxes = np.mean([len(seen.boxes) for seen in detected.values()])
            found = "–" if need.found is None else f"{need.found:.2f}"
            asked = need.sightings + need.missed
            print(f"| {site.name} | {share:.1f} | {boxes:.1f} | {asked} | {found} | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    main()
