"""How well boxes are put together, by our association and by the published one, on simulated sites.

2D boxes are the true visible ones with jitter, misses, false boxes and wrong classes (`benchmarks.lifting`). Prints of
pairs of boxes of different cameras how many of those said to show one vehicle do (precision), how many of those that do
are said to (recall) and F1; identity switches: how often a vehicle that is seen has another track than when it was seen
last, per 100 vehicles; and how often a track goes over to another vehicle, per 100 tracks. With ``--turned-deg`` every
camera is turned by that angle about a random axis, which makes cameras disagree, by so many metres at the median;
"wider gates" associates with the covariance of such an error.

Run: python -m benchmarks.association_accuracy [--seeds 1 2 3] [--seconds 60] [--turned-deg 0 0.5]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import torch

from benchmarks.lifting import Site, pair_scores, simulate
from benchmarks.robustness import with_wrong_poses
from wibam_core.association.associate import associate
from wibam_core.association.linking import linked_over_time
from wibam_core.association.published import clustered_as_published
from wibam_core.association.rays import ground_points
from wibam_core.config import AssociateConfig
from wibam_core.scene import AnnotatedInstant, CameraRig

CONFIG = AssociateConfig()


def switches(true: Sequence[AnnotatedInstant], found: Sequence[AnnotatedInstant]) -> tuple[int, int]:
    """How often a true vehicle changes its track, that of most of its boxes, and how many vehicles there are.

    With tracks given as true and vehicles as found: how often a track goes over to another vehicle.
    """
    last: dict[int, int] = {}
    count = 0
    for one, other in zip(true, found, strict=True):
        track_of = {view: v.track_id for v in other.vehicles for view in v.views.items() if v.track_id >= 0}
        for vehicle in one.vehicles:
            if vehicle.track_id < 0:
                continue
            tracks = sorted(track_of[view] for view in vehicle.views.items() if view in track_of)
            if not tracks:
                continue
            track = max(tracks, key=tracks.count)
            count += last.get(vehicle.track_id, track) != track
            last[vehicle.track_id] = track
    return count, len(last)


def disagreement_m(site: Site, rig: CameraRig) -> float:
    """Median distance of the ground points of two boxes of one true vehicle."""
    found = []
    for instant in site.instants:
        points = {
            name: ground_points(rig[name], seen.whole_boxes, seen.classes) for name, seen in instant.detections.items()
        }
        for vehicle in instant.vehicles:
            for (a, i), (b, j) in combinations(vehicle.views.items(), 2):
                found.append(np.linalg.norm(points[a][i] - points[b][j]))
    return float(np.nanmedian(found))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--turned-deg", type=float, nargs="+", default=[0.0])
    parser.add_argument("--cache", type=Path, default=Path("build/lifting"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    print("| seed | turned by (°) | cameras disagree by (m) | most in view | method | precision | recall | F1 "
          "| switches per 100 vehicles | going over per 100 tracks |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|")
    for seed in arguments.seeds:
        site = simulate(seed, arguments.seconds, arguments.cache)
        detected = [AnnotatedInstant(i.time_ns, i.detections) for i in site.instants]
        most = max(len(instant.vehicles) for instant in site.instants)
        for turned_deg in arguments.turned_deg:
            rng = np.random.default_rng([seed, 7])
            rig = with_wrong_poses(site.rig, turned_deg, rng) if turned_deg else site.rig
            covariance = np.diag([np.radians(turned_deg) ** 2 / 3] * 3 + [1e-6] * 3)
            ways = {"tracked": associate(detected, rig, CONFIG)}
            if turned_deg:
                ways["tracked, wider gates"] = associate(detected, rig, CONFIG, poses=dict.fromkeys(rig, covariance))
            ways["paper"] = linked_over_time(clustered_as_published(detected, rig, CONFIG), rig, CONFIG)
            for name, found in ways.items():
                precision, recall = pair_scores(site.instants, found)
                changed, vehicles = switches(site.instants, found)
                over, tracks = switches(found, site.instants)
                print(
                    f"| {seed} | {turned_deg:g} | {disagreement_m(site, rig):.2f} | {most} | {name} | {precision:.3f} "
                    f"| {recall:.3f} | {2 * precision * recall / max(precision + recall, 1e-9):.3f} "
                    f"| {100 * changed / max(vehicles, 1):.1f} | {100 * over / max(tracks, 1):.1f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
