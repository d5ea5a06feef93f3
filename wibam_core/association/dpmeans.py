"""DP-means (Kulis & Jordan, "Revisiting k-means: new algorithms via Bayesian nonparametrics", ICML 2012), with one
constraint more: a cluster holds at most one point per group, since one camera sees a vehicle once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from wibam_core.scene import FloatArray, IntArray

_MAX_SWEEPS = 12


def constrained_dp_means(
    points: FloatArray, groups: IntArray, spreads: FloatArray, scenes: IntArray, radius_m: float
) -> IntArray:
    """Cluster the points of each scene so that sum of squared distances + ``radius_m``² per cluster is small.

    One group at a time is taken out and assigned anew, all its points at once, to the clusters that the other
    groups form or to new ones, by the cheapest assignment; until nothing changes. The outcome depends on the
    order of the points alone.

    Args:
        points: (N, 2), m.
        groups: (N,) camera number of each point.
        spreads: (N, 2, 2) covariance of each point relative to that of a usual one, which is the identity. A point
            counts in its cluster's mean by the inverse; the distance of a point and a cluster is measured in the mean
            of their spreads, so that between usual points it is in metres.
        scenes: (N,) ascending. Each scene is clustered for itself; they are only computed together.
        radius_m: a usual point that is farther than this from every cluster opens a new one.

    Returns:
        (N,) cluster numbers 0..K−1 in each scene, in the order of first appearance.
    """
    labels = np.full(len(points), -1, dtype=np.int64)
    information = _inverse(spreads)
    pulls = np.einsum("nij,nj->ni", information, points)
    columns = np.column_stack([information.reshape(-1, 4), pulls])
    left = np.arange(len(points))  # the points of scenes in which something changed
    for _ in range(_MAX_SWEEPS):
        if not len(left):
            break
        now, of = labels[left], scenes[left]
        before = _canonical(now, of)
        for group in np.unique(groups[left]):
            own = groups[left] == group
            now[own] = -1
            clusters = _clusters(columns[left], now, of)
            now[own] = _assigned(points[left[own]], spreads[left[own]], of[own], clusters, radius_m)
        labels[left] = now
        changed = before != _canonical(now, of)
        left = left[np.isin(of, of[changed])]
    return _canonical(labels, scenes)


@dataclass(frozen=True, eq=False)
class _Clusters:
    """Clusters that have members: means (K, 2), mean spreads (K, 2, 2), scenes (K,) ascending, labels (K,) in those."""

    means: FloatArray
    spreads: FloatArray
    scenes: IntArray
    labels: IntArray


def _clusters(columns: FloatArray, labels: IntArray, scenes: IntArray) -> _Clusters:
    placed = np.flatnonzero(labels >= 0)
    most = int(labels.max(initial=0)) + 1
    names, inverse, counts = np.unique(scenes[placed] * most + labels[placed], return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(inverse, column, minlength=len(names)) for column in columns[placed].T], axis=1)
    own = _inverse(sums[:, :4].reshape(-1, 2, 2).astype(np.float64))
    means = np.asarray(np.einsum("kij,kj->ki", own, sums[:, 4:]))
    return _Clusters(means, own * counts[:, None, None], names // most, names % most)


def _assigned(
    points: FloatArray, spreads: FloatArray, scenes: IntArray, clusters: _Clusters, radius_m: float
) -> IntArray:
    """Labels of points (n, 2) of one group: each an existing cluster (at most one point each) or a new number."""
    penalty = radius_m**2
    first_cluster = np.searchsorted(clusters.scenes, scenes)
    counts = np.searchsorted(clusters.scenes, scenes, side="right") - first_cluster
    first_pair = np.cumsum(counts) - counts
    point = np.repeat(np.arange(len(points)), counts)
    cluster = np.arange(len(point)) + (first_cluster - first_pair)[point]
    apart = points[point] - clusters.means[cluster]
    between = 0.5 * (spreads[point] + clusters.spreads[cluster])
    squared = np.einsum("pi,pij,pj->p", apart, _inverse(between), apart)

    fresh = int(clusters.labels.max(initial=-1)) + 1
    labels = np.empty(len(points), dtype=np.int64)
    begin = np.flatnonzero(np.diff(scenes, prepend=-1))
    end = np.append(begin[1:], len(points))
    for a, b, k, pair, name in zip(
        begin.tolist(),
        end.tolist(),
        counts[begin].tolist(),
        first_pair[begin].tolist(),
        first_cluster[begin].tolist(),
        strict=True,
    ):
        n = b - a
        cost = np.full((n, k + n), penalty)
        own = squared[pair : pair + n * k].reshape(n, k)
        cost[:, :k] = np.where(own <= penalty, own, 4 * (n + 1) * penalty)
        chosen = linear_sum_assignment(cost)[1]
        labels[a:b] = np.concatenate([clusters.labels[name : name + k], fresh + np.arange(n)])[chosen]
    return labels


def _inverse(matrices: FloatArray) -> FloatArray:
    """Of symmetric matrices (N, 2, 2)."""
    a, b, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    adjugate = np.stack([d, -b, -b, a], axis=-1).reshape(-1, 2, 2)
    return np.asarray(adjugate / (a * d - b * b)[:, None, None])


def _canonical(labels: IntArray, scenes: IntArray) -> IntArray:
    """The same partition of each scene with labels 0, 1, ... in the order of first appearance."""
    names = scenes * (int(labels.max(initial=0)) + 2) + labels
    _, first, inverse = np.unique(names, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))[inverse]
    begin = np.searchsorted(scenes, scenes)
    return np.asarray(rank - rank[begin], dtype=np.int64)
