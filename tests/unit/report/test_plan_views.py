"""Plan views and the orthophoto that they lie on."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from tests.builders import corner_rig, look_at
from tests.unit.report.scenes import boxes_at, crossing_traffic, paint
from wibam_core.geometry.ground import intersect_plane
from wibam_core.report import bev
from wibam_core.report.bev import ConflictMark, Ground, field_of_view
from wibam_core.report.encode import svg_uri, webp_uri
from wibam_core.report.mosaic import Extent, ground_mosaic, typical_image

RIG = corner_rig(4)
EXTENT = Extent(-30.0, 30.0, -30.0, 30.0)


def shade(mosaic: np.ndarray, x_m: float, y_m: float, cell_m: float) -> np.ndarray:
    row = int((EXTENT.y_max_m - y_m) / cell_m)
    column = int((x_m - EXTENT.x_min_m) / cell_m)
    return mosaic[row, column].astype(int)


def test_convention_mosaic_has_north_on_top_and_is_rgb():
    """A red square on the ground at (−8, 12) is red in the upper left quarter."""
    rig = corner_rig(2)
    images = {}
    for camera_id, camera in rig.items():
        image = paint(camera, np.empty((0, 7)))
        v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
        ground = intersect_plane(camera, np.stack([u, v], axis=-1).astype(float))
        image[(np.abs(ground[..., 0] + 8) < 2) & (np.abs(ground[..., 1] - 12) < 2)] = (0, 0, 255)
        images[camera_id] = image
    mosaic = ground_mosaic(rig, images, EXTENT, 0.25)
    red, green, blue = shade(mosaic, -8.0, 12.0, 0.25)
    assert red > 200 and green < 60 and blue < 60
    assert shade(mosaic, 8.0, -12.0, 0.25)[0] < 150


def test_mosaic_shows_the_road_where_it_is_and_white_where_nobody_looks():
    images = {camera_id: paint(camera, np.empty((0, 7))) for camera_id, camera in RIG.items()}
    mosaic = ground_mosaic(RIG, images, EXTENT, 0.25)
    np.testing.assert_allclose(shade(mosaic, 3.0, 3.0, 0.25), (90, 92, 95), atol=6)
    np.testing.assert_allclose(shade(mosaic, 9.0, 9.0, 0.25), (105, 140, 90), atol=6)
    alone = {"cam1": images["cam1"]}
    assert (shade(ground_mosaic(RIG, alone, EXTENT, 0.25), 28.0, 28.0, 0.25) == 255).all()


def test_typical_image_forgets_what_moves():
    camera = RIG["cam1"]
    empty = paint(camera, np.empty((0, 7)))
    busy = paint(camera, boxes_at(crossing_traffic(), 2_000_000_000)[0])
    assert (typical_image([empty, busy, empty]) == empty).all()


def test_extent_is_a_square_around_all_points():
    extent = Extent.around(np.array([[0.0, 0.0], [40.0, 10.0], [np.nan, 3.0]]), margin_m=5.0)
    assert (extent.x_min_m, extent.x_max_m) == (-5.0, 45.0)
    assert (extent.y_min_m, extent.y_max_m) == (-20.0, 30.0)
    assert Extent.around(np.empty((0, 2))).x_max_m == 10.0


@pytest.mark.parametrize("target", [(0.0, 0.0, 0.0), (0.0, 0.0, 9.0)])
def test_field_of_view_is_ground_that_the_camera_sees(target):
    camera = look_at((20.0, 0.0, 8.0), target)
    outline = field_of_view(camera, 50.0)
    assert np.isfinite(outline).all()
    assert np.linalg.norm(outline - [20.0, 0.0], axis=1).max() <= 50.0 + 1e-9
    inside = 0.95 * outline + 0.05 * outline.mean(axis=0)
    uv, _ = camera.project(np.column_stack([inside, np.zeros(len(inside))]))
    assert camera.contains(uv).mean() > 0.9


def test_figures_are_the_same_bytes_twice():
    tracks = crossing_traffic()
    marks = [ConflictMark(1, 2.0, -2.0, "crossing", (1, 3))]
    ground = Ground(EXTENT)
    first, second = (svg_uri(bev.tracks_figure(RIG, ground, tracks, marks)) for _ in range(2))
    assert first == second
    assert webp_uri(bev.conflicts_figure(RIG, ground, tracks, marks)).startswith("data:image/webp;base64,")


def test_tracks_without_a_conflict_show_in_grey_on_a_grey_road():
    """Lines across the map change many pixels by much, although the road below is of nearly the same grey."""
    photo = np.full((200, 200, 3), (95, 105, 110), np.uint8)
    marks = [ConflictMark(1, 2.0, -2.0, "crossing", (1, 3))]
    pictures = []
    for tracks in (crossing_traffic(), [t for t in crossing_traffic() if t.track_id in (1, 3)]):
        figure = bev.conflicts_figure(RIG, Ground(EXTENT, photo), tracks, marks)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        pictures.append(np.asarray(canvas.buffer_rgba())[..., :3].astype(int))
    with_others, without = pictures
    changed = np.abs(with_others - without).max(axis=-1) > 40
    assert changed.sum() > 1500


def test_figures_draw_without_anything_to_show():
    ground = Ground(EXTENT)
    assert svg_uri(bev.tracks_figure(RIG, ground, []))
    assert svg_uri(bev.conflicts_figure(RIG, ground, [], []))
    assert svg_uri(bev.boxes_figure(RIG, ground, [bev.BoxesInstant(0.0, {"baseline": np.empty((0, 7))})]))
