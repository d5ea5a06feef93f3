"""Times to collision beside those of another program, TwoDimTTC, on the true states of a simulated site.

git clone https://github.com/Yiru-Jiao/Two-Dimensional-Time-To-Collision
python benchmarks/time_to_collision.py --code Two-Dimensional-Time-To-Collision/src --site 147
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.conflicts import PERIOD_NS, make_site
from wibam_core.geometry.box3d import LENGTH, WIDTH, XY, YAW, X, Y
from wibam_core.safety.ttc import footprints_touch, time_to_collision

Array = NDArray[np.float64]

#: Pairs that are farther apart are left out, m; longer times are counted as none, s.
_APART_M, _LONGEST_S = 60.0, 10.0
_HALF_STEP_S = 0.02


def pairs_of(site: Any) -> tuple[Array, Array, Array, Array]:
    """Boxes (N, 7) and velocities (N, 2), m/s, of two road users each, at all instants of a site's traffic."""
    found: list[tuple[Array, Array, Array, Array]] = []
    for instant in range(PERIOD_NS, int(site.traffic.duration_s * 1e9) - PERIOD_NS, PERIOD_NS):
        states = [site.traffic.at(instant * 1e-9 + shift_s) for shift_s in (-_HALF_STEP_S, 0.0, _HALF_STEP_S)]
        ids = [[trip.vehicle_id for trip in present] for present, _ in states]
        if ids[0] != ids[1] or ids[1] != ids[2] or len(ids[1]) < 2:
            continue
        before, boxes, after = (of for _, of in states)
        velocities = (after[:, XY] - before[:, XY]) / (2 * _HALF_STEP_S)
        i, j = np.triu_indices(len(boxes), 1)
        near = np.hypot(*(boxes[i][:, XY] - boxes[j][:, XY]).T) < _APART_M
        i, j = i[near], j[near]
        found.append((boxes[i], velocities[i], boxes[j], velocities[j]))
    one, other, third, fourth = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return one, other, third, fourth


def theirs(code: Path, boxes_a: Array, velocities_a: Array, boxes_b: Array, velocities_b: Array) -> Array:
    """(N,) what the other program says: inf where the two never meet, below 0 where they overlap."""
    import pandas as pd  # type: ignore[import-untyped]

    sys.path.insert(0, str(code))
    import TwoDimTTC  # type: ignore[import-not-found]

    columns: dict[str, Array] = {}
    for name, boxes, velocities in (("i", boxes_a, velocities_a), ("j", boxes_b, velocities_b)):
        columns |= {f"x_{name}": boxes[:, X], f"y_{name}": boxes[:, Y]}
        columns |= {f"vx_{name}": velocities[:, 0], f"vy_{name}": velocities[:, 1]}
        columns |= {f"hx_{name}": np.cos(boxes[:, YAW]), f"hy_{name}": np.sin(boxes[:, YAW])}
        columns |= {f"length_{name}": boxes[:, LENGTH], f"width_{name}": boxes[:, WIDTH]}
    with np.errstate(all="ignore"):
        return np.asarray(TwoDimTTC.TTC(pd.DataFrame(columns), "values"), np.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--code", type=Path, required=True, help="folder with TwoDimTTC.py")
    parser.add_argument("--site", type=int, default=147)
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--cache", type=Path, default=Path("build/conflicts"))
    arguments = parser.parse_args()
    pairs = pairs_of(make_site(arguments.site, arguments.seconds, arguments.cache))
    ours, other = time_to_collision(*pairs), theirs(arguments.code, *pairs)
    overlap = footprints_touch(pairs[0], pairs[2])
    meet, they_meet = (ours <= _LONGEST_S) & ~overlap, (other >= 0) & (other <= _LONGEST_S) & ~overlap
    both = meet & they_meet
    apart_s = np.abs(ours[both] - other[both])
    print(f"{len(ours)} pairs of states, {overlap.sum()} overlap")
    print(f"within {_LONGEST_S:g} s {meet.sum()} meet by ours, {they_meet.sum()} by theirs, {both.sum()} by both")
    print(f"times by both differ by {apart_s.max():.2g} s at most")
    for name, only in (("ours", meet & ~they_meet), ("theirs", they_meet & ~meet)):
        speeds = np.hypot(*(pairs[1][only] - pairs[3][only]).T)
        print(f"only {name}: {only.sum()}, at relative speeds of {speeds.max(initial=0.0):.2g} m/s at most")


if __name__ == "__main__":
    main()
