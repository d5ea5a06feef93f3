from __future__ import annotations

import numpy as np

from wibam_core.association.linking import Sightings, link

PERIOD_NS = 80_000_000


def seen(step: int, positions: list[tuple[float, float]], classes: list[int] | None = None) -> Sightings:
    n = len(positions)
    return Sightings(
        np.full(n, step * PERIOD_NS),
        np.array(positions, float).reshape(-1, 2),
        np.full(n, 0.5),
        np.array(classes or [0] * n, dtype=np.int64),
    )


def test_vehicles_that_pass_each_other_keep_their_ids() -> None:
    rng = np.random.default_rng(0)
    instants = []
    for k in range(60):
        x = -20 + 10 * k * 0.08
        noise = rng.normal(0, 0.3, (2, 2))
        instants.append(seen(k, [(x + noise[0, 0], -1.75 + noise[0, 1]), (-x + noise[1, 0], 1.75 + noise[1, 1])]))
    links = np.array(link(instants, 30.0))
    assert (links == [0, 1]).all()


def test_a_gap_is_bridged_at_the_vehicle_s_speed() -> None:
    instants = [seen(k, [(12.0 * 0.08 * k, 0.0)] if not 20 <= k < 30 else []) for k in range(50)]
    assert {int(i) for ids in link(instants, 30.0) for i in ids} == {0}


def test_a_long_gap_ends_a_track() -> None:
    instants = [seen(k, [(0.0, 0.0)] if not 20 <= k < 40 else []) for k in range(60)]
    assert {int(i) for ids in link(instants, 30.0, max_gap_s=1.0) for i in ids} == {0, 1}


def test_what_is_seen_once_has_no_track() -> None:
    instants = [seen(k, [(0.0, 0.0), (30.0, 30.0)] if k == 5 else [(0.0, 0.0)]) for k in range(10)]
    links = link(instants, 30.0)
    assert links[5].tolist() == [0, -1]


def test_no_link_needs_a_vehicle_faster_than_the_limit() -> None:
    instants = [seen(0, [(0.0, 0.0)]), seen(5, [(11.0, 0.0)]), seen(10, [(22.0, 0.0)])]
    fast = {int(i) for ids in link(instants, 40.0) for i in ids}
    slow = {int(i) for ids in link(instants, 12.0) for i in ids}
    assert fast == {0}
    assert slow == {-1}


def test_instants_without_vehicles() -> None:
    assert [ids.tolist() for ids in link([seen(0, []), seen(1, [])], 30.0)] == [[], []]
    assert link([], 30.0) == []
