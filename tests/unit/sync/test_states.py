import numpy as np
import pytest

from wibam_core.sync.states import STATES, most_likely_states, state_evidence, switch_costs

ALL = (True, True, True)


def states_of(sequence, fps=10.0, seen=ALL, strength=0.8):
    """Path for frames that each clearly show a state, or None for nothing."""
    evidence = np.array([[strength * (name == s) for s in STATES] for name in sequence])
    times_ns = (np.arange(len(sequence)) * 1e9 / fps).astype(np.int64)
    return [STATES[k] for k in most_likely_states(times_ns, evidence, switch_costs(seen))]


def test_lit_lamps_give_their_state_and_impossible_pairs_none():
    lit = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 0, 0]], dtype=float)
    evidence = state_evidence(lit, np.ones(6))
    assert [STATES[k] for k in evidence[:4].argmax(axis=1)] == ["red", "amber", "green", "red_amber"]
    assert evidence[4:].max() == 0
    assert state_evidence(lit, np.zeros(6)).max() == 0


def test_frames_that_show_nothing_keep_the_state():
    sequence = ["red"] * 20 + [None] * 30 + ["red"] * 20
    assert states_of(sequence) == ["red"] * 70


@pytest.mark.parametrize("fps", [6.0, 12.5, 50.0])
def test_a_short_wrong_look_makes_no_change_at_any_frame_rate(fps):
    n = round(fps)
    sequence = ["green"] * 10 * n + ["red"] * 2 * n + ["green"] * 10 * n
    assert set(states_of(sequence, fps)) == {"green"}


@pytest.mark.parametrize("fps", [6.0, 12.5, 50.0])
def test_a_real_cycle_is_followed_at_any_frame_rate(fps):
    n = round(fps)
    sequence = ["green"] * 8 * n + ["amber"] * 3 * n + ["red"] * 8 * n + ["red_amber"] * n + ["green"] * 8 * n
    assert states_of(sequence, fps) == sequence


def test_a_lamp_never_seen_is_no_state():
    costs = switch_costs((True, False, True))
    red, amber, green = (STATES.index(s) for s in ("red", "amber", "green"))
    assert np.isinf(costs[red, amber])
    assert costs[green, red] == costs[red, green] < 5
    assert switch_costs(ALL)[green, red] > costs[green, red]
    assert most_likely_states(np.zeros(0, np.int64), np.zeros((0, 4)), costs).shape == (0,)
