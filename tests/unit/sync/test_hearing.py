import numpy as np
import pytest

from tests.sounds import MICROPHONES_M, RATE_HZ, music, of_camera, street, wind
from wibam_core.sync.hearing import align_by_sound
from wibam_core.video.sound import STEP_S, Sound, sound_of_samples

DISTANCE_M = float(np.hypot(*(MICROPHONES_M[0] - MICROPHONES_M[1])))
WAY_S = DISTANCE_M / 343.0
SECONDS, LATER_S = 120.0, 31.7


def sound_of(samples):
    return sound_of_samples(samples, RATE_HZ)


def two_cameras(seed, drift=0.0, loudness=1.0, **options):
    """The second camera was started `LATER_S` after the first."""
    first, second = street(np.random.default_rng(seed), SECONDS + LATER_S, **options)
    heard = of_camera(first, 0.0, SECONDS), of_camera(second, LATER_S, SECONDS, drift)
    return tuple(sound_of(np.clip(loudness * samples, -1, 1)) for samples in heard)


def aligned(first, second):
    return align_by_sound("a", first, "b", second, DISTANCE_M)


def test_two_recordings_of_one_street_are_put_beside_each_other_within_the_way_of_sound():
    """Not every two minutes hold enough that is sudden; what is called clear is right."""
    clear = [found for seed in range(6) if (found := aligned(*two_cameras(seed))).is_clear]
    assert len(clear) >= 4
    for found in clear:
        assert found.offset_s == pytest.approx(LATER_S, abs=WAY_S + STEP_S)
        assert found.sd_s == pytest.approx(np.hypot(WAY_S / 3**0.5, 0.05 * 2**0.5))


def test_clocks_that_drift_are_followed():
    first, second = street(np.random.default_rng(5), 330.0)
    found = aligned(sound_of(of_camera(first, 0.0, 300.0)), sound_of(of_camera(second, 20.0, 300.0, 2e-4)))
    assert found.is_clear
    assert found.first_s == pytest.approx(20.0 + found.second_s / (1 + 2e-4), abs=WAY_S + STEP_S)
    assert found.drift == pytest.approx(-2e-4, abs=2e-4)


def test_sound_that_is_clipped_is_compared_too():
    found = aligned(*two_cameras(3, loudness=60.0))
    assert found.is_clear and found.offset_s == pytest.approx(LATER_S, abs=WAY_S + STEP_S)


@pytest.mark.parametrize("every_s", [2.0, 8.0, 30.0])
@pytest.mark.parametrize("seed", range(3))
def test_two_streets_are_not_one(seed, every_s):
    first = street(np.random.default_rng(seed), SECONDS, every_s=every_s, places_m=MICROPHONES_M[:1])[0]
    second = street(np.random.default_rng(seed + 100), SECONDS, every_s=every_s, places_m=MICROPHONES_M[:1])[0]
    assert not aligned(sound_of(first), sound_of(second)).is_clear


@pytest.mark.parametrize("seed", range(3))
def test_wind_alone_says_nothing(seed):
    rng = np.random.default_rng(seed)
    assert not aligned(sound_of(wind(rng, SECONDS)), sound_of(wind(rng, SECONDS))).is_clear


def test_an_even_beat_says_nothing():
    samples = music(np.random.default_rng(0), SECONDS + LATER_S)
    found = aligned(sound_of(of_camera(samples, 0.0, SECONDS)), sound_of(of_camera(samples, LATER_S, SECONDS)))
    assert found.contrast == pytest.approx(1.0, abs=0.1) and not found.is_clear


def test_one_loud_bang_that_two_recordings_happen_to_hold_says_nothing():
    rng = np.random.default_rng(0)
    recordings = []
    for at_s in (20.0, 70.0):
        samples = rng.normal(size=round(SECONDS * RATE_HZ)) * 0.003
        at = round(at_s * RATE_HZ)
        samples[at : at + 3000] += 0.5 * rng.normal(size=3000)
        recordings.append(sound_of(samples))
    assert not aligned(*recordings).is_clear


def test_silence_and_short_recordings_cannot_be_compared():
    heard, _ = two_cameras(0)
    silent = Sound(0.0, np.zeros_like(heard.power))
    assert aligned(heard, silent) is None and aligned(silent, heard) is None
    assert aligned(heard, Sound(0.0, heard.power[:400])) is None
    assert aligned(Sound(0.0, heard.power[:0]), heard) is None


def test_a_recording_that_has_sound_only_in_part_is_compared_in_that():
    first, second = two_cameras(1)
    power = second.power.copy()
    power[: len(power) // 3] = np.nan
    found = aligned(first, Sound(second.first_s, power))
    assert found.is_clear and found.offset_s == pytest.approx(LATER_S, abs=WAY_S + STEP_S)
