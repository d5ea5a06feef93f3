"""The published data set's layout, written from a simulated site, becomes a site that is trained and evaluated on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.calibration.rig import calibrate
from wibam_core.cli.app import app
from wibam_core.config import CalibrateConfig
from wibam_core.errors import InputError, NotFound, SiteFileError
from wibam_core.exchange.base import Content
from wibam_core.exchange.wibam.dataset import WibamDataset
from wibam_core.formats.labels import read_labels
from wibam_core.geometry.projection import project_boxes
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, LabelledInstant, MultiViewVehicle
from wibam_core.stages.given import given_stages
from wibam_core.stages.importing import import_site
from wibam_core.stages.runner import SiteFolder
from wibam_core.stages.store import StageStore
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import record_site
from wibam_core.video.decode import decode

PERIOD_NS = 80_000_000
#: Vehicles of which less is seen are not detected.
SEEN = 0.4
OPTIONS = SimulationOptions(
    seed=3,
    cameras=3,
    seconds=4,
    width_px=320,
    height_px=180,
    traffic_density=2,
    max_offset_s=0,
    max_drift_ppm=0,
    drop_rate=0,
)
RUN = ["--set", "finetune.method=paper", "--set", "finetune.steps=2", "--set", "finetune.batch_size=2"]


def annotated(truth: LabelledInstant, rig: CameraRig) -> AnnotatedInstant:
    """What a perfect detector sees of the truth, put together without an error."""
    vehicles = truth.vehicles
    detections: dict[str, Detections2D] = {}
    views: dict[int, dict[str, int]] = {}
    for camera_id, camera in rig.items():
        share = truth.visibility.get(camera_id, np.zeros(len(vehicles)))
        boxes = project_boxes(camera, vehicles.boxes)
        seen = np.flatnonzero((np.asarray(share) >= SEEN) & np.isfinite(boxes).all(axis=1))
        detections[camera_id] = Detections2D(
            camera_id, vehicles.time_ns, boxes[seen], np.full(len(seen), 0.9), vehicles.classes[seen]
        )
        for i, number in enumerate(seen.tolist()):
            views.setdefault(number, {})[camera_id] = i
    together = tuple(
        MultiViewVehicle(number, -1, CLASSES[vehicles.classes[number]], *vehicles.boxes[number, :2].tolist(), seen_by)
        for number, seen_by in sorted(views.items())
    )
    return AnnotatedInstant(vehicles.time_ns, detections, together)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated site as a data set of the published layout: train 24, val 8, test 8 instants."""
    folder = tmp_path_factory.mktemp("dataset")
    site = record_site(folder / "simulated", OPTIONS)
    rig, _ = calibrate(site, CalibrateConfig())
    labels = read_labels(folder / "simulated" / "labels.parquet")[:40]
    frames = {
        (camera_id, (number + 1) * PERIOD_NS): image
        for camera_id in rig
        for number, (_, image) in enumerate(decode(next((folder / "simulated" / "recordings").glob(f"{camera_id}.*"))))
    }
    times = [instant.vehicles.time_ns for instant in labels]
    assert np.diff(times).tolist() == [PERIOD_NS] * 39

    def jpeg(camera_id: str, frame_time_ns: int) -> bytes:
        return cv2.imencode(".jpg", frames[camera_id, frame_time_ns])[1].tobytes()

    content = Content(
        site=site,
        rig=rig,
        instants=[annotated(truth, rig) for truth in labels],
        labels=labels[::2],  # every other instant by hand
        jpeg=jpeg,
        splits={"train": times[:24], "val": times[24:32], "test": times[32:]},
    )
    list(WibamDataset().write(content, folder))
    return folder / "wibam"


@pytest.fixture(scope="module")
def site_dir(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("imported") / "site"
    done = CliRunner().invoke(app, ["import", "wibam-dataset", str(dataset), str(folder)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "hand labels are read with rot in radians, location in the middle of the bottom" in done.output.replace(
        "\n", " "
    )
    return folder


def outputs(site_dir: Path) -> ArtifactReader:
    return ArtifactReader(given_stages(site_dir))


# --- what is imported --------------------------------------------------------------------------
def test_frames_are_the_data_set_s_own_files(dataset: Path, site_dir: Path) -> None:
    frames = outputs(site_dir).read(catalogue.FRAMES)
    assert frames.camera_ids == ("0", "1", "2")
    assert len(frames) == 40
    first = frames.frame_sets[0].time_ns
    expected = cv2.imread(str(dataset / "frames" / "1" / f"{first // PERIOD_NS}.jpg"))
    np.testing.assert_array_equal(frames.image("1", first), expected)


def test_vehicles_keep_their_boxes_and_are_followed_over_time(dataset: Path, site_dir: Path) -> None:
    published = WibamDataset().read(dataset).instants or ()
    imported = outputs(site_dir).read(catalogue.ANNOTATIONS)
    for a, b in zip(imported, published, strict=True):
        assert [(v.obj_id, v.views) for v in a.vehicles] == [(v.obj_id, v.views) for v in b.vehicles]
    tracks = [v.track_id for instant in imported for v in instant.vehicles]
    assert sum(track >= 0 for track in tracks) > 0.9 * len(tracks)


def test_the_split_is_the_published_one(site_dir: Path) -> None:
    split = outputs(site_dir).read(catalogue.SPLIT)
    assert {name: len(times) for name, times in split.times_ns.items()} == {"train": 24, "val": 8, "test": 8}
    assert not any(split.left_out_tracks.values())


# --- what is run -------------------------------------------------------------------------------
def run(site_dir: Path, *arguments: str) -> str:
    done = CliRunner().invoke(app, ["run", str(site_dir), *RUN, *arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def test_a_dry_run_says_which_stages_are_given(site_dir: Path) -> None:
    lines = [line.split() for line in run(site_dir, "--dry-run").splitlines()]
    given = [" ".join(words[1:]) for words in lines if words[0] == "given"]
    assert given == [
        "Check the recordings",
        "Synchronise the cameras",
        "Read the frames",
        "Detect vehicles in 2D",
        "Find, fit, teach, and find again",
        "Refine the calibration by the traffic",
        "Associate views and link over time",
        "Split in time",
    ]


def test_the_published_method_is_trained_and_evaluated_on_the_hand_labels(dataset: Path, site_dir: Path) -> None:
    output = run(site_dir, "--until", "evaluate")
    assert output.count("given") >= 8
    made = {path.name.split("-")[0]: path for path in (site_dir / "outputs").glob("*-*")}
    assert set(made) == {"calibrate", "lift", "finetune", "predict", "evaluate"}
    metrics = ArtifactReader(made).read(catalogue.METRICS)
    assert metrics.labels == "hand"
    assert metrics.labelled_instants.given == 20
    assert metrics.labelled_instants.in_test_part == 4
    labelled = [i for i in WibamDataset().read(dataset).labels or () if i.vehicles.time_ns >= 33 * PERIOD_NS]
    assert len(labelled) == 4
    expected = counted(labelled, ArtifactReader(made).read(catalogue.CALIBRATED_RIG))
    assert metrics.finetuned is not None and expected > 10
    assert metrics.finetuned.matched + metrics.finetuned.missed == expected


def counted(labels: Sequence[LabelledInstant], rig: CameraRig) -> int:
    """Sightings that count by default, from the labels themselves: seen well and near enough, in each camera."""
    total = 0
    for instant in labels:
        for camera_id, camera in rig.items():
            distance = np.hypot(*(instant.vehicles.boxes[:, :2] - camera.centre_m[:2]).T)
            share = np.asarray(instant.visibility[camera_id])
            total += int(((share > 0.3) & (distance <= 50)).sum())
    return total


def test_fits_are_made_of_the_imported_vehicles(site_dir: Path) -> None:
    run(site_dir, "--until", "lift")
    (folder,) = (site_dir / "outputs").glob("lift-*")
    fits = {f.time_ns: f for f in ArtifactReader({"lift": folder}).read(catalogue.FITS)}
    assert sum(len(f) for f in fits.values()) > 100
    for instant in outputs(site_dir).read(catalogue.ANNOTATIONS):
        places = {v.track_id: (v.x_m, v.y_m) for v in instant.vehicles}
        fitted = fits[instant.time_ns]
        for track_id, box in zip(fitted.ids.tolist(), fitted.boxes, strict=True):
            assert np.hypot(*(box[:2] - places[track_id])) < 8


def test_what_is_given_has_the_address_of_its_content(site_dir: Path, tmp_path: Path) -> None:
    folder = SiteFolder.load(site_dir)
    before = folder.digests()
    split = site_dir / "given" / "dataset" / "split.json"
    original = split.read_text()
    try:
        split.write_text(original.replace("}", " }", 1))
        assert SiteFolder.load(site_dir).digests().given["dataset"] != before.given["dataset"]
    finally:
        split.write_text(original)
    assert SiteFolder.load(site_dir).digests() == before


# --- what is refused ---------------------------------------------------------------------------
def test_a_given_stage_that_lacks_a_file_or_a_name_is_refused(site_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "given" / "detect").mkdir(parents=True)
    with pytest.raises(SiteFileError, match=r"given/detect is given, but lacks detections\.parquet"):
        given_stages(tmp_path)
    (tmp_path / "given" / "detect").rename(tmp_path / "given" / "guess")
    with pytest.raises(SiteFileError, match="there is no stage 'guess'"):
        given_stages(tmp_path)


def test_a_site_without_given_stages_needs_its_recordings(site_dir: Path, tmp_path: Path) -> None:
    assert given_stages(tmp_path) == {}
    (tmp_path / "site.json").write_text((site_dir / "site.json").read_text())
    with pytest.raises(InputError, match="there is no recording of camera 0"):
        SiteFolder.load(tmp_path)


def test_a_folder_that_holds_something_is_not_written_into(dataset: Path, site_dir: Path) -> None:
    with pytest.raises(InputError, match="is not empty"):
        import_site(WibamDataset().read(dataset), site_dir)


def test_a_data_set_without_frames_or_split_is_refused(dataset: Path, tmp_path: Path) -> None:
    content = WibamDataset().read(dataset)
    with pytest.raises(InputError, match="without frames, the val part of the split"):
        import_site(replace(content, jpeg=None, splits={**content.splits, "val": []}), tmp_path / "site")


@pytest.mark.parametrize(
    ("image", "problem"),
    [
        (b"", r"0/1\.jpg is damaged"),
        (b"JFIF", r"0/1\.jpg is damaged"),
        (None, "is 64x64 px, but its camera is calibrated for"),
    ],
)
def test_a_damaged_or_resized_frame_is_refused_and_nothing_is_left(
    dataset: Path, tmp_path: Path, image: bytes | None, problem: str
) -> None:
    content = WibamDataset().read(dataset)
    data = cv2.imencode(".jpg", np.zeros((64, 64, 3), np.uint8))[1].tobytes() if image is None else image
    with pytest.raises(InputError, match=problem):
        import_site(replace(content, jpeg=lambda camera_id, time_ns: data), tmp_path / "site")
    assert not (tmp_path / "site").exists()


def test_a_format_that_no_site_can_be_made_of_is_refused() -> None:
    with pytest.raises(NotFound) as refused:
        CliRunner().invoke(app, ["import", "coco", "a", "b"], catch_exceptions=False)
    assert "wibam-dataset" in refused.value.hint


def test_the_store_is_not_told_of_what_is_given(site_dir: Path) -> None:
    run(site_dir, "--until", "lift")
    assert {stage for stage, _ in StageStore(site_dir / "outputs").addresses()}.isdisjoint(given_stages(site_dir))
