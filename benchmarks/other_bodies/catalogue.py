"""Vehicles as they are sold: published dimensions, and side profiles drawn after them.

Length, width without mirrors, height, wheelbase and front overhang are those that makers publish, rounded to 1 cm.
The profiles (heights and places of bonnet, screens, roof and waistline) are read off side views, in shares of length
and height, and are good to some per cent. Half of the models may be looked at while something is chosen; the other half
is held out.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from wibam_core.road_users import RoadUserClass

#: Points of a curve over the length: (share of the length behind the front, share of the height).
Curve = tuple[tuple[float, float], ...]

CAR, VAN, TRUCK, BUS = RoadUserClass.CAR, RoadUserClass.VAN, RoadUserClass.TRUCK, RoadUserClass.BUS


@dataclass(frozen=True)
class Cargo:
    """A body behind the cab: from this share of the length to the rear, its floor and top in m, and its width in m."""

    start: float
    floor_m: float
    top_m: float
    width_m: float


@dataclass(frozen=True)
class BodyModel:
    """One model.

    Attributes:
        name: maker, model and generation.
        vehicle_class: as a person would label it.
        length_m, width_m, height_m: width without mirrors.
        wheelbase_m, front_overhang_m: from the first to the last axle, and from the front to the first.
        top: upper contour in the middle. waist: lower edge of the windows.
        screens: shares of the length between which there is glass (first and last of the glasshouse).
        pillars: shares of the length at which pillars divide the side windows.
        side_glass: shares of the length of the side windows, first and last; None for those of ``screens``.
        rear_glass: whether there is a window at the rear.
        roof_width: width of the roof over that of the body. nose: radius in plan of the front's corners, in widths.
        tail: that of the rear's. clearance_m: of the body above the ground. wheel_m: outer diameter of the tyres.
        axles: shares of the wheelbase at which further axles lie.
        cargo: a separate body behind the cab. cab_rear: share of the length at which the cab then ends.
        bed: shares of the length of an open bed. mirrors: share of the length at which they are, None without.
        cladding: dark plastic along the sills. weight: share among models.
        held_out: nothing may be chosen by it.
    """

    name: str
    vehicle_class: RoadUserClass
    length_m: float
    width_m: float
    height_m: float
    wheelbase_m: float
    front_overhang_m: float
    top: Curve
    waist: float
    screens: tuple[float, float]
    pillars: tuple[float, ...] = ()
    side_glass: tuple[float, float] | None = None
    rear_glass: bool = True
    roof_width: float = 0.74
    nose: float = 0.30
    tail: float = 0.22
    clearance_m: float = 0.20
    wheel_m: float = 0.65
    axles: tuple[float, ...] = ()
    cargo: Cargo | None = None
    cab_rear: float = 1.0
    bed: tuple[float, float] | None = None
    mirrors: float | None = 0.32
    cladding: bool = False
    weight: float = 1.0
    held_out: bool = field(default=False, kw_only=True)


_HATCH: Curve = (
    (0.0, 0.44), (0.02, 0.53), (0.08, 0.60), (0.25, 0.69), (0.29, 0.72), (0.42, 0.95), (0.52, 1.0), (0.70, 0.985),
    (0.88, 0.91), (0.95, 0.74), (0.985, 0.62), (1.0, 0.48),
)  # fmt: skip
_ESTATE: Curve = (
    (0.0, 0.43), (0.02, 0.52), (0.07, 0.60), (0.25, 0.68), (0.28, 0.70), (0.41, 0.95), (0.50, 1.0), (0.75, 0.985),
    (0.91, 0.93), (0.97, 0.72), (0.99, 0.60), (1.0, 0.46),
)  # fmt: skip
_SALOON: Curve = (
    (0.0, 0.43), (0.02, 0.52), (0.08, 0.60), (0.27, 0.69), (0.30, 0.71), (0.43, 0.96), (0.52, 1.0), (0.66, 0.97),
    (0.81, 0.79), (0.85, 0.76), (0.97, 0.74), (0.99, 0.66), (1.0, 0.48),
)  # fmt: skip
_SUV: Curve = (
    (0.0, 0.42), (0.015, 0.54), (0.06, 0.62), (0.23, 0.69), (0.27, 0.71), (0.37, 0.94), (0.48, 1.0), (0.72, 0.985),
    (0.90, 0.93), (0.96, 0.74), (0.99, 0.60), (1.0, 0.45),
)  # fmt: skip
_PICK_UP: Curve = (
    (0.0, 0.40), (0.01, 0.56), (0.05, 0.63), (0.22, 0.68), (0.25, 0.70), (0.33, 0.94), (0.40, 1.0), (0.56, 0.985),
    (0.61, 0.90), (0.635, 0.67), (0.66, 0.66), (0.985, 0.66), (1.0, 0.50),
)  # fmt: skip
_MINIBUS: Curve = (
    (0.0, 0.36), (0.015, 0.44), (0.05, 0.52), (0.15, 0.60), (0.19, 0.63), (0.31, 0.95), (0.38, 1.0), (0.80, 0.99),
    (0.95, 0.96), (0.98, 0.80), (0.99, 0.55), (1.0, 0.34),
)  # fmt: skip
_PANEL_VAN: Curve = (
    (0.0, 0.28), (0.015, 0.36), (0.04, 0.42), (0.12, 0.49), (0.15, 0.52), (0.24, 0.82), (0.31, 0.97), (0.40, 1.0),
    (0.94, 0.99), (0.985, 0.95), (1.0, 0.70),
)  # fmt: skip
_MINIVAN: Curve = (
    (0.0, 0.40), (0.015, 0.50), (0.06, 0.58), (0.19, 0.66), (0.22, 0.68), (0.37, 0.95), (0.46, 1.0), (0.74, 0.985),
    (0.91, 0.93), (0.96, 0.74), (0.99, 0.58), (1.0, 0.42),
)  # fmt: skip
#: A cab before a cargo body: shares of the whole vehicle's length and height.
_CAB_OVER: Curve = ((0.0, 0.45), (0.005, 0.60), (0.02, 0.74), (0.05, 0.80), (0.13, 0.82), (0.20, 0.82), (1.0, 0.82))
_TRACTOR: Curve = ((0.0, 0.55), (0.003, 0.72), (0.012, 0.86), (0.035, 0.97), (0.07, 0.985), (0.13, 0.99), (1.0, 0.99))
_NPR_CAB: Curve = ((0.0, 0.45), (0.01, 0.56), (0.05, 0.72), (0.09, 0.76), (0.20, 0.77), (0.27, 0.77), (1.0, 0.77))
_CITY_BUS: Curve = (
    (0.0, 0.60), (0.004, 0.82), (0.012, 0.93), (0.03, 0.985), (0.06, 1.0), (0.97, 1.0), (0.99, 0.96), (1.0, 0.75),
)  # fmt: skip

MODELS: tuple[BodyModel, ...] = (
    BodyModel(
        "Volkswagen Golf 7", CAR, 4.26, 1.80, 1.45, 2.64, 0.85, _HATCH, 0.63, (0.27, 0.97), (0.55, 0.79), weight=2,
    ),
    BodyModel("Toyota Camry 8", CAR, 4.89, 1.84, 1.45, 2.83, 0.96, _SALOON, 0.65, (0.29, 0.84), (0.55,), weight=2),
    BodyModel("Škoda Octavia Combi 3", CAR, 4.67, 1.81, 1.47, 2.69, 0.88, _ESTATE, 0.63, (0.27, 0.975), (0.51, 0.74)),
    BodyModel(
        "Nissan Qashqai 2", CAR, 4.38, 1.81, 1.59, 2.65, 0.89, _SUV, 0.62, (0.26, 0.97), (0.53, 0.78),
        clearance_m=0.24, wheel_m=0.69, cladding=True, weight=2,
    ),
    BodyModel(
        "Ford F-150 13 SuperCrew", CAR, 5.89, 2.03, 1.96, 3.68, 0.96, _PICK_UP, 0.63, (0.24, 0.635), (0.44,),
        roof_width=0.78, nose=0.20, tail=0.06, clearance_m=0.32, wheel_m=0.82, bed=(0.655, 0.975), mirrors=0.29,
    ),
    BodyModel(
        "Volkswagen Caravelle T6", VAN, 4.90, 1.90, 1.97, 3.00, 0.91, _MINIBUS, 0.55, (0.17, 0.985), (0.37, 0.67),
        roof_width=0.82, nose=0.25, tail=0.12, mirrors=0.24,
    ),
    BodyModel(
        "Fiat Ducato L2H2", VAN, 5.41, 2.05, 2.52, 3.45, 0.95, _PANEL_VAN, 0.47, (0.14, 0.30), (), (0.16, 0.34), False,
        roof_width=0.86, nose=0.25, tail=0.05, wheel_m=0.70, mirrors=0.21,
    ),
    BodyModel(
        "Mercedes-Benz Atego 1218 box", TRUCK, 8.60, 2.55, 3.60, 4.76, 1.28, _CAB_OVER, 0.52, (0.0, 0.17), (),
        (0.03, 0.14), False, roof_width=0.90, nose=0.10, tail=0.03, clearance_m=0.35, wheel_m=0.86,
        cargo=Cargo(0.215, 1.05, 3.60, 2.55), cab_rear=0.20, mirrors=0.02, weight=0.5,
    ),
    BodyModel(
        "Mercedes-Benz Citaro", BUS, 12.14, 2.55, 3.12, 5.90, 2.81, _CITY_BUS, 0.42, (0.0, 1.0),
        (0.13, 0.24, 0.36, 0.48, 0.60, 0.72, 0.86), (0.01, 0.93), roof_width=0.93, nose=0.12, tail=0.06,
        clearance_m=0.28, wheel_m=0.96, mirrors=None, weight=0.4,
    ),
    BodyModel(
        "Renault Clio 4", CAR, 4.06, 1.73, 1.45, 2.59, 0.85, _HATCH, 0.64, (0.27, 0.97), (0.56, 0.80), weight=2,
        held_out=True,
    ),
    BodyModel(
        "Toyota Corolla 12 Touring Sports", CAR, 4.65, 1.79, 1.44, 2.70, 0.93, _ESTATE, 0.64, (0.27, 0.97),
        (0.51, 0.75), held_out=True,
    ),
    BodyModel(
        "Volvo S60 3", CAR, 4.76, 1.85, 1.43, 2.87, 0.87, _SALOON, 0.66, (0.29, 0.84), (0.55,), weight=2,
        held_out=True,
    ),
    BodyModel(
        "Toyota RAV4 5", CAR, 4.60, 1.86, 1.69, 2.69, 0.93, _SUV, 0.63, (0.26, 0.97), (0.53, 0.77), clearance_m=0.26,
        wheel_m=0.73, cladding=True, weight=2, held_out=True,
    ),
    BodyModel(
        "Ford Ranger T6 double cab", CAR, 5.36, 1.85, 1.82, 3.22, 0.91, _PICK_UP, 0.64, (0.24, 0.635), (0.45,),
        roof_width=0.76, nose=0.22, tail=0.08, clearance_m=0.30, wheel_m=0.78, bed=(0.655, 0.975), mirrors=0.29,
        held_out=True,
    ),
    BodyModel(
        "Honda Odyssey 5", CAR, 5.16, 1.99, 1.74, 3.00, 0.97, _MINIVAN, 0.60, (0.22, 0.975), (0.45, 0.72),
        roof_width=0.78, held_out=True,
    ),
    BodyModel(
        "Ford Transit Connect 2", VAN, 4.42, 1.84, 1.84, 2.66, 0.90, _MINIBUS, 0.57, (0.18, 0.36), (), (0.20, 0.42),
        False, roof_width=0.82, nose=0.28, tail=0.08, mirrors=0.27, held_out=True,
    ),
    BodyModel(
        "Mercedes-Benz Sprinter 907 L2H2", VAN, 5.93, 2.02, 2.64, 3.67, 1.00, _PANEL_VAN, 0.47, (0.14, 0.30), (),
        (0.16, 0.33), False, roof_width=0.84, nose=0.28, tail=0.05, wheel_m=0.69, mirrors=0.20, held_out=True,
    ),
    BodyModel(
        "Isuzu NPR box", TRUCK, 6.70, 2.20, 3.05, 3.85, 1.10, _NPR_CAB, 0.50, (0.0, 0.24), (), (0.04, 0.20), False,
        roof_width=0.88, nose=0.12, tail=0.03, clearance_m=0.32, wheel_m=0.78, cargo=Cargo(0.275, 0.95, 3.05, 2.20),
        cab_rear=0.255, mirrors=0.03, weight=0.35, held_out=True,
    ),
    BodyModel(
        "Scania R with a curtain-side semi-trailer", TRUCK, 16.50, 2.55, 4.00, 12.35, 1.46, _TRACTOR, 0.55, (0.0, 0.1),
        (), (0.02, 0.085), False, roof_width=0.92, nose=0.12, tail=0.03, clearance_m=0.35, wheel_m=1.0,
        axles=(0.30, 0.79, 0.894), cargo=Cargo(0.176, 1.20, 4.00, 2.55), cab_rear=0.145, mirrors=0.015, weight=0.15,
        held_out=True,
    ),
    BodyModel(
        "Solaris Urbino 8.9", BUS, 8.95, 2.40, 2.90, 4.40, 2.30, _CITY_BUS, 0.42, (0.0, 1.0),
        (0.16, 0.32, 0.48, 0.64, 0.80), (0.015, 0.92), roof_width=0.92, nose=0.14, tail=0.06, clearance_m=0.28,
        wheel_m=0.84, mirrors=None, weight=0.4, held_out=True,
    ),
)  # fmt: skip
