"""SUMO drives on our own lanes, obeys our signals, and is asked for by name when it is missing.

What needs libsumo is skipped without the extra ``wibam[sumo]``; the files that SUMO reads are always checked.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element, fromstring

import numpy as np
import pytest

from wibam_core.cli import main
from wibam_core.errors import MissingSumo
from wibam_core.formats.labels import read_labels
from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.driving import STEP_S
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import record_site
from wibam_core.synthetic.routes import Route, footprints_overlap
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.sumo import draw_departures, simulate_sumo_traffic
from wibam_core.synthetic.sumo_network import (
    Junction,
    demand,
    incoming_edge,
    make_junction,
    network,
    outgoing_edge,
    to_bytes,
)
from wibam_core.synthetic.traffic import Traffic
from wibam_core.synthetic.trajectories import Trajectory, without_overlaps
from wibam_core.synthetic.vehicles import sample_vehicle

SEEDS = (1, 2, 5)  # four arms with two lanes that merge, three arms, and four arms
PROGRAM = SignalProgram(22.0, offset_s=5.017)
SPEED_MPS = 12.5
STEPS = 1000


@lru_cache
def junction_of(seed: int) -> Junction:
    return make_junction(make_layout(seed))


def routes_of(seed: int) -> tuple[Route, ...]:
    return junction_of(seed).routes


@lru_cache
def network_of(seed: int) -> Element:
    return fromstring(to_bytes(network(junction_of(seed), PROGRAM, -STEPS // 2, STEPS // 2, SPEED_MPS)))


def lane_points(lane: Element) -> np.ndarray:
    return np.array([[float(v) for v in pair.split(",")] for pair in lane.get("shape", "").split()])


# --- without SUMO ---------------------------------------------------------------------------
def test_a_missing_extra_is_asked_for_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "libsumo", None)
    with pytest.raises(MissingSumo, match="libsumo") as caught:
        simulate_sumo_traffic(make_layout(2), 2, 1.0, PROGRAM)
    assert caught.value.code == "missing_sumo"
    assert "pip install 'wibam[sumo]'" in caught.value.hint


def test_the_command_line_says_how_to_install_the_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "libsumo", None)
    monkeypatch.setattr(
        sys, "argv", ["wibam", "simulate", str(tmp_path / "site"), "--seconds", "1", "--traffic", "sumo"]
    )
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 1
    words = " ".join(capsys.readouterr().err.split())
    assert "missing_sumo" in words
    assert "pip install 'wibam[sumo]'" in words


@pytest.mark.parametrize("seed", SEEDS)
def test_lanes_have_the_length_and_shape_of_the_routes(seed: int) -> None:
    lanes = {lane.get("id"): lane for lane in network_of(seed).iter("lane")}
    for number, route in enumerate(routes_of(seed)):
        starts = junction_of(seed).lane_starts_m(number)
        names = list(starts)
        for name, following in pairwise(names):
            assert starts[name] + float(lanes[name].get("length", "nan")) == pytest.approx(starts[following], abs=1e-3)
        last = starts[names[-1]] + float(lanes[names[-1]].get("length", "nan"))
        assert last > route.length_m + 12.4  # the longest vehicle leaves the drawn road
        for name in names:
            points, length = lane_points(lanes[name]), float(lanes[name].get("length", "nan"))
            on_route = route.position(starts[name] + np.linspace(0, length, len(points)))
            assert np.abs(points - on_route).max() < 0.05  # routes that share a lane are resampled differently


@pytest.mark.parametrize("seed", SEEDS)
def test_signals_of_the_network_are_those_of_the_program(seed: int) -> None:
    states: list[str] = []
    for phase in network_of(seed).iter("phase"):
        states += [phase.get("state", "")] * round(float(phase.get("duration", "nan")) / STEP_S)
    assert len(states) == STEPS + 1
    letters = {"green": "gG", "amber": "y", "red": "r"}
    for step, shown in enumerate(states):
        program = PROGRAM.states((step - STEPS // 2) * STEP_S)
        for route, letter in zip(routes_of(seed), shown, strict=True):
            assert letter in letters[program[route.incoming.phase]], step


@pytest.mark.parametrize("seed", SEEDS)
def test_links_are_counted_lane_by_lane(seed: int) -> None:
    """SUMO reads request number i as that of the i-th connection when lanes are taken in the junction's order."""
    net = network_of(seed)
    junction = net.find("junction[@id='middle']")
    assert junction is not None
    into = [c for c in net.iter("connection") if c.get("tl") is not None]
    counted = [c for lane in junction.get("incLanes", "").split() for c in into if f"{c.get('from')}_0" == lane]
    assert [int(c.get("linkIndex", "-1")) for c in counted] == list(range(len(routes_of(seed))))
    for route, connection in zip(routes_of(seed), counted, strict=True):
        assert (connection.get("from"), connection.get("to")) == (incoming_edge(route), outgoing_edge(route))


@pytest.mark.parametrize("seed", SEEDS)
def test_exactly_one_of_two_routes_that_meet_goes_first(seed: int) -> None:
    routes = routes_of(seed)
    requests = sorted(network_of(seed).iter("request"), key=lambda r: int(r.get("index", "-1")))
    bits = {key: np.array([[c == "1" for c in r.get(key, "")[::-1]] for r in requests]) for key in ("foes", "response")}
    assert (bits["foes"] == bits["foes"].T).all()
    assert (bits["response"] ^ bits["response"].T == bits["foes"]).all()
    oncoming = [
        (i, j)
        for i, one in enumerate(routes)
        for j, two in enumerate(routes)
        if (one.movement, two.movement) == ("left", "straight") and two.outgoing is one.incoming and bits["foes"][i, j]
    ]
    assert oncoming
    assert all(bits["response"][pair] for pair in oncoming)


@pytest.mark.parametrize("seed", SEEDS)
def test_left_turns_wait_inside_the_middle_where_they_block_nobody(seed: int) -> None:
    junction, net = junction_of(seed), network_of(seed)
    waiting = [(i, wait_m) for i, wait_m in enumerate(junction.waits_m) if wait_m is not None]
    assert waiting
    for i, wait_m in waiting:
        assert junction.routes[i].movement == "left"
        assert junction.routes[i].stop_s_m < wait_m < junction.routes[i].box_s_m[1]
        assert all(junction.zones[i, j].start_m > wait_m for j in range(len(junction.routes)) if junction.meet(i, j))
        inner = net.find(f"junction[@id='{junction.last_lane(i)}']")
        assert inner is not None
        first, *others = inner.get("incLanes", "").split()
        assert first == list(junction.lane_starts_m(i))[1]
        yields_to = {f"{incoming_edge(junction.routes[j])}_0" for one, j in junction.yields if one == i}
        assert set(others) == yields_to
    requests = {int(r.get("index", "-1")): r.get("cont") for r in net.iter("request")}
    assert {i for i, cont in requests.items() if cont == "1"} == {i for i, _ in waiting}


@pytest.mark.parametrize("seed", SEEDS)
def test_narrow_places_lie_on_their_lanes_and_come_in_pairs(seed: int) -> None:
    junction = junction_of(seed)
    pairs = set()
    for connection in network_of(seed).iter("connection"):
        for conflict in connection.iter("conflict"):
            start, end = float(conflict.get("startPos", "nan")), float(conflict.get("endPos", "nan"))
            route = junction.routes[int(connection.get("linkIndex", "-1"))]
            assert 0 < start < end < route.box_s_m[1] - route.stop_s_m
            pairs.add((connection.get("from"), connection.get("to"), conflict.get("from"), conflict.get("to")))
    assert pairs
    assert {(c, d, a, b) for a, b, c, d in pairs} == pairs


def test_demand_names_our_sizes_and_lanes_in_the_order_of_departure() -> None:
    routes = routes_of(5)
    departures = draw_departures(routes, np.random.default_rng(1), 600.0, 1.0)
    root = fromstring(to_bytes(demand(routes, departures)))
    edges = {edge.get("id") for edge in network_of(5).iter("edge")}
    assert all(set(route.get("edges", "").split()) <= edges for route in root.iter("route"))
    kinds = {kind.get("id"): kind for kind in root.iter("vType")}
    vehicles = list(root.iter("vehicle"))
    assert [int(v.get("id", "-1")) for v in vehicles] == [d.vehicle_id for d in departures]
    times = [float(v.get("depart", "nan")) for v in vehicles]
    assert times == sorted(times)
    for vehicle, departure in zip(vehicles, departures, strict=True):
        kind = kinds[vehicle.get("type")]
        size = [float(kind.get(name, "nan")) for name in ("length", "width", "height")]
        assert size == pytest.approx(departure.model.size_m, abs=1e-4)
        assert vehicle.get("route") == f"r{departure.route}"


def test_demand_grows_with_density_and_long_vehicles_hardly_turn() -> None:
    routes = routes_of(5)
    lanes = len({(r.incoming.number, r.lane) for r in routes})
    departures = draw_departures(routes, np.random.default_rng(1), 3600.0, 1.0)
    assert len(departures) / lanes / 60 == pytest.approx(5.4, rel=0.1)
    twice = draw_departures(routes, np.random.default_rng(1), 3600.0, 2.0)
    assert len(twice) == pytest.approx(2 * len(departures), rel=0.1)
    assert draw_departures(routes, np.random.default_rng(1), 3600.0, 0.0) == []
    long = [d for d in departures if d.model.vehicle_class in (RoadUserClass.BUS, RoadUserClass.TRUCK)]
    assert long
    assert not [d for d in long if routes[d.route].movement == "right" and len(_choices(routes, d.route)) > 1]


def test_the_later_of_two_vehicles_that_overlap_is_left_out() -> None:
    route, model = routes_of(2)[0], sample_vehicle(np.random.default_rng(1))
    speed = np.full(50, 10.0)
    way = 20.0 + np.arange(50) * STEP_S * 10.0
    behind = way - model.length_m - 0.5
    braking_late = np.where(np.arange(50) < 30, behind, way - model.length_m + 0.5)
    first, second, third = (
        Trajectory(i, model, route, 3, s, speed) for i, s in ((1, way), (2, behind), (3, braking_late))
    )
    assert without_overlaps([first, second]) == [first, second]
    assert without_overlaps([first, third]) == [first]
    assert without_overlaps([first, second, third]) == [first, second]


def _choices(routes: tuple[Route, ...], number: int) -> list[Route]:
    lane = (routes[number].incoming.number, routes[number].lane)
    return [r for r in routes if (r.incoming.number, r.lane) == lane]


# --- with SUMO ------------------------------------------------------------------------------
def traffic_of(seed: int) -> Traffic:
    pytest.importorskip("libsumo", reason="SUMO is the extra wibam[sumo], which is not installed")
    return _simulate(seed)


@lru_cache
def _simulate(seed: int) -> Traffic:
    return simulate_sumo_traffic(make_layout(seed), seed, 60.0, PROGRAM, density=1.5)


@pytest.mark.parametrize("seed", SEEDS)
def test_vehicles_do_not_overlap(seed: int) -> None:
    traffic = traffic_of(seed)
    for time_s in np.arange(0, 60, 0.25):
        _, boxes = traffic.at(float(time_s))
        i, j = np.triu_indices(len(boxes), 1)
        assert not footprints_overlap(boxes[i], boxes[j]).any(), time_s


@pytest.mark.parametrize("seed", SEEDS)
def test_nobody_passes_the_stop_line_at_red(seed: int) -> None:
    crossings = 0
    for t in traffic_of(seed).trajectories:
        if t.route is None:
            continue
        front = t.s_m + t.model.length_m / 2
        for k in np.flatnonzero((front[:-1] < t.route.stop_s_m) & (front[1:] >= t.route.stop_s_m)):
            crossings += 1
            assert PROGRAM.state(t.route.incoming.phase, (t.first_step + int(k)) * STEP_S) != "red"
    assert crossings > 8


@pytest.mark.parametrize("seed", SEEDS)
def test_vehicles_stop_at_red_and_all_movements_get_through(seed: int) -> None:
    waits, left = 0, set()
    for t in traffic_of(seed).trajectories:
        if t.route is None:
            continue
        gap = t.route.stop_s_m - t.s_m - t.model.length_m / 2
        waits += bool(((t.speed_mps < 0.1) & (gap > 0.0) & (gap < 2.0)).sum() * STEP_S > 2.0)
        if t.s_m[0] < t.route.stop_s_m and t.s_m[-1] > t.route.box_s_m[1]:
            left.add(t.route.movement)
    assert waits >= 4
    assert left == {"left", "straight", "right"}


@pytest.mark.parametrize("seed", SEEDS)
def test_motion_is_continuous_and_speed_is_its_rate(seed: int) -> None:
    for t in traffic_of(seed).trajectories:
        if t.route is None:
            continue
        assert np.isfinite(t.s_m).all()
        assert np.abs(np.diff(t.s_m) / STEP_S - t.speed_mps[1:]).max() < 0.05
        assert np.abs(np.diff(t.speed_mps)).max() / STEP_S <= 7.0 + 1e-6


def test_sizes_are_those_of_our_models() -> None:
    traffic = traffic_of(2)
    drawn = {d.vehicle_id: d for d in draw_departures(routes_of(2), np.random.default_rng([2, 61]), 105.0, 1.5)}
    present, boxes = traffic.at(20.0)
    assert len(present) > 5
    for t, box in zip(present, boxes, strict=True):
        assert box[3:6] == pytest.approx(t.model.size_m)
        assert box[2] == pytest.approx(t.model.height_m / 2)
        assert t.route is None or t.model == drawn[t.vehicle_id].model


def test_the_same_seed_gives_the_same_traffic_and_another_does_not() -> None:
    one = traffic_of(2)
    again = simulate_sumo_traffic(make_layout(2), 2, 60.0, PROGRAM, density=1.5)
    other = simulate_sumo_traffic(make_layout(2), 3, 60.0, PROGRAM, density=1.5)
    assert [t.vehicle_id for t in one.trajectories] == [t.vehicle_id for t in again.trajectories]
    for a, b in zip(one.trajectories, again.trajectories, strict=True):
        assert np.array_equal(a.s_m, b.s_m)
        assert a.model == b.model
    _, before = one.at(30.0)
    _, after = other.at(30.0)
    assert before.shape != after.shape or not np.allclose(before, after)


def test_ids_differ_and_parked_vehicles_stay() -> None:
    traffic = traffic_of(5)
    ids = [t.vehicle_id for t in traffic.trajectories]
    assert len(set(ids)) == len(ids)
    for time_s in (0.0, 60.0):
        present, _ = traffic.at(time_s)
        assert sum(t.route is None for t in present) == sum(t.route is None for t in traffic.trajectories)


def test_no_traffic_without_density() -> None:
    pytest.importorskip("libsumo", reason="SUMO is the extra wibam[sumo], which is not installed")
    traffic = simulate_sumo_traffic(make_layout(2), 2, 2.0, PROGRAM, density=0.0, parked=0)
    assert traffic.trajectories == ()


def test_a_site_is_recorded_with_traffic_from_sumo(tmp_path: Path) -> None:
    pytest.importorskip("libsumo", reason="SUMO is the extra wibam[sumo], which is not installed")
    options = SimulationOptions(
        seed=2, cameras=2, seconds=3.0, fps=5.0, width_px=320, height_px=180, traffic="sumo", parked=0
    )
    site = record_site(tmp_path, options)
    assert len(site.cameras) == 2
    labels = read_labels(tmp_path / "labels.parquet")
    assert max(len(label.vehicles.boxes) for label in labels) >= 3
    assert SimulationOptions.model_validate_json((tmp_path / "truth" / "options.json").read_text()).traffic == "sumo"
