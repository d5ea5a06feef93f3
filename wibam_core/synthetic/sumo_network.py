"""An intersection and its demand in SUMO's own file formats, written without netconvert.

The junction is written down lane by lane rather than left to SUMO's network builder, which would draw turns of its
own: every lane of an arm is an edge by itself, so that nobody changes lanes, and every `Route` has its own lane over
the middle, of the route's own shape and length. The distance that a vehicle has gone in SUMO is therefore the distance
along its route. Where paths come too close to each other follows from `synthetic.conflicts`. Straight traffic goes
before right turns and these before left turns. Left turns wait just before the first path that theirs meets: SUMO does
not look out for vehicles that wait farther inside, on the path of somebody who is still leaving.

Formats: https://sumo.dlr.de/docs/Networks/SUMO_Road_Networks.html and
https://sumo.dlr.de/docs/Definition_of_Vehicles%2C_Vehicle_Types%2C_and_Routes.html
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import groupby
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import numpy as np
from numpy.typing import NDArray

from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.conflicts import Zone, find_zones
from wibam_core.synthetic.driving import EMERGENCY_MPS2, STEP_S, speed_limits
from wibam_core.synthetic.layout import Layout
from wibam_core.synthetic.routes import Route, make_routes
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.vehicles import VehicleModel

Array = NDArray[np.float64]

#: The lanes that lead out go on for so long in SUMO, so that the longest vehicle can leave the drawn road, m.
RUN_OUT_M = 15.0
_WAIT_BEFORE_M = 0.5
_JUNCTION = "middle"
_RANKS = {"straight": 2, "right": 1, "left": 0}
_DIRECTIONS = {"straight": "s", "right": "r", "left": "l"}


@dataclass(frozen=True)
class Departure:
    """One vehicle that enters the intersection.

    Attributes:
        vehicle_id: unique. model: its looks and size. route: number of its route.
        time_s: when it wants to enter, on SUMO's clock.
        speed_factor: how it takes speed limits. headway_s: time gap it keeps. margin_s: gap that it wants before
            vehicles that may go first.
    """

    vehicle_id: int
    model: VehicleModel
    route: int
    time_s: float
    speed_factor: float
    headway_s: float
    margin_s: float


@dataclass(frozen=True, eq=False)
class Junction:
    """The middle of an intersection as SUMO is told of it. Routes are known by their numbers.

    Attributes:
        routes: those of one lane next to each other, for SUMO counts a junction's links in this order.
        zones: where two of them meet.
        yields: (i, j) where i lets j go first.
        waits_m: per route, the distance along it at which vehicles wait inside the middle, or None.
    """

    routes: tuple[Route, ...]
    zones: Mapping[tuple[int, int], Zone]
    yields: frozenset[tuple[int, int]]
    waits_m: tuple[float | None, ...]

    def meet(self, i: int, j: int) -> bool:
        """Whether two routes from different lanes cross or merge."""
        return (i, j) in self.zones and self.zones[i, j].kind != "follow"

    def lane_starts_m(self, number: int) -> dict[str, float]:
        """Distance along a route at which each of its SUMO lanes begins, by the lane's name, in driving order."""
        route, wait_m = self.routes[number], self.waits_m[number]
        starts = {f"{incoming_edge(route)}_0": 0.0, f"{_inner_edge(number)}_0": route.stop_s_m}
        if wait_m is not None:
            starts[f"{self.second_edge(number)}_0"] = wait_m
        starts[f"{outgoing_edge(route)}_0"] = route.box_s_m[1]
        return starts

    def second_edge(self, number: int) -> str:
        """Name of the edge that leads on from where a route's vehicles wait inside the middle."""
        return _inner_edge(len(self.routes) + number)

    def last_lane(self, number: int) -> str:
        """Name of a route's last lane in the middle."""
        return f"{_inner_edge(number) if self.waits_m[number] is None else self.second_edge(number)}_0"


def make_junction(layout: Layout) -> Junction:
    """All routes of an intersection, who goes first, and where left turns wait."""
    routes = tuple(sorted(make_routes(layout), key=lambda r: (r.incoming.number, r.lane, r.outgoing.number)))
    zones = find_zones(routes)
    ranks = [(_RANKS[route.movement], -i) for i, route in enumerate(routes)]
    yields = frozenset((i, j) for (i, j), zone in zones.items() if zone.kind != "follow" and ranks[i] < ranks[j])
    waits: list[float | None] = []
    for i, route in enumerate(routes):
        starts = [zone.start_m for (one, _), zone in zones.items() if one == i and zone.kind != "follow"]
        wait_m = min(starts, default=0.0) - _WAIT_BEFORE_M
        inside = route.movement == "left" and route.stop_s_m + 3.0 < wait_m < route.box_s_m[1] - 3.0
        waits.append(wait_m if inside else None)
    return Junction(routes, zones, yields, tuple(waits))


def incoming_edge(route: Route) -> str:
    """Name of the edge on which a route comes in."""
    return f"in{route.incoming.number}.{route.lane}"


def outgoing_edge(route: Route) -> str:
    """Name of the edge on which a route leads out."""
    return f"out{route.outgoing.number}.{route.exit_lane}"


def _inner_edge(number: int) -> str:
    return f":{_JUNCTION}_{number}"


# --- network --------------------------------------------------------------------------------
def network(junction: Junction, program: SignalProgram, first_step: int, last_step: int, speed_mps: float) -> Element:
    """The ``net`` element: lanes, right of way, and the signals of every step from SUMO's time 0 on.

    Args:
        junction: the intersection.
        program: signals; SUMO's time 0 is ``first_step * STEP_S`` on its clock.
        first_step: of `STEP_S`, on the signals' clock; SUMO begins there.
        last_step: SUMO ends there.
        speed_mps: limit outside the middle.
    """
    net = Element("net", version="1.20")
    _add_edges(net, junction, speed_mps)
    _add_signals(net, _signal_states(junction, program, first_step, last_step))
    _add_junctions(net, junction)
    for number in range(len(junction.routes)):
        _add_connections(net, junction, number)
    return net


def _add_edges(net: Element, junction: Junction, speed_mps: float) -> None:
    outer: dict[str, Element] = {}
    for i, route in enumerate(junction.routes):
        limits = speed_limits(route, speed_mps)
        inside_mps = float(limits[int(route.stop_s_m / 0.5) : int(route.box_s_m[1] / 0.5) + 1].min())
        starts = junction.lane_starts_m(i)
        ends = [*list(starts.values())[1:], route.length_m + RUN_OUT_M]
        for (lane, start_m), end_m in zip(starts.items(), ends, strict=True):
            name = lane.removesuffix("_0")
            if name.startswith(":"):
                edge = SubElement(net, "edge", id=name, function="internal")
                _add_lane(edge, route, start_m, end_m, inside_mps)
            elif name not in outer:
                between = (f"{name}.end", _JUNCTION) if name.startswith("in") else (_JUNCTION, f"{name}.end")
                outer[name] = Element("edge", {"id": name, "from": between[0], "to": between[1], "priority": "1"})
                _add_lane(outer[name], route, start_m, end_m, speed_mps)
    net.extend(outer.values())


def _add_lane(edge: Element, route: Route, start_m: float, end_m: float, speed_mps: float) -> None:
    points = route.position(np.linspace(start_m, end_m, max(2, round(end_m - start_m))))
    SubElement(
        edge,
        "lane",
        id=f"{edge.get('id')}_0",
        index="0",
        speed=f"{speed_mps:.3f}",
        length=_number(end_m - start_m),
        width=_number(route.incoming.lane_m),
        shape=_shape(points),
    )


def _signal_states(junction: Junction, program: SignalProgram, first_step: int, last_step: int) -> Iterable[str]:
    phases = [route.incoming.phase for route in junction.routes]
    letters = []
    for i, phase in enumerate(phases):
        minor = any((i, j) in junction.yields and other == phase for j, other in enumerate(phases))
        letters.append({"green": "g" if minor else "G", "amber": "y", "red": "r"})
    for step in range(first_step, last_step + 1):
        states = program.states(step * STEP_S)
        yield "".join(letter[states[phase]] for letter, phase in zip(letters, phases, strict=True))


def _add_signals(net: Element, states: Iterable[str]) -> None:
    logic = SubElement(net, "tlLogic", id=_JUNCTION, type="static", programID="0", offset="0")
    for state, steps in groupby(states):
        SubElement(logic, "phase", duration=_number(STEP_S * sum(1 for _ in steps)), state=state)


def _add_junctions(net: Element, junction: Junction) -> None:
    routes, numbers = junction.routes, range(len(junction.routes))
    incoming = {incoming_edge(r): r for r in routes}
    corners = np.array([r.position(s) for r in routes for s in (r.stop_s_m, r.box_s_m[1])])
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    middle = _add_junction(
        net,
        _JUNCTION,
        "traffic_light",
        np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]),
        [f"{name}_0" for name in incoming],
        [junction.last_lane(i) for i in numbers],
    )
    for i in numbers:
        SubElement(
            middle,
            "request",
            index=str(i),
            response=_bits((i, j) in junction.yields for j in numbers),
            foes=_bits(junction.meet(i, j) for j in numbers),
            cont="0" if junction.waits_m[i] is None else "1",
        )
    for name, route in incoming.items():
        _add_junction(net, f"{name}.end", "dead_end", route.position([0.0]), [], [])
    for name, route in {outgoing_edge(r): r for r in routes}.items():
        end = route.position([route.length_m + RUN_OUT_M])
        _add_junction(net, f"{name}.end", "dead_end", end, [f"{name}_0"], [])
    for i, wait_m in enumerate(junction.waits_m):
        if wait_m is not None:
            first = [f"{_inner_edge(i)}_0", *(f"{name}_0" for name, r in incoming.items() if _faces(junction, i, r))]
            foes = [junction.last_lane(j) for j in numbers if junction.meet(i, j)]
            place = routes[i].position([wait_m])
            _add_junction(net, f"{junction.second_edge(i)}_0", "internal", place, first, foes)


def _faces(junction: Junction, number: int, incoming: Route) -> bool:
    """Whether anybody from the lane of ``incoming`` goes before the vehicles of a route."""
    return any(
        (number, j) in junction.yields and incoming_edge(other) == incoming_edge(incoming)
        for j, other in enumerate(junction.routes)
    )


def _add_junction(
    net: Element, name: str, kind: str, outline: Array, incoming: Sequence[str], inner: Sequence[str]
) -> Element:
    x, y = outline.mean(axis=0)
    attributes = {"incLanes": " ".join(incoming), "intLanes": " ".join(inner), "shape": _shape(outline)}
    return SubElement(net, "junction", attributes, id=name, type=kind, x=_number(x), y=_number(y))


def _add_connections(net: Element, junction: Junction, number: int) -> None:
    """A route's way into the middle, with its narrow places in lane coordinates, and its way out of it."""
    route, inner = junction.routes[number], _inner_edge(number)
    ends = {"to": outgoing_edge(route), "fromLane": "0", "toLane": "0", "dir": _DIRECTIONS[route.movement]}
    signal = {"via": f"{inner}_0", "tl": _JUNCTION, "linkIndex": str(number), "state": "o"}
    into = SubElement(net, "connection", {"from": incoming_edge(route), **ends, **signal})
    length_m = route.box_s_m[1] - route.stop_s_m
    for j, other in enumerate(junction.routes):
        zone = junction.zones.get((number, j))
        if zone is None or zone.kind != "cross":
            continue
        start_m = float(np.clip(zone.start_m - route.stop_s_m, 0.01, length_m - 0.02))
        end_m = float(np.clip(zone.end_m - route.stop_s_m, start_m + 0.01, length_m - 0.01))
        SubElement(
            into,
            "conflict",
            {"from": incoming_edge(other), "to": outgoing_edge(other), "fromLane": "0", "toLane": "0"},
            startPos=_number(start_m),
            endPos=_number(end_m),
        )
    if junction.waits_m[number] is not None:
        second = junction.second_edge(number)
        SubElement(net, "connection", {"from": inner, **ends}, via=f"{second}_0", state="m")
        inner = second
    SubElement(net, "connection", {"from": inner, **ends}, state="M")


def _bits(values: Iterable[bool]) -> str:
    """SUMO's bit sets have number 0 on the right."""
    return "".join("1" if value else "0" for value in values)[::-1]


def _shape(points: Array) -> str:
    return " ".join(f"{x:.4f},{y:.4f}" for x, y in points.tolist())


def _number(value: float) -> str:
    return f"{value:.4f}"


# --- demand ---------------------------------------------------------------------------------
def demand(routes: Sequence[Route], departures: Iterable[Departure]) -> Element:
    """The ``routes`` element: every vehicle with a type of its own, in the order of departure."""
    root = Element("routes")
    for i, route in enumerate(routes):
        SubElement(root, "route", id=f"r{i}", edges=f"{incoming_edge(route)} {outgoing_edge(route)}")
    for departure in sorted(departures, key=lambda d: (d.time_s, d.vehicle_id)):
        model = departure.model
        heavy = model.vehicle_class in (RoadUserClass.BUS, RoadUserClass.TRUCK)
        SubElement(
            root,
            "vType",
            id=f"t{departure.vehicle_id}",
            vClass=model.vehicle_class.traits.elsewhere.sumo,
            length=_number(model.length_m),
            width=_number(model.width_m),
            height=_number(model.height_m),
            minGap="2.0",
            carFollowModel="Krauss",
            sigma="0",
            accel="1.2" if heavy else "1.8",
            decel="3.5" if heavy else "4.0",
            emergencyDecel=f"{EMERGENCY_MPS2}",
            tau=_number(departure.headway_s),
            maxSpeed="30",
            speedFactor=_number(departure.speed_factor),
            speedDev="0",
            jmTimegapMinor=_number(departure.margin_s),
        )
        SubElement(
            root,
            "vehicle",
            id=str(departure.vehicle_id),
            type=f"t{departure.vehicle_id}",
            route=f"r{departure.route}",
            depart=f"{departure.time_s:.2f}",
            departPos="base",
            departSpeed="max",
        )
    return root


def to_bytes(root: Element) -> bytes:
    """The XML file of an element."""
    indent(root)
    buffer = BytesIO()
    ElementTree(root).write(buffer, encoding="utf-8", xml_declaration=True)
    return buffer.getvalue()
