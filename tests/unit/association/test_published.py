from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.builders import corner_rig, site_of
from tests.multiview import crossing
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.association.published import agreement_of, clustered_as_published, dp_means
from wibam_core.config import AssociateConfig
from wibam_core.documents.refinement import Refinement
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, Detections2D, MultiViewVehicle
from wibam_core.stages import associate as stage

CONFIG = AssociateConfig()


def car(x_m: float, y_m: float) -> list[float]:
    return [x_m, y_m, 0.75, 4.4, 1.8, 1.5, 0.3]


def test_points_farther_than_the_radius_from_every_mean_open_a_cluster() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [10.0, 0.0], [10.0, 2.0], [40.0, 0.0]])
    assert dp_means(points, 3.0).tolist() in ([0, 0, 1, 1, 2], [1, 1, 0, 0, 2], [1, 1, 2, 2, 0])
    assert len(set(dp_means(points, 0.4).tolist())) == 5
    assert set(dp_means(points, 100.0).tolist()) == {0}
    assert dp_means(np.empty((0, 2)), 3.0).tolist() == []


def test_each_mean_is_within_the_radius_of_its_points_and_each_point_at_its_nearest_mean() -> None:
    points = np.random.default_rng(3).uniform(-30, 30, (60, 2))
    labels = dp_means(points, 6.0)
    means = np.array([points[labels == k].mean(axis=0) for k in range(labels.max() + 1)])
    distance = np.linalg.norm(points[:, None] - means, axis=2)
    assert (distance.argmin(axis=1) == labels).all()
    assert distance.min(axis=1).max() <= 6.0


def test_of_several_boxes_of_one_camera_in_a_cluster_one_is_the_vehicles_and_none_is_lost() -> None:
    rig = corner_rig(2)
    both = project_boxes(rig["cam1"], np.array([car(1.0, 2.0), car(2.6, 2.0)]))
    one = project_boxes(rig["cam2"], np.array([car(1.0, 2.0)]))
    instant = AnnotatedInstant(
        0,
        {
            "cam1": Detections2D("cam1", 0, both, np.array([0.9, 0.8]), np.zeros(2, np.int64)),
            "cam2": Detections2D("cam2", 0, one, np.array([0.9]), np.zeros(1, np.int64)),
        },
    )
    (found,) = clustered_as_published([instant], rig, CONFIG)
    views = sorted((dict(vehicle.views) for vehicle in found.vehicles), key=len)
    assert [len(view) for view in views] == [1, 2]
    assert sorted(row for view in views for name, row in view.items() if name == "cam1") == [0, 1]


def test_agreement_counts_pairs() -> None:
    def instant(*views: dict[str, int]) -> AnnotatedInstant:
        vehicles = (MultiViewVehicle(k, -1, RoadUserClass.CAR, 0.0, 0.0, view) for k, view in enumerate(views))
        return AnnotatedInstant(0, {}, tuple(vehicles))

    ours = [instant({"a": 0, "b": 0, "c": 0}, {"a": 1, "b": 1})]
    published = [instant({"a": 0, "b": 0}, {"c": 0}, {"a": 1, "b": 2})]
    found = agreement_of(ours, published)
    assert (found.tracked_pairs, found.paper_pairs, found.both) == (4, 2, 1)


def test_the_stage_associates_either_way_and_counts_both(tmp_path: Path) -> None:
    folders, scene = StageFolders(tmp_path), crossing()
    folders.give(catalogue.RIG, scene.rig)
    folders.give(catalogue.REFINEMENT, Refinement(method="none", taken=False, reason="it is exact"))
    folders.give_detected(scene.unassociated)
    counts = {}
    for method in ("tracked", "paper"):
        stage.run(folders.context("associate", site_of()), AssociateConfig.model_validate({"method": method}))
        counts[method] = folders.read(catalogue.ASSOCIATION_STATISTICS)
        assert counts[method].method == method
    assert counts["tracked"].agreement == counts["paper"].agreement is not None
    found = counts["paper"].agreement
    assert 0 < found.both <= min(found.tracked_pairs, found.paper_pairs)
    pairs = {"2": 1, "3": 3, "4": 6}
    for method, expected in (("tracked", found.tracked_pairs), ("paper", found.paper_pairs)):
        assert sum(pairs[views] * n for views, n in counts[method].by_views.items()) == expected
    assert counts["paper"].tracks > 0
