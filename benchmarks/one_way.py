"""Whether clocks from traffic that goes in few directions state how wrong they are, where cameras disagree.

    python -m benchmarks.one_way --draws 16

Samples of road users in two cameras are made without pictures: the cameras disagree about places by a shift that is the
same everywhere, by one that depends on the axis along which a vehicle stands, and by a smooth field; each vehicle and
each box errs beside that.
"""

from __future__ import annotations

import argparse

import numpy as np

from wibam_core.sync.biases import Samples, joined, solve

#: Name -> directions in which vehicles drive, rad.
STREETS = {
    "one way": [0.0],
    "both ways": [0.0, np.pi],
    "two one-way streets": [0.0, np.pi / 2],
    "crossing": [0.0, np.pi / 2, np.pi, 1.5 * np.pi],
}
_MIDDLE_S, _OFFSET_SD_S = 150.0, 0.3


def made(rng: np.random.Generator, headings: list[float], shift_m: float, vehicles: int) -> tuple[Samples, float]:
    """Samples of vehicles that drive at 8 to 13 m/s, and by how much the first clock is wrong, s."""
    offset_s = float(rng.normal(0.0, _OFFSET_SD_S))
    shift, by_axis = shift_m * rng.standard_normal(2), 0.5 * shift_m * rng.standard_normal((2, 2))
    phases = rng.uniform(0, 2 * np.pi, 4)
    parts = []
    for number in range(vehicles):
        heading = headings[rng.integers(len(headings))] + rng.normal(0, 0.03)
        ahead, speed = np.array([np.cos(heading), np.sin(heading)]), rng.uniform(8, 13)
        at_s = rng.uniform(0, 2 * _MIDDLE_S) + np.arange(0, 5, 0.2)
        aside = rng.normal(0, 3) * np.array([ahead[1], -ahead[0]])
        point = (speed * (at_s - at_s.mean()))[:, None] * ahead + aside
        x, y = point.T
        field = np.column_stack([np.sin(y / 20 + phases[0]), np.cos(x / 25 + phases[1])])
        field += np.column_stack([np.sin(x / 20 + phases[2]), np.cos(y / 25 + phases[3])])
        bias = shift + by_axis @ [np.cos(2 * heading), np.sin(2 * heading)] + 0.1 * field
        wrong = bias + 0.15 * rng.standard_normal(2) + 0.15 * rng.standard_normal(point.shape)
        velocity = np.broadcast_to(speed * ahead, point.shape)
        apart = wrong - velocity * offset_s
        parts.append(Samples(np.full(len(at_s), number), at_s, point, velocity, apart, np.ones(len(at_s))))
    return joined(parts), offset_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=16)
    parser.add_argument("--vehicles", type=int, default=30)
    parser.add_argument("--shifts-m", type=float, nargs="+", default=[0.0, 0.4])
    arguments = parser.parse_args()
    print("| traffic | shift m | error ms, rms | stated ms, median | within 2 sd |\n|---|---|---|---|---|")
    for name, headings in STREETS.items():
        for shift_m in arguments.shifts_m:
            errors, stated = [], []
            for seed in range(arguments.draws):
                samples, offset_s = made(np.random.default_rng(seed), headings, shift_m, arguments.vehicles)
                solution, covariance = solve(samples, _MIDDLE_S, 0.0)
                errors.append(solution[0] - offset_s)
                stated.append(np.sqrt(covariance[0, 0]))
            within = int((np.abs(errors) < 2 * np.array(stated)).sum())
            rms_ms, median_ms = 1e3 * np.sqrt(np.square(errors).mean()), 1e3 * np.median(stated)
            row = f"| {name} | {shift_m:g} | {rms_ms:.0f} | {median_ms:.0f} | {within} of {arguments.draws} |"
            print(row, flush=True)


if __name__ == "__main__":
    main()
