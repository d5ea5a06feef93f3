"""Varied views for training: repeatable, true to the geometry, and free of clutter where vehicles drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wibam_core.geometry.iou import bev_iou
from wibam_core.road_users import RoadUserClass
from wibam_core.synthetic.cameras import elevated_camera
from wibam_core.synthetic.clutter import cluttered
from wibam_core.synthetic.facades import Clutter
from wibam_core.synthetic.layout import make_layout, road_distance_m
from wibam_core.synthetic.lighting import sample_lighting
from wibam_core.synthetic.render import Renderer
from wibam_core.synthetic.routes import make_routes
from wibam_core.synthetic.sampling import TRAINING_MIX, sample_moment
from wibam_core.synthetic.textured_background import sample_materials
from wibam_core.synthetic.textured_render import TexturedRenderer
from wibam_core.synthetic.varied_sampling import sample_varied_views
from wibam_core.synthetic.varied_vehicles import sample_varied, varied_mesh

SIZE = (256, 144)


def test_views_follow_from_the_seed_and_are_consistent() -> None:
    one, again = (list(sample_varied_views(3, 4, SIZE)) for _ in range(2))
    other = next(sample_varied_views(4, 1, SIZE))
    vehicles = 0
    for a, b in zip(one, again, strict=True):
        assert np.array_equal(a.image, b.image)
        assert np.array_equal(a.vehicles.boxes, b.vehicles.boxes)
        assert (a.camera.width_px, a.camera.height_px) == SIZE
        assert a.camera.centre_m[2] >= 2
        assert (a.amodal_boxes[:, 2:] > a.amodal_boxes[:, :2]).all()
        vehicles += int((a.visibility > 0.3).sum())
    assert vehicles >= 2
    assert not np.array_equal(one[0].image, other.image)
    assert np.array_equal(one[0].camera.centre_m, one[1].camera.centre_m), "one camera, other traffic"
    assert not np.array_equal(one[0].vehicles.boxes, one[1].vehicles.boxes)


def test_near_cameras_see_vehicles_large() -> None:
    def largest(near: float) -> float:
        views = [view for seed in range(6) for view in sample_varied_views(seed, 1, SIZE, near)]
        return float(np.median([np.ptp(view.amodal_boxes[:, ::2], axis=1).max(initial=0.0) for view in views]))

    assert largest(1.0) > max(0.2 * SIZE[0], 1.2 * largest(0.0))


def test_looks_change_no_truth() -> None:
    """What is seen of each vehicle is what the plain renderer says; only colours differ."""
    layout = replace(make_layout(5), trees=())
    rng = np.random.default_rng(5)
    models, boxes = sample_moment(layout, make_routes(layout), rng)
    lighting, camera = sample_lighting(rng), elevated_camera(layout, rng, SIZE)
    plain = Renderer(layout, lighting, camera).draw(models, boxes, {})
    textured = TexturedRenderer(layout, lighting, camera, sample_materials(layout, rng)).draw(models, boxes, {})
    assert np.array_equal(plain.ids, textured.ids)
    assert np.array_equal(plain.visible_boxes, textured.visible_boxes)
    assert np.array_equal(plain.visibility, textured.visibility)
    assert (plain.visibility > 0.3).any()
    assert np.abs(plain.image.astype(int) - textured.image).mean() > 3


@pytest.mark.parametrize("seed", range(3))
def test_clutter_stands_beside_the_roads(seed: int) -> None:
    layout = cluttered(make_layout(seed), np.random.default_rng(seed))
    blocks = [building for building in layout.buildings if isinstance(building, Clutter)]
    assert blocks
    for block in blocks:
        assert road_distance_m(layout.arms, block.footprint).min() > 0.25
        (ax, ay), (bx, by), (cx, cy), _ = block.footprint
        assert (bx - ax) * (cy - by) - (by - ay) * (cx - bx) > 0, "counter-clockwise, as walls are painted"


@pytest.mark.parametrize("vehicle_class", list(TRAINING_MIX))
def test_bodies_fill_their_boxes_and_differ(vehicle_class: RoadUserClass) -> None:
    rng = np.random.default_rng(vehicle_class.number)
    models = [sample_varied(rng, {vehicle_class: 1.0}) for _ in range(8)]
    assert len({model.style for model in models}) > 1
    for model in models:
        assert model.vehicle_class is vehicle_class
        mesh = varied_mesh(model)
        assert np.allclose(np.ptp(mesh.points, axis=0), model.size_m)
        outward = np.einsum("ij,ij->i", mesh.normals, mesh.centres - mesh.points.mean(axis=0))
        assert (outward > 0).mean() > 0.6
        assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1)


def test_vehicles_of_one_moment_do_not_overlap() -> None:
    layout = make_layout(8)
    models, boxes = sample_moment(layout, make_routes(layout), np.random.default_rng(1), sample_varied)
    assert len(models) == len(boxes) > 5
    overlap = bev_iou(boxes, boxes)
    np.fill_diagonal(overlap, 0)
    assert overlap.max() < 1e-6
