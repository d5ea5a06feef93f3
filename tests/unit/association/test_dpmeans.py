from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.association.dpmeans import constrained_dp_means


def usual(count: int) -> np.ndarray:
    return np.tile(np.eye(2), (count, 1, 1))


def in_one_scene(points: np.ndarray, groups: np.ndarray, spreads: np.ndarray, radius_m: float) -> np.ndarray:
    return constrained_dp_means(points, groups, spreads, np.zeros(len(points), np.int64), radius_m)


def cluster(points: list[list[float]], groups: list[int], radius_m: float = 3.5) -> np.ndarray:
    return in_one_scene(np.array(points, float).reshape(-1, 2), np.array(groups), usual(len(points)), radius_m)


def test_two_cameras_that_see_two_vehicles() -> None:
    assert cluster([[0, 0], [10, 0], [10.5, 1], [0.3, 0.2]], [0, 0, 1, 1]).tolist() == [0, 1, 1, 0]


def test_one_camera_never_gives_two_boxes_to_one_vehicle() -> None:
    labels = cluster([[0, 0], [1, 0], [0.5, 0]], [0, 0, 1])
    assert labels[0] != labels[1]
    assert labels[2] in labels[:2]


def test_a_row_of_vehicles_is_assigned_as_a_whole() -> None:
    # camera 1 sees the queue 2 m too far: each point alone would be nearly as near to the next vehicle
    queue = [[0.0, 5.5 * k] for k in range(4)]
    shifted = [[0.0, 5.5 * k + 2.6] for k in range(4)]
    assert cluster(queue + shifted, [0] * 4 + [1] * 4).tolist() == [0, 1, 2, 3, 0, 1, 2, 3]


def test_a_wide_point_reaches_farther() -> None:
    points, groups = np.array([[0.0, 0.0], [5.0, 0.0]]), np.array([0, 1])
    assert len(set(in_one_scene(points, groups, usual(2), 3.5))) == 2
    assert len(set(in_one_scene(points, groups, usual(2) * np.array([1.0, 4.0])[:, None, None], 3.5))) == 1


def test_a_flat_ray_reaches_farther_along_itself_alone() -> None:
    flat = np.array([np.eye(2), np.diag([9.0, 1.0])])
    groups = np.array([0, 1])
    assert len(set(in_one_scene(np.array([[0.0, 0.0], [6.0, 0.0]]), groups, flat, 3.5))) == 1
    assert len(set(in_one_scene(np.array([[0.0, 0.0], [0.0, 6.0]]), groups, flat, 3.5))) == 2


def test_a_sure_point_draws_the_mean_to_itself() -> None:
    """The mean of the first two lies at 2.7 m rather than half way, so that the third is within reach of it."""
    points, groups = np.array([[0.0, 0.0], [3.0, 0.0], [6.0, 0.0]]), np.arange(3)
    wide_and_two_sure = usual(3) * np.array([9.0, 1.0, 1.0])[:, None, None]
    assert in_one_scene(points, groups, wide_and_two_sure, 3.5).tolist() == [0, 0, 0]
    assert len(set(in_one_scene(points, groups, usual(3), 3.5))) == 2


def test_nothing_gives_nothing() -> None:
    assert cluster([], []).tolist() == []


@given(
    st.lists(
        st.tuples(st.floats(-40, 40, allow_nan=False), st.floats(-40, 40, allow_nan=False), st.integers(0, 3)),
        max_size=24,
    )
)
def test_laws(rows: list[tuple[float, float, int]]) -> None:
    points = np.array([[x, y] for x, y, _ in rows]).reshape(-1, 2)
    groups = np.array([g for *_, g in rows], dtype=np.int64)
    labels = in_one_scene(points, groups, usual(len(rows)), 3.5)
    assert np.array_equal(labels, in_one_scene(points, groups, usual(len(rows)), 3.5))
    pairs = list(zip(labels.tolist(), groups.tolist(), strict=True))
    assert len(set(pairs)) == len(pairs), "at most one point of a group in a cluster"
    first_seen = [labels.tolist().index(k) for k in range(labels.max(initial=-1) + 1)]
    assert all(a < b for a, b in pairwise(first_seen)), "numbered by first appearance"
    for k in set(labels.tolist()):
        members = points[labels == k]
        if len(members) == 2:
            assert np.linalg.norm(members[0] - members[1]) <= 3.5 + 1e-9


def test_scenes_are_clustered_as_each_would_be_alone() -> None:
    rng = np.random.default_rng(0)
    scenes = np.sort(rng.integers(0, 12, 200))
    points, groups = rng.uniform(-8, 8, (200, 2)), rng.integers(0, 4, 200)
    axes = rng.normal(size=(200, 2, 2))
    spreads = np.eye(2) + axes @ axes.swapaxes(1, 2)
    together = constrained_dp_means(points, groups, spreads, scenes, 3.5)
    for scene in range(12):
        own = scenes == scene
        assert together[own].tolist() == in_one_scene(points[own], groups[own], spreads[own], 3.5).tolist()
