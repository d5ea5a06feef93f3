"""Clocks from made sounds of streets: how often they are clear, and how far off.

python -m benchmarks.sound [--streets 40]
"""

from __future__ import annotations

import argparse

import numpy as np

from tests.sounds import MICROPHONES_M, RATE_HZ, of_camera, street, wind
from wibam_core.sync.hearing import SoundAlignment, align_by_sound
from wibam_core.video.sound import Sound, sound_of_samples

_DISTANCE_M = float(np.hypot(*(MICROPHONES_M[0] - MICROPHONES_M[1])))
_WRONG_S = 0.2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--streets", type=int, default=40)
    parser.add_argument("--seed", type=int, default=900)
    options = parser.parse_args()
    print("| | streets | clear | clear and more than 0.2 s off | off, s: median, max |")
    print("|---|---|---|---|---|")
    seeds = range(options.seed, options.seed + options.streets)
    for seconds, every_s in ((60, 4.0), (120, 4.0), (120, 10.0)):
        off = [error for seed in seeds if (error := _one_street(seed, seconds, every_s)) is not None]
        wrong = sum(error > _WRONG_S for error in off)
        told = f"{np.median(off):.2f}, {max(off):.2f}" if off else "–"
        print(f"| {seconds} s, a sudden sound every {every_s:g} s | {len(seeds)} | {len(off)} | {wrong} | {told} |")
    clear = sum(_other_streets(seed) for seed in seeds)
    print(f"| two other streets, 120 s, every 2 to 30 s | {len(seeds)} | {clear} | {clear} | – |")
    clear = sum(_wind(seed) for seed in seeds)
    print(f"| wind alone, 120 s | {len(seeds)} | {clear} | {clear} | – |")


def _one_street(seed: int, seconds: float, every_s: float) -> float | None:
    """How far off the clear answer is, s; None where there is none."""
    rng = np.random.default_rng(seed)
    later_s, drift = rng.uniform(0, 60), rng.uniform(-1e-4, 1e-4)
    first, second = street(rng, seconds + 61.0, every_s=every_s)
    found = _aligned(of_camera(first, 0.0, seconds), of_camera(second, later_s, seconds, drift))
    if found is None or not found.is_clear:
        return None
    return abs(found.first_s - later_s - found.second_s / (1 + drift))


def _other_streets(seed: int) -> bool:
    rng = np.random.default_rng(seed)
    every_s = float(rng.choice([2.0, 5.0, 10.0, 30.0]))
    found = _aligned(*(street(rng, 120.0, every_s=every_s, places_m=MICROPHONES_M[:1])[0] for _ in range(2)))
    return found is not None and found.is_clear


def _wind(seed: int) -> bool:
    rng = np.random.default_rng(seed)
    found = _aligned(wind(rng, 120.0), wind(rng, 120.0))
    return found is not None and found.is_clear


def _aligned(first: np.ndarray, second: np.ndarray) -> SoundAlignment | None:
    return align_by_sound("a", _heard(first), "b", _heard(second), _DISTANCE_M)


def _heard(samples: np.ndarray) -> Sound:
    return sound_of_samples(samples, RATE_HZ).within(0.0, len(samples) / RATE_HZ)


if __name__ == "__main__":
    main()
