"""The catalogue of road users: what every entry must hold, and that an entry is all that a new class needs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.unit.test_howtos import steps
from wibam_core.errors import InputError
from wibam_core.formats.annotations import read_annotations
from wibam_core.formats.tracks import read_tracks
from wibam_core.formats.vehicles3d import read_vehicles3d
from wibam_core.models.taught import TAUGHT
from wibam_core.road_users import BODIES, CLASSES, LOG_SIZE_MEAN, RoadUserClass
from wibam_core.traits import ForeignName

ROOT = Path(__file__).resolve().parents[2]
VOCABULARIES = ("coco", "nuscenes", "kitti", "openlabel", "levelx")


def test_numbers_are_places_in_the_catalogue_and_names_find_them() -> None:
    assert [road_user.number for road_user in CLASSES] == list(range(len(CLASSES)))
    assert all(RoadUserClass(road_user.value) is road_user for road_user in CLASSES)
    assert CLASSES[: len(TAUGHT)] == TAUGHT  # a channel of a network that ships is the number of its class
    assert [str(road_user) for road_user in TAUGHT] == ["car", "van", "truck", "bus"]


@pytest.mark.parametrize("road_user", CLASSES)
def test_a_body_fills_its_box_and_is_the_same_on_both_sides(road_user: RoadUserClass) -> None:
    body = BODIES[road_user.number]
    assert np.abs(body).max() <= 0.5
    assert body[:, 0].max() == 0.5 and body[:, 0].min() == -0.5
    assert body[:, 1].max() >= 0.49
    assert body[:, 2].max() == 0.5 and body[:, 2].min() == -0.5
    mirrored = {tuple(point) for point in (body * [1, -1, 1]).round(9).tolist()}
    assert mirrored == {tuple(point) for point in body.round(9).tolist()}


@pytest.mark.parametrize("vocabulary", VOCABULARIES)
def test_no_name_elsewhere_means_two_classes(vocabulary: str) -> None:
    names: list[ForeignName] = [getattr(c.traits.elsewhere, vocabulary) for c in CLASSES]
    read = Counter(name for one in names for name in one.read)
    assert max(read.values()) == 1
    for one in names:
        assert one.written is None or one.written in read or not one.read


def test_colours_are_all_different() -> None:
    assert len({road_user.traits.colour for road_user in CLASSES}) == len(CLASSES)


def test_convention_sizes_are_length_width_height() -> None:
    sizes = np.exp(LOG_SIZE_MEAN)
    assert (sizes[:, 0] > sizes[:, 1]).all()
    assert sizes[RoadUserClass.PEDESTRIAN.number].argmax() == 2


#: The entry that the how-to writes, at the end of the catalogue.
TRAM = next(steps(ROOT / "docs" / "howto" / "class.md")).code

#: Runs before anything else of the project is imported, with the catalogue's source and the entry.
PATCH = """
import sys, types
from pathlib import Path
import wibam_core
path = Path(wibam_core.__file__).parent / "road_users.py"
source = path.read_text(encoding="utf-8")
end = source.index("\\n\\nCLASSES: ")
module = types.ModuleType("wibam_core.road_users")
module.__file__ = str(path)
sys.modules["wibam_core.road_users"] = wibam_core.road_users = module
exec(compile(source[:end] + ENTRY + source[end:], str(path), "exec"), module.__dict__)
"""

CHECKS = """
import numpy as np
from tests import multiview
from tests.builders import corner_rig
from wibam_core.association.associate import associate
from wibam_core.config import AssociateConfig, LiftConfig, SafetyConfig, TrackConfig
from wibam_core.detection.yolox import YoloxDetector
from wibam_core.exchange.names import classes_by_name
from wibam_core.formats.annotations import read_annotations, write_annotations
from wibam_core.formats.tracks import read_tracks, write_tracks
from wibam_core.formats.vehicles3d import read_vehicles3d, write_vehicles3d
from wibam_core.lifting.lift import lift
from wibam_core.report.bev import Ground, tracks_figure
from wibam_core.report.mosaic import Extent
from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.safety.conflicts import find_conflicts
from wibam_core.tracking.tracker import Tracker

tram = RoadUserClass("tram")
assert CLASSES[-1] is tram
assert tram in YoloxDetector.classes
assert classes_by_name(lambda names: names.kitti)["Tram"] is tram

multiview.SIZES[tram] = (19.0, 2.5, 3.4)
size = np.array(multiview.SIZES[tram])
body = multiview.body(tram, size, np.random.default_rng(0))
times = np.arange(0, 20, 0.5)
actor = multiview.Actor(tram, size, body, np.array([[-30.0, -3.0], [60.0, -3.0]]), times, 10.5 + 6.0 * times)
scene = multiview.record(corner_rig(), [actor], duration_s=5.0, rate_hz=6.25, class_error=0.0, false_rate=0.0)

found = associate(scene.unassociated, scene.rig, AssociateConfig())
assert {v.vehicle_class for instant in found for v in instant.vehicles} == {tram}
write_annotations(folder / "annotations.parquet", found)
again = read_annotations(folder / "annotations.parquet")
assert [v for instant in again for v in instant.vehicles] == [v for instant in found for v in instant.vehicles]

fits = lift(again, scene.rig, LiftConfig()).vehicles
assert sum(map(len, fits)) > 20 and all((f.classes == tram.number).all() for f in fits)
write_vehicles3d(folder / "lifts.parquet", fits)
assert [f.classes.tolist() for f in read_vehicles3d(folder / "lifts.parquet")] == [f.classes.tolist() for f in fits]

tracker = Tracker(TrackConfig())
for fit in fits:
    tracker.step(fit.time_ns, [fit])
write_tracks(folder / "tracks.parquet", tracker.tracks())
(track,) = read_tracks(folder / "tracks.parquet")
assert track.vehicle_class is tram
assert abs(np.median(track.velocities_mps[:, 0]) - 6.0) < 0.5
assert find_conflicts([track], SafetyConfig()) == []
figure = tracks_figure(scene.rig, Ground(Extent(-40, 40, -40, 40)), [track])
assert "tram" in [text.get_text() for legend in figure.legends for text in legend.get_texts()]
print("tram", len(track))
"""


#: What the files that ship say of a picture, as arrays.
OLD_FILES = """
import cv2, numpy as np
from tests.builders import corner_rig
from wibam_core.detection.background import StillBackground
from wibam_core.detection.detector import BUNDLED, load_detector
from wibam_core.detection.edge_refiner import EdgeRefiner
from wibam_core.models.frames import Frame
from wibam_core.models.network import predict
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import load_to_detect
from wibam_core.synthetic.sampling import sample_views

(view,) = sample_views(41, "site", 1, (640, 360))
found = load_detector(BUNDLED, min_score=0.3, nms_iou=0.6).detect(view.image)
background = StillBackground(view.still, np.full(view.image.shape[:2], 255, np.uint8))
refined = EdgeRefiner().refine(view.image, background, found, nms_iou=0.6, classify=True)
network = load_to_detect(bundled("mono_small.safetensors"))
(placed,) = predict(network, [Frame(view.image, view.camera, "a", 0)], decode="ground", min_score=0.3)
assert len(found.boxes) and len(placed)
np.savez(
    folder / name,
    *found,
    *(refined.boxes, refined.classes, refined.amodal_boxes, refined.amodal_sd),
    *(placed.boxes, placed.classes, placed.scores, placed.sd),
)
"""


def in_a_process_with(entry: str, checks: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """What a process says in which the catalogue has one entry more, and nothing else is changed."""
    given = f"from pathlib import Path\nfolder = Path({str(folder)!r})\nENTRY = {entry!r}\n"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, "-c", given + PATCH + checks],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def after(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a version to which a class was added, in a folder; all that it takes is done with it there."""
    folder = tmp_path_factory.mktemp("tram")
    done = in_a_process_with(TRAM, CHECKS, folder)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.startswith("tram")
    return folder


def test_a_class_is_added_by_its_entry_alone(after: Path) -> None:
    assert sorted(path.name for path in after.iterdir()) == ["annotations.parquet", "lifts.parquet", "tracks.parquet"]


@pytest.mark.parametrize(
    ("name", "read"),
    [("annotations", read_annotations), ("lifts", read_vehicles3d), ("tracks", read_tracks)],
)
def test_a_file_with_a_class_that_this_version_lacks_is_refused_saying_so(
    after: Path, name: str, read: Callable[[Path], object]
) -> None:
    with pytest.raises(InputError, match="'tram' is no class of road users") as caught:
        read(after / f"{name}.parquet")
    assert "car, van, truck" in str(caught.value.hint)


def test_networks_that_were_made_before_a_class_was_added_give_equal_boxes(tmp_path: Path) -> None:
    for name, entry in (("before", ""), ("after", TRAM)):
        done = in_a_process_with(entry, f"name = '{name}.npz'\n{OLD_FILES}", tmp_path)
        assert done.returncode == 0, done.stderr[-3000:]
    before, after = np.load(tmp_path / "before.npz"), np.load(tmp_path / "after.npz")
    assert sorted(before) == sorted(after)
    for name in before:
        np.testing.assert_array_equal(before[name], after[name])
