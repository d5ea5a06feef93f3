"""Wireframes: what is drawn is what the camera sees, also where a box reaches behind it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import look_at
from wibam_core.geometry.box3d import EDGES, corners
from wibam_core.geometry.projection import project_boxes
from wibam_core.report.overlay import clip_near, clip_segment, draw_boxes, project_edge

CAMERA = look_at((0.0, -12.0, 6.0))
RED = (0, 0, 255)
coordinate = st.floats(-2000, 2000)


def blank() -> np.ndarray:
    return np.zeros((CAMERA.height_px, CAMERA.width_px, 3), np.uint8)


@given(
    st.tuples(st.floats(-30, 30), st.floats(-30, 60), st.floats(0, 3)),
    st.tuples(st.floats(1, 12), st.floats(1, 3), st.floats(1, 4)),
    st.floats(-np.pi, np.pi),
)
def test_edges_stay_in_the_reprojected_box(centre, size, yaw):
    box = np.array([*centre, *size, yaw])
    limits = project_boxes(CAMERA, box)[0]
    vertices = CAMERA.to_camera(corners(box))
    pieces = [piece for a, b in EDGES for piece in project_edge(CAMERA, vertices[a], vertices[b])]
    if np.isnan(limits).all():
        assert pieces == []
    for point in (point for piece in pieces for point in piece):
        assert (point >= limits[:2] - 1e-6).all() and (point <= limits[2:] + 1e-6).all()


def test_edges_of_a_box_in_view_join_its_projected_corners():
    box = np.array([0.0, 4.0, 0.8, 4.4, 1.8, 1.6, 0.3])
    vertices, (uv, _) = CAMERA.to_camera(corners(box)), CAMERA.project(corners(box))
    for a, b in EDGES:
        ((start, end),) = project_edge(CAMERA, vertices[a], vertices[b])
        np.testing.assert_allclose([start, end], uv[[a, b]], atol=1e-9)


def test_distorted_edges_follow_the_lens():
    camera = look_at((0.0, -12.0, 6.0), dist=(-0.2, 0.05, 0.0, 0.0))
    box = np.array([6.0, 4.0, 0.8, 4.4, 1.8, 1.6, 0.3])
    world = corners(box)
    vertices = camera.to_camera(world)
    pieces = project_edge(camera, vertices[0], vertices[1])
    assert len(pieces) > 1
    middle, _ = camera.project(0.5 * (world[0] + world[1]))
    assert min(np.linalg.norm(point - middle) for piece in pieces for point in piece) < 0.05


@given(coordinate, coordinate, coordinate, coordinate, st.floats(0, 1))
def test_clipping_keeps_exactly_what_lies_in_the_image(x0, y0, x1, y1, share):
    a, b = np.array([x0, y0]), np.array([x1, y1])
    clipped = clip_segment(a, b, 640, 360)
    point = a + share * (b - a)
    if clipped is None:
        assert not ((point > [-0.499, -0.499]) & (point < [639.499, 359.499])).all()
        return
    for end in clipped:
        assert (end >= -0.5 - 1e-6).all() and (end <= np.array([639.5, 359.5]) + 1e-6).all()
    if ((point > -0.5) & (point < [639.5, 359.5])).all():
        along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
        first, last = ((end - a) @ along for end in clipped)
        assert first - 1e-6 <= (point - a) @ along <= last + 1e-6


def test_a_face_behind_the_camera_vanishes_and_one_across_is_cut():
    behind = np.array([[-1, -1, -2], [1, -1, -2], [1, 1, -2], [-1, 1, -2]], dtype=float)
    assert len(clip_near(behind)) == 0
    across = behind * [1, 1, 0] + np.array([-2.0, -2.0, 2.0, 2.0])[:, None] * [0, 0, 1]
    kept = clip_near(across)
    assert len(kept) == 4 and kept[:, 2].min() == pytest.approx(0.1)


def test_convention_front_face_is_where_the_yaw_points():
    """A vehicle that drives to the right of the image has its tint on the right."""
    box = np.array([[0.0, 0.0, 0.75, 4.4, 1.8, 1.5, 0.0]])
    outline = draw_boxes(blank(), CAMERA, box, RED, mark_front=False)
    tinted = draw_boxes(blank(), CAMERA, box, RED)
    columns = np.nonzero((tinted != outline).any(axis=(0, 2)))[0]
    middle, _ = CAMERA.project(box[0, :3])
    assert len(columns) and columns.min() > middle[0]


def test_drawing_leaves_the_image_alone_and_behind_draws_nothing():
    image = blank()
    drawn = draw_boxes(image, CAMERA, [[0.0, 0.0, 0.75, 4.4, 1.8, 1.5, 0.0]], RED)
    assert not image.any() and drawn.any()
    assert not draw_boxes(image, CAMERA, [[0.0, -40.0, 0.75, 4.4, 1.8, 1.5, 0.0]], RED).any()
    assert not draw_boxes(image, CAMERA, np.empty((0, 7)), RED).any()


def test_boxes_fit_images_of_another_size():
    small = np.zeros((180, 320, 3), np.uint8)
    box = [[0.0, 0.0, 0.75, 4.4, 1.8, 1.5, 0.0]]
    rows, columns = np.nonzero(draw_boxes(small, CAMERA, box, RED, thickness_px=1).any(axis=2))
    limits = project_boxes(CAMERA.resized(320, 180), np.array(box))[0]
    np.testing.assert_allclose([columns.min(), rows.min(), columns.max(), rows.max()], limits, atol=2)


@pytest.mark.parametrize("x", np.arange(-60.0, 61.0, 2.0))
def test_a_box_may_leave_the_picture_on_any_side(x: float) -> None:
    boxes = [[x, y, 0.75, 4.4, 1.8, 1.5, yaw] for y in (-20.0, -10.0, -5.0, 20.0) for yaw in (0.0, 2.0)]
    draw_boxes(blank(), CAMERA, boxes, RED)


def test_each_box_may_have_its_colour() -> None:
    boxes = [[0.0, 0.0, 0.75, 4.4, 1.8, 1.5, 0.0], [6.0, 0.0, 0.75, 4.4, 1.8, 1.5, 0.0]]
    both = draw_boxes(blank(), CAMERA, boxes, [RED, (0, 255, 0)], mark_front=False)
    for box, colour, channel in ((boxes[0], RED, 2), (boxes[1], (0, 255, 0), 1)):
        alone = draw_boxes(blank(), CAMERA, [box], colour, mark_front=False)
        drawn = alone[..., channel] == 255
        assert drawn.any() and (both[..., channel][drawn] > 100).mean() > 0.9
