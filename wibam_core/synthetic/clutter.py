"""What stands in streets and is no vehicle: containers, kiosks, hedges, walls, fences, signs, bins; bushes; poles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.synthetic.facades import Clutter, Kind
from wibam_core.synthetic.layout import SIDEWALK_M, Building, Layout, Pole, Tree, road_distance_m

Array = NDArray[np.float64]

#: Kind -> smallest and largest length, width and height, m, and how often.
_SIZES: dict[Kind, tuple[tuple[float, float], tuple[float, float], tuple[float, float], float]] = {
    "container": ((2.5, 12.5), (1.8, 2.6), (1.6, 3.2), 0.25),
    "hedge": ((2.0, 14.0), (0.6, 1.6), (0.6, 2.2), 0.2),
    "wall": ((3.0, 18.0), (0.2, 0.5), (0.5, 2.4), 0.15),
    "kiosk": ((1.5, 4.5), (1.2, 3.0), (2.0, 3.2), 0.12),
    "sign": ((0.8, 4.0), (0.1, 0.4), (1.0, 3.5), 0.1),
    "fence": ((4.0, 18.0), (0.06, 0.12), (0.8, 2.0), 0.1),
    "bins": ((0.6, 3.5), (0.5, 1.2), (0.8, 1.6), 0.08),
}
_TRIES = 6


def cluttered(layout: Layout, rng: np.random.Generator) -> Layout:
    """The layout with more that stands beside its roads. Nothing stands on a road or within something else."""
    buildings = list(layout.buildings)
    if rng.random() < 0.25:
        buildings = buildings[: len(buildings) // 2]
    kinds = list(_SIZES)
    shares = np.array([_SIZES[kind][3] for kind in kinds])
    for _ in range(int(rng.integers(4, 40))):
        kind = kinds[int(rng.choice(len(kinds), p=shares / shares.sum()))]
        placed = _placed(layout, kind, buildings, rng)
        if placed is not None:
            buildings.append(placed)
    trees = [_other_tree(tree, rng) for tree in layout.trees if rng.random() < 0.8]
    trees += _bushes(layout, rng)
    poles = [
        Pole(x, y, float(rng.uniform(1.0, 9.0)), float(rng.uniform(0.04, 0.16)), (float(rng.uniform(30, 220)),) * 3)
        for x, y in _free_places(layout, int(rng.integers(0, 14)), 0.3, rng)
    ]
    return replace(layout, buildings=tuple(buildings), trees=tuple(trees), poles=(*layout.poles, *poles))


def _free_places(layout: Layout, count: int, clearance_m: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Ground places beside roads."""
    found = []
    for _ in range(count):
        x, y = _beside(layout, rng)
        if float(road_distance_m(layout.arms, np.array([x, y]))) > clearance_m and layout.is_free(x, y, 0.3):
            found.append((x, y))
    return found


def _beside(layout: Layout, rng: np.random.Generator) -> tuple[float, float]:
    arm = layout.arms[int(rng.integers(len(layout.arms)))]
    side = 1 if rng.random() < 0.5 else -1
    edge = arm.in_edge_m if side > 0 else -arm.out_edge_m
    lateral = side * (edge + rng.exponential(5.0) + 0.5)
    x, y = arm.point(float(rng.uniform(3.0, arm.stop_m + 45)), lateral).tolist()
    return x, y


def _placed(layout: Layout, kind: Kind, buildings: list[Building], rng: np.random.Generator) -> Clutter | None:
    lengths, widths, heights, _ = _SIZES[kind]
    for _ in range(_TRIES):
        x, y = _beside(layout, rng)
        length, width = rng.uniform(*lengths), rng.uniform(*widths)
        angle = layout.arms[int(rng.integers(len(layout.arms)))].heading_rad + rng.normal(0, 0.15)
        along = length / 2 * np.array([np.cos(angle), np.sin(angle)])
        across = width / 2 * np.array([-np.sin(angle), np.cos(angle)])
        centre = np.array([x, y])
        outline = np.array(
            [centre - along - across, centre + along - across, centre + along + across, centre - along + across]
        )
        share = np.linspace(0, 1, 5)[:, None]
        samples = np.concatenate([outline[i] * (1 - share) + outline[(i + 1) % 4] * share for i in range(4)])
        if road_distance_m(layout.arms, samples).min() < 0.3 or not layout.is_free(x, y, length / 2):
            continue
        reach = length / 2 + SIDEWALK_M / 4
        if any(np.hypot(*(b.footprint.mean(axis=0) - centre)) < reach for b in buildings if isinstance(b, Clutter)):
            continue
        height = float(rng.uniform(*heights))
        return Clutter(outline, height, (128.0, 128.0, 128.0), height, kind)
    return None


def _other_tree(tree: Tree, rng: np.random.Generator) -> Tree:
    colour = (float(rng.uniform(15, 80)), float(rng.uniform(45, 140)), float(rng.uniform(30, 140)))
    crown = tree.crown_m * float(rng.uniform(0.7, 1.6))
    return replace(tree, crown_m=crown, height_m=max(tree.height_m, 1.5 * crown), colour=colour)


def _bushes(layout: Layout, rng: np.random.Generator) -> list[Tree]:
    bushes = []
    for x, y in _free_places(layout, int(rng.integers(0, 12)), 1.2, rng):
        crown = float(rng.uniform(0.4, 1.1))
        colour = (float(rng.uniform(15, 80)), float(rng.uniform(45, 130)), float(rng.uniform(30, 130)))
        bushes.append(Tree(x, y, crown * float(rng.uniform(1.3, 1.9)), crown, colour))
    return bushes
