"""Bodies: exact size, tapered, front in front."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.mesh import paint_order
from wibam_core.synthetic.vehicles import (
    CLASS_MIX,
    HEADLIGHT,
    STYLES,
    TAILLIGHT,
    VehicleModel,
    sample_vehicle,
    vehicle_mesh,
)

seeds = st.integers(0, 10_000)


def model_of(seed: int, vehicle_class: RoadUserClass | None = None) -> VehicleModel:
    rng = np.random.default_rng(seed)
    return sample_vehicle(rng, None if vehicle_class is None else {vehicle_class: 1.0})


@given(seeds, st.sampled_from(list(CLASS_MIX)))
@settings(max_examples=40)
def test_extent_is_exactly_the_size(seed: int, vehicle_class: RoadUserClass) -> None:
    model = model_of(seed, vehicle_class)
    points = vehicle_mesh(model).points
    assert np.abs(points.max(axis=0) - np.array(model.size_m) / 2).max() < 1e-12
    assert np.abs(points.min(axis=0) + np.array(model.size_m) / 2).max() < 1e-12


@given(seeds, st.sampled_from(list(CLASS_MIX)))
@settings(max_examples=20)
def test_faces_look_outward(seed: int, vehicle_class: RoadUserClass) -> None:
    mesh = vehicle_mesh(model_of(seed, vehicle_class))
    for part in mesh.parts:
        middle = mesh.points[part.hull].mean(axis=0)
        faces = list(part.faces)
        assert (((mesh.centres[faces] - middle) * mesh.normals[faces]).sum(axis=1) > 0).all()


@given(seeds, st.sampled_from([RoadUserClass.CAR, RoadUserClass.VAN, RoadUserClass.BUS]))
@settings(max_examples=20)
def test_bodies_are_tapered(seed: int, vehicle_class: RoadUserClass) -> None:
    """The roof is narrower and shorter than the body: no top corner of the box is reached, by far."""
    model = model_of(seed, vehicle_class)
    points = vehicle_mesh(model).points
    roof = points[points[:, 2] > 0.45 * model.height_m]
    assert np.abs(roof[:, 1]).max() < 0.475 * model.width_m
    assert roof[:, 0].max() < 0.49 * model.length_m


@pytest.mark.parametrize("style", [s.name for s in STYLES])
def test_convention_headlights_are_at_positive_x(style: str) -> None:
    size = next((s.length_m[0], s.width_m[0], s.height_m[0]) for s in STYLES if s.name == style)
    mesh = vehicle_mesh(VehicleModel(style, *size, (200.0, 30.0, 30.0), (90.0, 90.0, 90.0)))
    for colour, sign in ((HEADLIGHT, 1), (TAILLIGHT, -1)):
        lamps = (mesh.colours == np.array(colour)).all(axis=1)
        assert lamps.sum() >= 2
        assert (sign * mesh.centres[lamps, 0] > 0.3 * size[0]).all()


def test_left_and_right_are_mirror_images() -> None:
    mesh = vehicle_mesh(model_of(3, RoadUserClass.BUS))
    mirrored = mesh.points * np.array([1, -1, 1])
    nearest = np.linalg.norm(mesh.points[:, None] - mirrored[None], axis=-1).min(axis=1)
    hull = np.concatenate([part.hull for part in mesh.parts])
    assert nearest[hull].max() < 1e-9


def test_parts_are_painted_from_far_to_near() -> None:
    mesh = vehicle_mesh(model_of(1, RoadUserClass.TRUCK))
    assert sorted(paint_order(mesh.order, np.array([20.0, 0, 5]))) == list(range(len(mesh.parts)))
    cab = int(np.argmax([mesh.points[p.hull, 0].mean() for p in mesh.parts]))
    assert paint_order(mesh.order, np.array([30.0, 3, 6]))[-1] == cab
    assert paint_order(mesh.order, np.array([-30.0, 3, 6]))[0] == cab


def test_sizes_suit_their_class() -> None:
    rng = np.random.default_rng(0)
    models = [sample_vehicle(rng) for _ in range(600)]
    mean = {c: np.mean([m.length_m for m in models if m.vehicle_class is c]) for c in CLASS_MIX}
    assert 4.2 < mean[RoadUserClass.CAR] < 4.8
    assert mean[RoadUserClass.CAR] < mean[RoadUserClass.VAN] < mean[RoadUserClass.TRUCK] < mean[RoadUserClass.BUS]
    assert {m.style for m in models} == {s.name for s in STYLES}
