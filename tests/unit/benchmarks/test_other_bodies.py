"""Other bodies: meshes fill their published sizes, the z-buffer shows what is nearest, truth agrees with pictures."""

import ast
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import benchmarks.other_bodies as package
from benchmarks.other_bodies.bodies import Piece, axles_m, body
from benchmarks.other_bodies.catalogue import MODELS, BodyModel
from benchmarks.other_bodies.driving import Crossing, drive
from benchmarks.other_bodies.measure import Tally, by_model, figures, of_boxes, of_detections
from benchmarks.other_bodies.raster import rasterise
from benchmarks.other_bodies.record import Plan, record
from wibam_core.formats.labels import read_labels
from wibam_core.geometry.projection import project_boxes
from wibam_core.scene import Boxes2D, FrameKey


def test_nothing_comes_from_the_generator_that_the_networks_learned_from() -> None:
    files = list(Path(package.__file__).parent.glob("*.py"))
    assert len(files) > 5
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not any(name.startswith(("wibam_core.synthetic", "wibam_core.pretraining")) for name in names), file


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_a_body_fills_its_published_size_and_stands_on_its_wheels(model: BodyModel) -> None:
    mesh = body(model)
    own = mesh.points[mesh.pieces != Piece.MIRROR]
    extent = np.array([own[:, 0].max() - own[:, 0].min(), own[:, 1].max() - own[:, 1].min(), own[:, 2].max()])
    np.testing.assert_allclose(extent, [model.length_m, model.width_m, model.height_m], atol=1e-9)
    assert own[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    axles = axles_m(model)
    assert model.length_m / 2 - axles[0] == pytest.approx(model.front_overhang_m)
    assert axles[0] - axles[-1] == pytest.approx(model.wheelbase_m)
    # normals of a closed body look away from its inside: the shell's sides outwards, its roof upwards
    shell = (mesh.pieces == Piece.SHELL) & (mesh.points[:, 2] < 0.5 * model.height_m)
    left = shell & (mesh.points[:, 1] > 0.48 * model.width_m)
    roof = mesh.points[:, 2] > 0.995 * model.height_m
    assert left.any() and (mesh.normals[left, 1] > 0.5).all()
    assert roof.any() and np.median(mesh.normals[roof, 2]) > 0.5


def test_half_of_the_models_are_held_out() -> None:
    held_out = sum(model.held_out for model in MODELS)
    assert abs(held_out - len(MODELS) / 2) <= 1
    assert {model.vehicle_class for model in MODELS if model.held_out} == {m.vehicle_class for m in MODELS}


def test_the_nearer_of_two_triangles_is_seen_and_weights_are_true_in_space() -> None:
    # one triangle whose right corner is three times as far away, another behind it that is larger
    uv = np.array([[2.0, 2.0], [2.0, 18.0], [26.0, 2.0], [0.0, 0.0], [0.0, 30.0], [40.0, 0.0]])
    depth = np.array([2.0, 2.0, 6.0, 50.0, 50.0, 50.0])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    seen = rasterise(uv, depth, faces, (50, 40))
    row, column = np.divmod(seen.at, 50)
    near = (column >= 2) & (row >= 2) & ((column - 2) / 24 + (row - 2) / 16 <= 1)
    np.testing.assert_array_equal(seen.faces, np.where(near, 0, 1))
    assert len(np.unique(seen.at)) == len(seen.at)
    # halfway between the corners in the image a point is nearer to the near corner in space: 1/z is linear, so
    # z = 2 / (1/2 + 1/6) = 3, a quarter of the way from 2 to 6
    (middle,) = np.flatnonzero((row == 2) & (column == 14))
    np.testing.assert_allclose(seen.weights[middle], [0.75, 0.0, 0.25], atol=1e-12)
    assert 1 / seen.inverse_depth[middle] == pytest.approx(3.0)


def test_faces_that_look_away_are_not_seen() -> None:
    uv = np.array([[2.0, 2.0], [2.0, 18.0], [26.0, 2.0]])
    assert not len(rasterise(uv, np.full(3, 2.0), np.array([[0, 2, 1]]), (50, 40)).at)


def test_the_rear_axle_rolls_and_the_front_axle_keeps_to_its_lane() -> None:
    crossing = Crossing((0.0, np.pi / 2, np.pi, -np.pi / 2), 12.0)
    small = tuple(model for model in MODELS if model.length_m < 5)
    vehicles = drive(crossing, small, 15.0, 6.0, np.random.default_rng(3))
    moved = 0
    for vehicle in vehicles:
        poses = np.array(vehicle.poses)
        ahead = vehicle.model.wheelbase_m + vehicle.model.front_overhang_m - vehicle.model.length_m / 2
        heading = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=-1)
        rear = poses[:, :2] - ahead * heading
        step, mean = np.diff(rear, axis=0), heading[1:] + heading[:-1]
        across = (step[:, 1] * mean[:, 0] - step[:, 0] * mean[:, 1]) / 2
        assert np.abs(across).max() < 0.01
        front = rear + vehicle.model.wheelbase_m * heading
        off = np.linalg.norm(front[:, None] - vehicle.path[None], axis=-1).min(axis=1)
        assert off[:-1].max() < 0.27  # points of the path lie 0.5 m apart; the last step may lead beyond them
        moved += len(poses)
    assert len(vehicles) > 10 and moved > 1000


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("other") / "site"
    record(folder, Plan(seed=3, seconds=1.5, fps=2.0, width_px=320, height_px=180, cameras=2))
    return folder


def test_pictures_and_labels_agree(site: Path) -> None:
    plan = Plan(seed=3, seconds=1.5, fps=2.0, width_px=320, height_px=180, cameras=2)
    rig, labels = plan.rig(), {label.vehicles.time_ns: label for label in read_labels(site / "labels.parquet")}
    assert sorted(labels) == plan.times_ns()
    compared = 0
    for row in pq.read_table(site / "truth" / "boxes2d.parquet").to_pylist():
        vehicles = labels[row["time_ns"]].vehicles
        (k,) = np.flatnonzero(vehicles.ids == row["vehicle_id"])
        assert labels[row["time_ns"]].visibility[row["camera_id"]][k] == pytest.approx(row["visibility"])
        if row["visibility"] < 0.9:
            continue
        # the cuboid's image box holds what is seen, but for mirrors, and is not much larger
        (cuboid,) = project_boxes(rig[row["camera_id"]], vehicles.boxes[k : k + 1])
        seen = np.array([row[f"visible_{side}"] for side in ("x0", "y0", "x1", "y1")])
        room = (seen - cuboid) * [1, 1, -1, -1]
        side = (seen[2:] - seen[:2]).max()
        assert (room > -0.06 * side - 1).all() and (room < 0.3 * side + 1).all()
        compared += 1
    assert compared >= 6


def test_what_is_found_and_missed_is_counted_by_model(site: Path) -> None:
    table = pq.read_table(site / "truth" / "boxes2d.parquet").to_pandas()
    sides = [f"visible_{side}" for side in ("x0", "y0", "x1", "y1")]
    clear = table[(table.visibility > 0.6) & ((table.visible_y1 - table.visible_y0) > 13)]
    clear = clear[(clear.visible_x1 - clear.visible_x0) > 13]
    one = clear.iloc[0]
    frame = table[(table.camera_id == one.camera_id) & (table.time_ns == one.time_ns)]
    true = np.array([one[sides].to_numpy(float)])
    elsewhere = np.array([[0.0, 0.0, 3.0, 3.0]])
    boxes = np.concatenate([true, elsewhere])
    unknown = np.full((2, 4), np.nan)
    seen = Boxes2D(boxes, np.ones(2), np.zeros(2, np.int64), unknown, unknown)
    tally = of_detections(site, {FrameKey(one.camera_id, int(one.time_ns)): seen})
    found, asked = tally.recall()
    assert found == 1 and 1 <= asked <= len(frame) and tally.further == 1
    assert sum(int(row["asked"]) for row in by_model(tally)) == asked


def test_true_boxes_are_all_found_and_shifted_ones_are_off_by_their_shift(site: Path) -> None:
    labels = read_labels(site / "labels.parquet")
    shift = np.array([0.3, 0.4, 0, 0, 0, 0, 0])
    tally = of_boxes(site, np.zeros(2), [(v.vehicles.time_ns, v.vehicles.boxes + shift) for v in labels])
    row = figures(tally)
    assert row["recall"] == 1.0 and row["ate_m"] == pytest.approx(0.5) and row["turned_round"] == 0.0
    assert row["asked"] == sum(int(of["asked"]) for of in by_model(tally))  # type: ignore[call-overload]
    assert figures(Tally()) == {"asked": 0, "found": 0, "recall": 0.0, "precision": 0.0}
