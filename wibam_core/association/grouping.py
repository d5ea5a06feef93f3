"""Which tracklets of all cameras show the same vehicle.

At one instant clusters of rays err: a flat ray lies metres off, and for seconds in the same way. In the image a vehicle
is followed easily, however. So it is tracklets that are put together, by how often their boxes met in one cluster; and
since a camera sees a vehicle once, two that one camera saw at the same time are never put together.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from wibam_core.scene import IntArray

#: Tracklets are put together if their boxes met at this share of the instants that both were there.
_MET_SHARE = 0.5


def group(tracklets: Sequence[IntArray], clusters: Sequence[IntArray], cameras: IntArray) -> IntArray:
    """The vehicle (T,) of each of T tracklets, numbered from 0 on.

    Args:
        tracklets: for every instant (N,) of each ray; each tracklet is of one camera, which it has one ray of.
        clusters: for every instant (N,) the cluster of each ray, counted from 0.
        cameras: (T,) of the tracklets.
    """
    there = _instants(tracklets, len(cameras))
    vehicles = _Vehicles(cameras, there)
    for a, b in _meetings(tracklets, clusters, there):
        vehicles.join(a, b)
    return vehicles.numbers()


def _instants(tracklets: Sequence[IntArray], count: int) -> list[IntArray]:
    """Of each tracklet the instants (n,) at which it was seen, in order."""
    of_rays = np.concatenate([*tracklets, np.empty(0, np.int64)])
    instants = np.repeat(np.arange(len(tracklets)), [len(ids) for ids in tracklets])
    order = np.argsort(of_rays, kind="stable")
    return np.split(instants[order], np.searchsorted(of_rays[order], np.arange(1, count)))


def _meetings(
    tracklets: Sequence[IntArray], clusters: Sequence[IntArray], there: Sequence[IntArray]
) -> list[tuple[int, int]]:
    """Pairs of tracklets whose boxes mostly met when both were there, those that met most often first."""
    met: dict[tuple[int, int], int] = defaultdict(int)
    for ids, labels in zip(tracklets, clusters, strict=True):
        order = np.lexsort((ids, labels))
        for own in np.split(ids[order], np.flatnonzero(np.diff(labels[order])) + 1):
            for k, a in enumerate(own.tolist()):
                for b in own[k + 1 :].tolist():
                    met[a, b] += 1
    pairs = []
    for (a, b), count in met.items():
        share = count / len(np.intersect1d(there[a], there[b], assume_unique=True))
        if share >= _MET_SHARE:
            pairs.append((-count, -share, a, b))
    return [pair[2:] for pair in sorted(pairs)]


class _Vehicles:
    """Tracklets in disjoint sets, none of which holds two that one camera saw at the same time."""

    def __init__(self, cameras: IntArray, there: Sequence[IntArray]) -> None:
        self._parent = list(range(len(cameras)))
        self._seen: list[dict[int, list[tuple[int, int]]]] = [
            {int(camera): [(int(instants[0]), int(instants[-1]))]} if len(instants) else {}
            for camera, instants in zip(cameras, there, strict=True)
        ]

    def _root(self, one: int) -> int:
        while self._parent[one] != one:
            self._parent[one] = self._parent[self._parent[one]]
            one = self._parent[one]
        return one

    def join(self, a: int, b: int) -> None:
        """Put the sets of two tracklets together where that can be."""
        a, b = self._root(a), self._root(b)
        if a == b:
            return
        ours, theirs = self._seen[a], self._seen[b]
        for camera in ours.keys() & theirs.keys():
            for first, last in ours[camera]:
                if any(first <= end and begin <= last for begin, end in theirs[camera]):
                    return
        for camera, spans in theirs.items():
            ours.setdefault(camera, []).extend(spans)
        self._parent[b] = a
        self._seen[b] = {}

    def numbers(self) -> IntArray:
        """Of each tracklet that of its set, from 0 on."""
        roots = [self._root(one) for one in range(len(self._parent))]
        return np.asarray(np.unique(roots, return_inverse=True)[1], dtype=np.int64)
