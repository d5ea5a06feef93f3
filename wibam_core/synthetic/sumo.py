"""Traffic from SUMO (https://eclipse.dev/sumo) instead of `synthetic.traffic`: the extra ``wibam[sumo]``.

SUMO gives the motion along the lanes: following, stopping at signals, yielding, gaps that drivers accept. Where a
vehicle is follows from the distance it has gone along its `Route`, exactly as with our own traffic: SUMO's lanes have
the routes' shapes and lengths, but SUMO would turn a vehicle as if it hung by its front bumper. So both kinds of
traffic drive on the lanes that are drawn, in the same way, and `Traffic` does not know which of them it is.

SUMO knows vehicles as points on lanes. Should a long one swing into another's way all the same, the later of the two is
left out of the traffic, so that boxes never overlap.

SUMO runs in a process of its own, see `synthetic.sumo_process`.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.errors import MissingSumo, SumoFailed
from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.driving import STEP_S
from wibam_core.synthetic.layout import Layout
from wibam_core.synthetic.routes import Route
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.sumo_network import Departure, Junction, demand, make_junction, network, to_bytes
from wibam_core.synthetic.traffic import ARRIVALS_PER_S, SHARES, WARM_UP_S, Traffic, simulate_traffic
from wibam_core.synthetic.trajectories import Trajectory, without_overlaps
from wibam_core.synthetic.vehicles import sample_vehicle

Array = NDArray[np.float64]

_HEAVY_SHARES = {"straight": 0.52, "right": 1e-6, "left": 0.03}  # long vehicles avoid tight turns


def simulate_sumo_traffic(
    layout: Layout,
    seed: int,
    duration_s: float,
    program: SignalProgram,
    density: float = 1.0,
    parked: int = 2,
    speed_mps: float = 12.5,
) -> Traffic:
    """Traffic on an intersection from time 0 to ``duration_s``, after a warm-up; see `traffic.simulate_traffic`.

    Raises:
        MissingSumo: the extra is not installed.
        SumoFailed: SUMO did not run to the end.
    """
    if importlib.util.find_spec("libsumo") is None:
        raise MissingSumo("Traffic from SUMO needs the package libsumo, which is not installed.")
    junction = make_junction(layout)
    first_step, last_step = -round(WARM_UP_S / STEP_S), round(duration_s / STEP_S) + 1
    departures = draw_departures(junction.routes, np.random.default_rng([seed, 61]), WARM_UP_S + duration_s, density)
    net = to_bytes(network(junction, program, first_step, last_step, speed_mps))
    states = _run(net, to_bytes(demand(junction.routes, departures)), last_step - first_step, seed % 2**31)
    moving = without_overlaps(_trajectories(junction, departures, states, first_step))
    standing = simulate_traffic(layout, seed, 0.0, program, density=0.0, parked=parked).trajectories
    standing = tuple(replace(t, vehicle_id=len(departures) + 1 + i) for i, t in enumerate(standing))
    return Traffic(layout, program, (*moving, *standing), duration_s)


def draw_departures(
    routes: Sequence[Route], rng: np.random.Generator, duration_s: float, density: float
) -> list[Departure]:
    """Who comes, when, whence and where to: a Poisson process on every incoming lane, sorted by time."""
    lanes: dict[tuple[int, int], list[int]] = {}
    for i, route in enumerate(routes):
        lanes.setdefault((route.incoming.number, route.lane), []).append(i)
    arrivals = []
    for lane in lanes:
        count = int(rng.poisson(density * ARRIVALS_PER_S * duration_s))
        arrivals += [(time_s, lane) for time_s in rng.uniform(0.0, duration_s, count).tolist()]
    return [_draw(routes, lanes[lane], rng, i + 1, time_s) for i, (time_s, lane) in enumerate(sorted(arrivals))]


def _draw(
    routes: Sequence[Route], choices: Sequence[int], rng: np.random.Generator, vehicle_id: int, time_s: float
) -> Departure:
    model = sample_vehicle(rng)
    heavy = model.vehicle_class in (RoadUserClass.BUS, RoadUserClass.TRUCK)
    shares = np.array([(_HEAVY_SHARES if heavy else SHARES)[routes[i].movement] for i in choices])
    return Departure(
        vehicle_id=vehicle_id,
        model=model,
        route=int(choices[rng.choice(len(choices), p=shares / shares.sum())]),
        time_s=time_s,
        speed_factor=float(np.clip(rng.normal(1.0, 0.12), 0.75, 1.3)) * (0.85 if heavy else 1.0),
        headway_s=float(rng.uniform(0.9, 1.6)),
        margin_s=float(rng.uniform(0.3, 1.6)) + (0.6 if heavy else 0.0),
    )


def _run(net: bytes, routes: bytes, steps: int, seed: int) -> Mapping[str, NDArray]:
    """Rows as `synthetic.sumo_process` writes them."""
    with tempfile.TemporaryDirectory(prefix="wibam-sumo-") as name:
        folder = Path(name)
        (folder / "net.xml").write_bytes(net)
        (folder / "routes.xml").write_bytes(routes)
        program = [sys.executable, "-P", str(Path(__file__).with_name("sumo_process.py"))]
        options = ["net.xml", "routes.xml", str(steps), str(STEP_S), str(seed), "states.npz"]
        done = subprocess.run([*program, *options], cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0 or not (folder / "states.npz").exists():
            words = (done.stdout + done.stderr).strip().splitlines()[-8:]
            raise SumoFailed(f"SUMO ended with status {done.returncode}.", output="\n".join(words))
        with np.load(folder / "states.npz", allow_pickle=False) as file:
            return {key: file[key] for key in file.files}


def _trajectories(
    junction: Junction, departures: Sequence[Departure], states: Mapping[str, NDArray], first_step: int
) -> list[Trajectory]:
    lanes: list[str] = states["lanes"].tolist()
    order = np.lexsort((states["step"], states["vehicle_id"]))
    ids = states["vehicle_id"][order]
    found = []
    for departure in departures:
        rows = order[np.searchsorted(ids, departure.vehicle_id) : np.searchsorted(ids, departure.vehicle_id, "right")]
        route, length_m = junction.routes[departure.route], departure.model.length_m
        starts = junction.lane_starts_m(departure.route)
        begin = np.array([starts.get(lane, np.nan) for lane in lanes])
        s_m = begin[states["lane"][rows]] + states["front_m"][rows] - length_m / 2
        step = states["step"][rows] + first_step
        kept = (step >= 0) & (s_m - length_m / 2 <= route.length_m)
        if kept.sum() < 2:
            continue
        speed = states["speed_mps"][rows][kept]
        found.append(Trajectory(departure.vehicle_id, departure.model, route, int(step[kept][0]), s_m[kept], speed))
    return found
