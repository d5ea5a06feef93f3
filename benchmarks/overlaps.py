"""How fast bird's-eye-view overlaps of pairs of boxes are, beside OpenCV's and shapely's, and how exact.

Boxes of 3 to 6 m by 1.5 to 2.5 m, each with another about 1 m off that is turned by about 0.4 rad. CPU time, the median
of several repetitions, one thread.

    OMP_NUM_THREADS=1 python benchmarks/overlaps.py --pairs 10000
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, SIZE, SIZE_XY, WIDTH, XY, YAW, footprints
from wibam_core.geometry.iou import bev_iou_paired

Array = NDArray[np.float64]


def pairs_of_boxes(count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Boxes (P, 7) and others near them."""
    a = np.zeros((count, 7))
    a[:, XY] = rng.uniform(-40, 40, (count, 2))
    a[:, SIZE] = rng.uniform([3.0, 1.5, 1.5], [6.0, 2.5, 1.5], (count, 3))
    a[:, YAW] = rng.uniform(-np.pi, np.pi, count)
    b = a.copy()
    b[:, XY] += rng.normal(size=(count, 2))
    b[:, SIZE_XY] *= rng.uniform(0.8, 1.2, (count, 2))
    b[:, YAW] += rng.normal(0, 0.4, count)
    return a, b


def from_overlaps(a: Array, b: Array, overlap: Array) -> Array:
    """IoU (P,) from overlaps (P,) in m²."""
    return overlap / (a[:, LENGTH] * a[:, WIDTH] + b[:, LENGTH] * b[:, WIDTH] - overlap)


def by_opencv(a: Array, b: Array) -> Array:
    """IoU (P,), a call of OpenCV a pair; it computes in float32."""
    overlap = np.zeros(len(a))
    for k, (first, second) in enumerate(zip(footprints(a), footprints(b), strict=True)):
        overlap[k] = cv2.intersectConvexConvex(first.astype(np.float32), second.astype(np.float32))[0]
    return from_overlaps(a, b, overlap)


def by_shapely(a: Array, b: Array) -> Array:
    """IoU (P,), all pairs in one call."""
    first, second = shapely.polygons(footprints(a)), shapely.polygons(footprints(b))
    return from_overlaps(a, b, shapely.area(shapely.intersection(first, second)))


def median_cpu_s(work: Callable[[], object], repetitions: int) -> float:
    """CPU seconds of a piece of work."""
    taken = []
    for _ in range(repetitions):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return float(np.median(taken))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=10_000)
    parser.add_argument("--repetitions", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    a, b = pairs_of_boxes(arguments.pairs, np.random.default_rng(arguments.seed))
    exact = by_shapely(a, b)
    ours_s = median_cpu_s(lambda: bev_iou_paired(a, b), arguments.repetitions)
    print(f"{arguments.pairs} pairs      CPU ms   x ours   largest error")
    for name, method in (("ours", bev_iou_paired), ("OpenCV", by_opencv), ("shapely", by_shapely)):
        taken_s = median_cpu_s(lambda method=method: method(a, b), arguments.repetitions)
        print(f"{name:12s} {1e3 * taken_s:12.1f} {taken_s / ours_s:8.1f} {np.abs(method(a, b) - exact).max():15.1e}")


if __name__ == "__main__":
    main()
