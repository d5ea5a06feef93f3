from __future__ import annotations

import numpy as np
import pytest

from benchmarks.real_headings import document, sightings
from benchmarks.real_labels import Area
from tests.builders import look_at
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import CameraRig, Track, Vehicles3D

#: 10 m above the ground at the origin.
RIG = CameraRig({"cam1": look_at((0.0, 0.0, 10.0), (20.0, 0.0, 0.0))})
AREA = Area(np.array([[-40.0, -20.0], [40.0, -20.0], [40.0, 20.0], [-40.0, 20.0]]))


def standing(x_m: float, y_m: float, yaw_rad: float) -> Track:
    box = [x_m, y_m, 0.75, 4.4, 1.8, 1.5, yaw_rad]
    return Track(
        1,
        RoadUserClass.CAR,
        np.array([0, 10**9]),
        np.array([box, box]),
        np.full((2, 7), 0.1),
        np.zeros((2, 2)),
        np.zeros(2),
    )


def test_errors_of_headings_by_how_steeply_their_tracks_are_seen() -> None:
    """Seen from 45° and 26.6° above; the third is farther than one camera is asked for, the fourth out of the area."""
    tracks = [standing(*of) for of in ((10.0, 0.0, 0.1), (0.0, 20.0, 3.1), (36.0, 0.0, 0.0), (0.0, 25.0, 0.0))]
    boxes = np.array([track.boxes[0] for track in tracks])
    boxes[:, :2] += 0.5
    boxes[:, 6] = [0.2, -3.1, 1.0, 1.0]
    found = Vehicles3D.of(500_000_000, boxes, camera_id="cam1")
    (seen,) = sightings([found], tracks, RIG, AREA)
    assert seen[:, 0] == pytest.approx([45.0, 26.57], abs=0.01)
    assert seen[:, 1] == pytest.approx(np.degrees([0.1, 2 * np.pi - 6.2]), abs=1e-6)


def test_the_table_counts_what_is_turned() -> None:
    table = document(np.array([[10.0, 2.0], [45.0, 4.0], [45.0, 60.0], [45.0, 170.0], [90.0, 1.0]]))
    assert "| 0 to 20° | 1 | 2.0 (2.0) | 0.000 | 0.000 |" in table
    assert "| 40 to 50° | 3 | 78.0 (60.0) | 0.667 | 0.333 |" in table
    assert "| 20 to 30°" not in table
