"""The process that runs SUMO: ``python sumo_process.py NETWORK DEMAND STEPS STEP_S SEED OUTPUT``.

libsumo keeps its one simulation in global variables and ends the whole process on some errors, so it never shares a
process with anything else. Nothing but libsumo and NumPy is imported here.

OUTPUT is an ``.npz`` with one row per vehicle and step: ``step`` (1 is the state after the first step),
``vehicle_id``, ``lane`` (a number in ``lanes``), ``front_m`` (of the vehicle's front along that lane), ``speed_mps``.
"""

from __future__ import annotations

import sys

import libsumo
import numpy as np
from libsumo import constants


def main(network: str, demand: str, steps: int, step_s: float, seed: int, output: str) -> None:
    """Simulate and write every vehicle's state after every step."""
    libsumo.start(
        [
            "sumo",
            *("--net-file", network),
            *("--route-files", demand),
            *("--step-length", str(step_s)),
            *("--seed", str(seed)),
            *("--time-to-teleport", "-1"),
            *("--max-depart-delay", "20"),
            *("--collision.action", "none"),
            *("--xml-validation", "never"),
            *("--xml-validation.net", "never"),
            *("--xml-validation.routes", "never"),
            *("--no-step-log", "true"),
            *("--no-warnings", "true"),
        ]
    )
    wanted = [constants.VAR_LANE_ID, constants.VAR_LANEPOSITION, constants.VAR_SPEED]
    lanes: dict[str, int] = {}
    rows: list[tuple[int, int, int]] = []
    values: list[tuple[float, float]] = []
    for step in range(1, steps + 1):
        libsumo.simulationStep()
        for vehicle in libsumo.simulation.getDepartedIDList():
            libsumo.vehicle.subscribe(vehicle, wanted)
        for vehicle, state in libsumo.vehicle.getAllSubscriptionResults().items():
            lane = lanes.setdefault(state[constants.VAR_LANE_ID], len(lanes))
            rows.append((step, int(vehicle), lane))
            values.append((state[constants.VAR_LANEPOSITION], state[constants.VAR_SPEED]))
    libsumo.close()
    numbers = np.array(rows, np.int64).reshape(-1, 3)
    measures = np.array(values, np.float64).reshape(-1, 2)
    np.savez(
        output,
        lanes=np.array(list(lanes), dtype=np.str_),
        step=numbers[:, 0],
        vehicle_id=numbers[:, 1],
        lane=numbers[:, 2],
        front_m=measures[:, 0],
        speed_mps=measures[:, 1],
    )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5]), sys.argv[6])
