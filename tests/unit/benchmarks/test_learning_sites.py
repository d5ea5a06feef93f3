"""What the benchmarks of learning train on and compare with: the split's vehicles, and the moments of exposure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.learning_sites import Site, evaluation, views
from tests.site_dataset import LATENESS_NS, PERIOD_NS, boxes_at, tiny_site
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.scene import LabelledInstant, Vehicles3D

#: Of the vehicle that stands.
STANDING = 8


@pytest.fixture
def site(tmp_path: Path) -> Site:
    """Four instants, the first two for training, in which the standing vehicle is left out."""
    tiny = tiny_site(tmp_path)
    times = [instant.time_ns for instant in tiny.instants]
    nobody: dict[str, frozenset[int]] = dict.fromkeys(SUBSETS, frozenset())
    split = Split(
        times_ns={"train": tuple(times[:2]), "val": (), "test": tuple(times[2:])},
        left_out_tracks=nobody | {"train": frozenset({STANDING})},
    )
    labels = LabelTimeline(
        [
            LabelledInstant(
                Vehicles3D.of(time, boxes_at(time), ids=np.arange(2)), {id_: np.ones(2) for id_ in tiny.rig}
            )
            for time in range(-PERIOD_NS, 5 * PERIOD_NS, PERIOD_NS // 4)
        ]
    )
    return Site(1, None, None, {}, tiny.rig, tiny.frames, tiny.instants, tiny.lifts, split, labels)  # type: ignore[arg-type]


def test_vehicles_that_the_split_leaves_out_teach_nothing(site: Site) -> None:
    standing = boxes_at(0)[1]
    for part, teaches in (("train", False), ("test", True)):
        seen = views(site, part, site.lifts, complete=False)
        assert len(seen) == 2 * len(site.rig)
        taught = np.concatenate([view.pseudo_labels.boxes3d for view in seen])
        near = np.hypot(*(taught[:, :2] - standing[:2]).T) < 0.5
        assert near.any() == teaches
        assert (~near).any()


def test_frames_are_compared_with_the_truth_when_they_were_exposed(site: Site) -> None:
    """Detections of where the vehicles are then; a camera is late by 20 ms, at 5 m/s, which is 0.1 m."""
    found = [
        Vehicles3D.of(time, boxes_at(time + LATENESS_NS[id_]), scores=np.full(2, 0.9), camera_id=id_)
        for time in site.split.times_ns["test"]
        for id_ in site.rig
    ]
    assert evaluation(site, found).metrics.ate_m == pytest.approx(np.zeros(2 * len(found)), abs=1e-6)
