"""Pictures of wide lenses against pinhole renderings of the same scene."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from wibam_core.artifacts.catalogue import CALIBRATED_RIG, DETECTIONS, FRAMES
from wibam_core.calibration.views import cut_view
from wibam_core.config import PipelineConfig
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.labels import read_labels
from wibam_core.formats.rig import read_rig
from wibam_core.geometry.camera import Camera
from wibam_core.site import Lens, Site, ViewDirection
from wibam_core.stages.runner import SiteFolder, run_pipeline
from wibam_core.stages.store import StageStore
from wibam_core.synthetic.cameras import look
from wibam_core.synthetic.layout import PHASES, make_layout
from wibam_core.synthetic.lighting import sample_lighting
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import record_site
from wibam_core.synthetic.render import Renderer
from wibam_core.synthetic.routes import make_routes
from wibam_core.synthetic.sampling import sample_moment
from wibam_core.synthetic.wide import WideRenderer, with_lens

LAYOUT = make_layout(5)
SIGNALS = dict.fromkeys(PHASES, "red")


def pole(lens: Lens) -> Camera:
    """A camera at a corner of the crossing that looks at its middle."""
    corner = LAYOUT.corner_points()[0] * 1.15
    K = np.array([[300.0, 0, 319.5], [0, 300.0, 219.5], [0, 0, 1]])
    heading = float(np.arctan2(-corner[1], -corner[0]))
    pinhole = Camera(K, np.zeros(0), look(np.append(corner, 8.0), heading, -0.45), 640, 440)
    return with_lens(pinhole, lens, np.random.default_rng(0))


@pytest.mark.parametrize("lens", ["fisheye", "omnidirectional"])
def test_a_view_that_is_cut_from_a_wide_picture_looks_as_a_pinhole_rendering(lens: Lens) -> None:
    camera = pole(lens)
    models, boxes = sample_moment(LAYOUT, make_routes(LAYOUT), np.random.default_rng(4))
    lighting = sample_lighting(np.random.default_rng(2))
    wide = WideRenderer(LAYOUT, lighting, camera).draw(models, boxes, SIGNALS)
    forward = camera.T_world_cam.rotation[:, 2]
    azimuth = float(np.degrees(np.arctan2(forward[1], forward[0])))
    view = cut_view(camera, ViewDirection(azimuth_deg=azimuth + 20, down_deg=25, across_deg=60, height_deg=40), "v")
    straight = Renderer(LAYOUT, lighting, view.camera(camera)).draw(models, boxes, SIGNALS)
    cut = view.cutter(camera).cut(wide.image)
    # half a pixel of blur makes up for the wide picture's being resampled twice
    difference = np.abs(cv2.blur(cut, (5, 5)).astype(float) - cv2.blur(straight.image, (5, 5)))
    assert np.median(difference) < 3
    assert np.percentile(difference, 95) < 25


def test_truth_of_a_wide_picture_holds_what_is_painted() -> None:
    camera = pole("fisheye")
    models, boxes = sample_moment(LAYOUT, make_routes(LAYOUT), np.random.default_rng(4))
    drawn = WideRenderer(LAYOUT, sample_lighting(np.random.default_rng(2)), camera).draw(models, boxes, SIGNALS)
    seen = np.flatnonzero(drawn.visibility > 0)
    assert len(seen) >= 5
    for i in seen:
        v, u = np.nonzero(drawn.ids == i + 1)
        x0, y0, x1, y1 = drawn.amodal_boxes[i]
        assert x0 - 1.5 <= u.min() and u.max() <= x1 + 1.5 and y0 - 1.5 <= v.min() and v.max() <= y1 + 1.5
        np.testing.assert_allclose(drawn.visible_boxes[i], [u.min(), v.min(), u.max(), v.max()], atol=1.5)
    clear = drawn.visibility > 0.999
    inside = (drawn.amodal_boxes[:, :2] > 0).all(axis=1) & (drawn.amodal_boxes[:, 2:] < [638, 438]).all(axis=1)
    assert (clear & inside).any()
    # what nothing hides is seen to all its sides
    np.testing.assert_allclose(drawn.visible_boxes[clear & inside], drawn.amodal_boxes[clear & inside], atol=2.0)
    assert (drawn.visibility[~drawn.in_view] == 0).all()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Site]:
    folder = tmp_path_factory.mktemp("wide")
    options = SimulationOptions(
        seed=3, lens="fisheye", cameras=2, seconds=2.0, fps=5.0, width_px=480, height_px=270, drop_rate=0.0
    )
    return folder, record_site(folder, options)


def test_a_recorded_site_says_what_its_lenses_are(recorded: tuple[Path, Site]) -> None:
    folder, site = recorded
    assert all(camera.is_wide and camera.signals for camera in site.cameras)
    assert Site.load(folder / "site.json") == site
    rig = read_rig(folder / "truth" / "rig.json")
    assert {camera.lens for camera in rig.mounted.values()} == {"fisheye"}
    rows = pq.read_table(folder / "truth" / "boxes2d.parquet").to_pylist()
    assert max(row["visibility"] for row in rows) == pytest.approx(1.0)
    assert any(
        (seen > 0).any() for label in read_labels(folder / "labels.parquet") for seen in label.visibility.values()
    )


def test_its_views_go_through_frames_and_detection(recorded: tuple[Path, Site], tmp_path: Path) -> None:
    folder, _ = recorded
    config = PipelineConfig.parse(
        {
            "preflight": {"min_overlap_s": 0.5},
            "sync": {"method": "none"},
            "frames": {"rate_hz": 5.0},
            "detect": {"rate_hz": 2.5, "refine": "off", "min_score": 0.1},
        }
    )
    store = StageStore(tmp_path)
    result = run_pipeline(SiteFolder.load(folder), store, config, until="detect")
    rig, frames = result.outputs.read(CALIBRATED_RIG), result.outputs.read(FRAMES)
    assert isinstance(frames, FrameStore)
    views = [view.id for of_camera in rig.views.values() for view in of_camera]
    assert sorted(frames.camera_ids) == sorted(views)
    for view_id in views:
        assert frames.native_size(view_id) == rig[view_id].size_px
        assert len(frames.stored_ns(view_id)) >= 5
    assert {frame.camera_id for frame in result.outputs.read(DETECTIONS)} == set(views)
