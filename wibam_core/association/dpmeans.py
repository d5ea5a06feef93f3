"""DP-means (Kulis & Jordan, "Revisiting k-means: new algorithms via Bayesian nonparametrics", ICML 2012), with one
constraint more: a cluster holds at most one point per group, since one camera sees a vehicle once."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from wibam_core.scene import FloatArray, IntArray

_MAX_SWEEPS = 12


def constrained_dp_means(points: FloatArray, groups: IntArray, spreads: FloatArray, radius_m: float) -> IntArray:
    """Cluster points so that sum of squared distances + ``radius_m``² per cluster is small.

    One group at a time is taken out and assigned anew, all its points at once, to the clusters that the other
    groups form or to new ones, by the cheapest assignment; until nothing changes. The outcome depends on the
    order of the points alone.

    Args:
        points: (N, 2), m.
        groups: (N,) camera number of each point.
        spreads: (N, 2, 2) covariance of each point relative to that of a usual one, which is the identity. A point
            counts in its cluster's mean by the inverse; the distance of a point and a cluster is measured in the mean
            of their spreads, so that between usual points it is in metres.
        radius_m: a usual point that is farther than this from every cluster opens a new one.

    Returns:
        (N,) cluster numbers 0..K−1, in the order of first appearance.
    """
    labels = np.full(len(points), -1, dtype=np.int64)
    if len(points) == 0:
        return labels
    members = [np.flatnonzero(groups == g) for g in np.unique(groups)]
    information = np.linalg.inv(spreads)
    pulls = np.einsum("nij,nj->ni", information, points)
    columns = np.column_stack([information.reshape(-1, 4), pulls])
    for _ in range(_MAX_SWEEPS):
        before = labels.copy()
        for own in members:
            labels[own] = -1
            labels[own] = _assign(points[own], spreads[own], *_clusters(columns, labels), radius_m)
        if np.array_equal(_canonical(before), _canonical(labels)):
            break
    return _canonical(labels)


def _clusters(columns: FloatArray, labels: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Means (K, 2) and mean spreads (K, 2, 2) of the clusters that have members, and their labels (K,)."""
    placed = np.flatnonzero(labels >= 0)
    names, inverse, counts = np.unique(labels[placed], return_inverse=True, return_counts=True)
    sums = np.zeros((len(names), 6))
    np.add.at(sums, inverse, columns[placed])
    own = np.asarray(np.linalg.inv(sums[:, :4].reshape(-1, 2, 2)), dtype=np.float64)
    means = np.asarray(np.einsum("kij,kj->ki", own, sums[:, 4:]))
    return means, own * counts[:, None, None], np.asarray(names, dtype=np.int64)


def _assign(
    points: FloatArray,
    spreads: FloatArray,
    means: FloatArray,
    mean_spreads: FloatArray,
    names: IntArray,
    radius_m: float,
) -> IntArray:
    """Labels of points (n, 2): each an existing cluster (at most one point each) or a new number."""
    n, k = len(points), len(means)
    penalty = radius_m**2
    cost = np.full((n, k + n), penalty)
    if k:
        apart = points[:, None] - means[None]
        between = np.linalg.inv(0.5 * (spreads[:, None] + mean_spreads[None]))
        squared = np.einsum("nki,nkij,nkj->nk", apart, between, apart)
        cost[:, :k] = np.where(squared <= penalty, squared, 4 * (n + 1) * penalty)
    rows, columns = linear_sum_assignment(cost)
    fresh = int(names.max(initial=-1)) + 1 + np.arange(n)
    labels = np.empty(n, dtype=np.int64)
    labels[rows] = np.concatenate([names, fresh])[columns]
    return labels


def _canonical(labels: IntArray) -> IntArray:
    """The same partition with labels 0, 1, ... in the order of first appearance."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return np.asarray(rank[inverse], dtype=np.int64)
