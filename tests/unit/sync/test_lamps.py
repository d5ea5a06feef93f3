import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.sync.lamps import AMBER, BINS, GREEN, RED, colour_profile, learn_lamps

BGR = {RED: (20, 20, 250), AMBER: (20, 150, 250), GREEN: (170, 230, 20)}


def crop(colour, third, shape=(30, 10), horizontal=False):
    image = np.full((*shape, 3), 40, np.uint8)
    image[third * 10 : third * 10 + 10, 2:8] = BGR[colour]
    return np.ascontiguousarray(image.transpose(1, 0, 2)) if horizontal else image


@pytest.mark.parametrize("horizontal", [False, True])
@pytest.mark.parametrize("colour", [RED, AMBER, GREEN])
@pytest.mark.parametrize("third", [0, 1, 2])
def test_profile_holds_colour_and_place(colour, third, horizontal):
    profile = colour_profile(crop(colour, third, horizontal=horizontal))
    assert profile.shape == (3, BINS)
    assert profile.argmax() // BINS == colour
    share = profile[colour].reshape(3, BINS // 3).sum(axis=1) / profile.sum()
    assert share[third] > 0.99


@given(scale=st.integers(1, 6))
def test_profile_does_not_depend_on_size(scale):
    image = crop(RED, 1)
    larger = np.kron(image, np.ones((scale, scale, 1), np.uint8))
    np.testing.assert_allclose(colour_profile(larger), colour_profile(image), atol=1e-6)


def test_grey_is_no_lamp():
    assert colour_profile(np.full((30, 10, 3), 255, np.uint8)).max() == 0


def learned(order):
    """Lamps of a head whose red, amber, green sit in the thirds of ``order``."""
    shown = [c for c in (RED, AMBER, GREEN) for _ in range((40, 12, 30)[c])]
    profiles = np.array([colour_profile(crop(c, order[c])) for c in shown])
    return learn_lamps(profiles), profiles, np.array(shown)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 1, 1)])
def test_every_lamp_is_found_wherever_it_sits(order):
    lamps, profiles, shown = learned(order)
    assert lamps.seen == (True, True, True)
    lit, trust = lamps.unmix(profiles)
    assert (lit.argmax(axis=1) == shown).all()
    assert trust.min() > 0.9


def test_something_large_and_red_is_not_trusted():
    lamps, _, _ = learned((0, 1, 2))
    truck = np.full((30, 10, 3), (20, 20, 200), np.uint8)
    _, trust = lamps.unmix(colour_profile(truck)[None])
    assert trust[0] < 0.2


def test_nothing_in_view_gives_no_lamps():
    lamps = learn_lamps(np.zeros((20, 3, BINS)))
    assert lamps.seen == (False, False, False)
    lit, trust = lamps.unmix(np.ones((4, 3, BINS)))
    assert lit.max() == trust.max() == 0
