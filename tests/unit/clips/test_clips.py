"""Clips show who passes the filter, where they are, in the plan and in the views, and when."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from tests.clips import LATER_NS, outputs
from tests.finished import tracks
from wibam_core.adapters.track_query import TrackQuery, query_tracks
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.clips.layout import arrange
from wibam_core.clips.render import ClipRenderer
from wibam_core.clips.selection import moments
from wibam_core.documents.clips import ClipSpec
from wibam_core.errors import Conflict, InputError
from wibam_core.geometry.projection import project_boxes
from wibam_core.report.style import bgr
from wibam_core.road_users import RoadUserClass
from wibam_core.video.seeking import frames_from

Image = np.ndarray


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ArtifactReader:
    return outputs(tmp_path_factory.mktemp("outputs"))


def spec(start_s: float = 0.0, end_s: float = 5.0, **values: Any) -> ClipSpec:
    times = {"start_ns": round(start_s * 1e9), "end_ns": round(end_s * 1e9)}
    return ClipSpec(**{**times, "width_px": 800, "trail_s": 0.0, **values})


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"classes": (RoadUserClass.BUS,)},
        {"min_speed_mps": 5.0},
        {"start_s": 1.0, "end_s": 2.0},
        {"polygon": ((5.5, -2.0), (30.0, -2.0), (30.0, 8.0), (12.25, 8.0))},
        {"classes": (RoadUserClass.PEDESTRIAN,)},
    ],
)
def test_a_clip_shows_whom_the_api_answers(made: ArtifactReader, values: dict[str, Any]) -> None:
    wanted = spec(**values)
    query = TrackQuery(
        start_ns=wanted.start_ns,
        end_ns=wanted.end_ns,
        polygon=wanted.polygon,
        classes=wanted.classes,
        min_speed_mps=wanted.min_speed_mps,
    )
    with query_tracks(made.local(catalogue.TRACKS), query) as batches:
        answered = {(row["time_ns"], row["track_id"]) for row in batches.read_all().to_pylist()}
    shown = {(moment.time_ns, track.track_id) for moment in moments(tracks(), wanted) for track in moment.tracks}
    assert shown == answered


@pytest.mark.parametrize(
    "values", [{"end_s": 0.0}, {"end_s": 1801.0}, {"polygon": ((0, 0), (1, 1))}, {"width_px": 10}, {"speed": 0}]
)
def test_what_cannot_be_is_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        spec(**values)


@pytest.mark.parametrize("cameras", range(1, 13))
def test_panels_fill_the_picture_and_none_covers_another(cameras: int) -> None:
    layout = arrange(1600, cameras, 16 / 9)
    covered = np.zeros((layout.height_px, layout.width_px), int)
    for panel in (layout.plan, layout.strip, *layout.views):
        covered[panel.y_px : panel.y_px + panel.height_px, panel.x_px : panel.x_px + panel.width_px] += 1
        assert panel.width_px > 60 and panel.height_px > 30
    assert covered.max() == 1
    assert len(layout.views) == cameras
    assert (layout.width_px % 2, layout.height_px % 2) == (0, 0)
    for view in layout.views:
        assert view.width_px / view.height_px == pytest.approx(16 / 9, rel=0.02)


def of_colour(image: Image, colour: str) -> Image:
    """(N, 2) pixels (u, v) of about a colour."""
    near = np.abs(image.astype(int) - np.array(bgr(colour))).max(axis=2) < 12
    return np.argwhere(near)[:, ::-1]


def test_the_plan_is_to_scale_and_x_points_right(made: ArtifactReader) -> None:
    """The car drives 10 m along X in 1 s, after the conflict; the bus is 12 m long and stands."""
    clip = ClipRenderer(made, spec(3.1, 4.15, boxes=False))
    panel = arrange(800, 2, 640 / 360).plan
    first, last = (clip.frame(clip.moments[number])[: panel.height_px, : panel.width_px] for number in (0, 10))
    car, bus = RoadUserClass.CAR.traits.colour, RoadUserClass.BUS.traits.colour
    moved = of_colour(last, car).mean(axis=0) - of_colour(first, car).mean(axis=0)
    length_px = np.ptp(of_colour(first, bus)[:, 0])
    assert moved[0] / length_px == pytest.approx(10 / 12, rel=0.08)
    assert abs(moved[1]) < 2
    assert of_colour(first, bus)[:, 1].mean() < of_colour(first, car)[:, 1].mean(), "Y points up: the bus is at y = 5"


@pytest.mark.parametrize(("camera", "later_ns"), [("cam1", 0), ("cam2", LATER_NS)])
def test_boxes_are_where_the_camera_saw_them_when_it_exposed(made: ArtifactReader, camera: str, later_ns: int) -> None:
    layout = arrange(800, 2, 640 / 360)
    panel = layout.views[int(camera[-1]) - 1]
    pictures = []
    for boxes in (True, False):
        clip = ClipRenderer(made, spec(1.0, 1.05, boxes=boxes, classes=(RoadUserClass.CAR,)))
        whole = clip.frame(clip.moments[0])
        pictures.append(whole[panel.y_px :, panel.x_px :][: panel.height_px, : panel.width_px].astype(int))
    drawn = np.argwhere(np.abs(pictures[0] - pictures[1]).max(axis=2) > 20)[:, ::-1]
    seen = made.read(catalogue.RIG)[camera].resized(panel.width_px, panel.height_px)
    car = tracks()[0].boxes[10].copy()
    car[0] += 10.0 * later_ns / 1e9
    [expected] = project_boxes(seen, car[None])
    np.testing.assert_allclose([*drawn.min(axis=0), *drawn.max(axis=0)], expected, atol=2.5)


def test_the_video_has_the_instants_at_their_times(made: ArtifactReader, tmp_path: Path) -> None:
    told: list[float] = []
    facts = ClipRenderer(made, spec(0.95, 2.0, speed=2.0, trail_s=2.0)).render(
        tmp_path / "clip.mp4", lambda fraction, message="", **_: told.append(fraction)
    )
    assert (facts.frames, facts.first_ns, facts.last_ns, facts.road_users) == (10, 10**9, 19 * 10**8, 2)
    assert told[-1] == 1.0 and told == sorted(told)
    read = list(frames_from(tmp_path / "clip.mp4", 0))
    assert [round(time_ns / 1e6) for time_ns, _ in read] == [50 * number for number in range(10)]
    assert read[0][1].shape == (facts.height_px, facts.width_px, 3)


def test_the_same_clip_is_the_same_file(made: ArtifactReader, tmp_path: Path) -> None:
    for name in ("a", "b"):
        ClipRenderer(made, spec(0.0, 0.5)).render(tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_conflicts_are_marked_while_they_happen(made: ArtifactReader) -> None:
    def alert(at_s: float) -> int:
        clip = ClipRenderer(made, spec(at_s, at_s + 0.05, boxes=False))
        panel = arrange(800, 2, 640 / 360).plan
        image = clip.frame(clip.moments[0])[: panel.height_px, : panel.width_px]
        return int((np.abs(image.astype(int) - (40, 40, 200)).max(axis=2) < 10).sum())

    assert alert(2.0) > 100
    assert alert(3.5) == 0


def test_nothing_to_show_is_said(made: ArtifactReader) -> None:
    with pytest.raises(InputError, match="nothing was tracked"):
        ClipRenderer(made, spec(60.0, 70.0))
    without = ArtifactReader({"refine": made.local(catalogue.RIG).parent})
    with pytest.raises(Conflict, match="no frames yet"):
        ClipRenderer(without, spec())
