"""The stages' own part: which frames, at which times, into which files. The network is replaced by an oracle."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.builders import corner_rig, site_of
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.config import EvaluateConfig, PipelineConfig, TrackConfig
from wibam_core.documents.metrics import Metrics, Reliability
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.errors import TooFewInstants
from wibam_core.evaluation.metrics import METRICS
from wibam_core.formats.framestore import FrameStoreWriter
from wibam_core.formats.labels import write_labels
from wibam_core.geometry.projection import project_boxes
from wibam_core.models.frames import Frame
from wibam_core.networks.registry import save_network
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.small.network import CARD, SmallMonocular
from wibam_core.networks.small.onnx_network import OnnxNetwork
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import AnnotatedInstant, Detections2D, LabelledInstant, MultiViewVehicle, Track, Vehicles3D
from wibam_core.stages import evaluate, predict, track
from wibam_core.stages.base import Summary

RIG = corner_rig(2)
PERIOD_NS = 80_000_000
INSTANTS = [k * PERIOD_NS for k in range(26)]
TEST = INSTANTS[16:]
#: The cameras expose after and before the instant; at 12 m/s that is 0.4 m.
LATE_NS = {"cam1": 35_000_000, "cam2": -30_000_000}


def truth(time_ns: int) -> np.ndarray:
    """One vehicle that drives and one that stands."""
    return np.array([[-12 + 12 * time_ns * 1e-9, -2, 0.75, 4.5, 1.8, 1.5, 0.0], [3.0, 5.0, 0.75, 4.2, 1.8, 1.5, 1.2]])


def oracle(network: Any, frames: Iterable[Frame], *, decode: str, min_score: float, **_: Any) -> Iterator[Vehicles3D]:
    """What stands in each frame when it is exposed, larger by a tenth under depth decoding."""
    for frame in frames:
        boxes = truth(frame.time_ns + LATE_NS[frame.camera_id])
        if decode == "depth":
            boxes[:, 3] *= 1.1
        assert frame.image[0, 0, 0] == pytest.approx(frame.time_ns // PERIOD_NS * 9, abs=4)
        yield Vehicles3D.of(frame.time_ns, boxes, scores=np.full(2, 0.9), camera_id=frame.camera_id)


def each(predict: Callable[..., Iterator[Vehicles3D]]) -> Callable[..., Iterator[tuple[Vehicles3D, ...]]]:
    """Several ways to place boxes from one: `predict_each` of a `predict`."""

    def placed(
        network: Any, frames: Iterable[Frame], *, decodes: Sequence[str], **options: Any
    ) -> Iterator[tuple[Vehicles3D, ...]]:
        seen = list(frames)
        return zip(*(predict(network, seen, decode=decode, **options) for decode in decodes), strict=True)

    return placed


class Job(StageFolders):
    """The stages up to fine-tuning, and the hand labels."""

    labels: Path | None

    def predict(self, **of_tracking: float) -> Summary:
        options = PipelineConfig(track=TrackConfig(**of_tracking))
        return predict.run(self.context("predict", site_of(RIG)), options.predict)

    def evaluate(self) -> tuple[Summary, Metrics]:
        self.predict()
        assets = {} if self.labels is None else {"labels": self.labels}
        summary = evaluate.run(self.context("evaluate", site_of(RIG), assets=assets), EvaluateConfig())
        return summary, self.read(catalogue.METRICS)

    def track(self, **options: float) -> tuple[Summary, list[Track]]:
        self.predict(**options)
        summary = track.run(self.context("track", site_of(RIG)), TrackConfig(**options))
        return summary, self.read(catalogue.TRACKS)

    def split(self, train: Sequence[int], test: Sequence[int]) -> None:
        nobody: dict[str, frozenset[int]] = dict.fromkeys(SUBSETS, frozenset())
        times: dict[str, tuple[int, ...]] = {"train": tuple(train), "val": (), "test": tuple(test)}
        self.give(catalogue.SPLIT, Split(times_ns=times, left_out_tracks=nobody))

    def finetuned(self, **said: Any) -> None:
        """Weights whose card says this; placed by the plane unless it says otherwise."""
        network = SmallMonocular(SmallNetwork(), CARD.model_copy(update=said))
        save_network(network, self.place(catalogue.WEIGHTS))


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Job:
    job = Job(tmp_path)
    job.give(catalogue.RIG, RIG)
    writer = FrameStoreWriter(job.place(catalogue.FRAMES), 95)
    for k, time in enumerate(INSTANTS):
        for camera_id in RIG:
            writer.add(camera_id, time, time + LATE_NS[camera_id], np.full((36, 64, 3), 9 * k, np.uint8))
    writer.close()
    annotated = []
    for time in INSTANTS:
        detections = {
            id_: Detections2D(id_, time, project_boxes(camera, truth(time)), np.ones(2), np.zeros(2, int))
            for id_, camera in RIG.items()
        }
        vehicles = tuple(MultiViewVehicle(i, i, RoadUserClass.CAR, 0.0, 0.0, dict.fromkeys(RIG, i)) for i in range(2))
        annotated.append(AnnotatedInstant(time, detections, vehicles))
    job.give(catalogue.ANNOTATIONS, annotated)
    job.split(INSTANTS[:10], TEST)
    job.finetuned()
    job.labels = tmp_path / "labels"  # without a suffix, as an uploaded file may be stored
    write_labels(
        job.labels,
        [
            LabelledInstant(Vehicles3D.of(time, truth(time), ids=np.array([1, 2])), {id_: np.ones(2) for id_ in RIG})
            for time in [*INSTANTS, INSTANTS[-1] + PERIOD_NS]
        ],
    )
    monkeypatch.setattr(OnnxNetwork, "predict_each", each(oracle))
    return job


def test_frames_are_compared_with_labels_at_the_time_they_were_exposed(job: Job) -> None:
    summary, metrics = job.evaluate()
    for figures in (metrics.baseline, metrics.finetuned):
        assert figures is not None
        assert figures.ate_m.mean == pytest.approx(0, abs=1e-6)
        assert figures.bev_iou.mean == pytest.approx(1)
        assert figures.recall.mean == 1
        assert (figures.matched, figures.missed) == (2 * len(TEST) * 2, 0)
    assert metrics.baseline_depth is not None
    assert metrics.baseline_depth.ase.mean == pytest.approx(1 - 1 / 1.1)
    assert metrics.baseline_plane is None  # it is the baseline: the fine-tuned network's boxes are placed so
    assert metrics.labels == summary["labels"] == "hand"
    assert metrics.paper_compat is not None and metrics.significance is not None and metrics.reliability is not None
    assert metrics.paper_compat["finetuned"].iou_3d.mean == pytest.approx(0.75)
    assert set(metrics.significance) == set(METRICS)
    for by in (metrics.by_visibility, metrics.by_distance, metrics.by_elevation, metrics.by_class):
        assert by is not None
        assert sum(part.matched for part in by["finetuned"]) == 2 * len(TEST) * 2
    assert metrics.reliability["finetuned"]["yaw"] == Reliability(count=0)  # the oracle states no standard deviations
    # the other view's box was not moved to this view's time: the honest share of the difference stays
    agreement = metrics.self_consistency["finetuned"].other_views.mean
    assert agreement is not None and 0.8 < agreement < 1


@pytest.mark.parametrize("decode", ["refined", "depth"])
def test_the_baseline_is_placed_as_the_finetuned_network_is(job: Job, decode: str) -> None:
    job.finetuned(decode=decode)
    _, metrics = job.evaluate()
    longer = pytest.approx(1 - 1 / 1.1)
    published = {f"baseline_{how}": how for how in ("plane", "depth") if how != decode}
    expected = {"baseline": decode, **published, "finetuned": decode}
    there = {name for name in ("baseline_plane", "baseline_depth") if getattr(metrics, name) is not None}
    assert there == published.keys()
    assert metrics.paper_compat is not None
    for name, how in expected.items():
        assert getattr(metrics, name).ase.mean == (longer if how == "depth" else pytest.approx(0, abs=1e-6)), name
        assert name in metrics.paper_compat and name in metrics.self_consistency


def test_the_baseline_is_the_network_before_fine_tuning(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    def better_once_tuned(network: Any, frames: Iterable[Frame], **options: Any) -> Iterator[Vehicles3D]:
        for found in oracle(network, frames, **options):
            off_m = 0.0 if network.card.method == "lifted" else 0.5
            yield replace(found, boxes=found.boxes + [off_m, 0, 0, 0, 0, 0, 0])

    monkeypatch.setattr(OnnxNetwork, "predict_each", each(better_once_tuned))
    job.finetuned(method="lifted")
    _, metrics = job.evaluate()
    assert metrics.baseline is not None and metrics.finetuned is not None
    assert metrics.baseline.ate_m.mean == pytest.approx(0.5)
    assert metrics.finetuned.ate_m.mean == pytest.approx(0.0, abs=1e-6)


def test_significance_compares_boxes_that_are_placed_alike(job: Job) -> None:
    """Both networks say the same; boxes of the baseline that are placed by depth are longer."""
    _, metrics = job.evaluate()
    assert metrics.baseline_depth is not None and metrics.baseline_depth.ase.mean > 0.05
    assert metrics.significance is not None
    for name in ("bev_iou", "iou_3d", "ate_m", "ase"):
        assert metrics.significance[name].difference == pytest.approx(0.0, abs=1e-9), name


def test_the_baseline_sees_images_as_wide_as_the_fine_tuned_network(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def watched(network: Any, frames: Iterable[Frame], **options: Any) -> Iterator[tuple[Vehicles3D, ...]]:
        seen.append(network.card.input_width_px)
        return each(oracle)(network, frames, **options)

    monkeypatch.setattr(OnnxNetwork, "predict_each", watched)
    job.finetuned(input_width_px=960)
    job.evaluate()
    assert seen == [960] * 3  # the fine-tuned one in the test part, and in the rest


def test_standard_deviations_are_multiplied_as_the_validation_part_says(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors of 0.5 m are stated as 0.1 m, and the factor of 3 does not make up for all of it."""

    def unsure(network: Any, frames: Iterable[Frame], **options: Any) -> Iterator[Vehicles3D]:
        for number, found in enumerate(oracle(network, frames, **options)):
            boxes = found.boxes + [0.5 * (-1) ** number, 0.5, 0, 0, 0, 0, 0]
            yield replace(found, boxes=boxes, sd=np.full_like(boxes, 0.1))

    monkeypatch.setattr(OnnxNetwork, "predict_each", each(unsure))
    job.finetuned(sd_factors={"position": 3.0, "yaw": 2.0})
    _, metrics = job.evaluate()
    assert metrics.sd_factors == {"position": 3.0, "z": 1.0, "size": 1.0, "yaw": 2.0}
    assert metrics.reliability is not None
    learned, calibrated, baseline = (
        metrics.reliability[name]["position"].scale_factor for name in ("finetuned_as_learned", "finetuned", "baseline")
    )
    assert calibrated is not None
    assert learned == pytest.approx(baseline)
    assert learned == pytest.approx(3 * calibrated)
    kept = job.read(catalogue.PREDICTIONS_FINETUNED)
    np.testing.assert_allclose(kept[0].sd[0], [0.3, 0.3, 0.1, 0.1, 0.1, 0.1, 0.2])
    _, wide = job.track()
    job.finetuned()
    _, narrow = job.track()
    assert np.median(wide[0].sd[:, 0]) > np.median(narrow[0].sd[:, 0])


def test_predictions_are_kept_at_the_instants_of_the_test_part_alone(job: Job) -> None:
    job.evaluate()
    for artifact in (catalogue.PREDICTIONS_BASELINE, catalogue.PREDICTIONS_FINETUNED):
        kept = job.read(artifact)
        assert {v.time_ns for v in kept} == set(TEST)
        assert {v.camera_id for v in kept} == set(RIG)


def test_without_labels_the_views_are_compared_with_each_other_alone(job: Job) -> None:
    job.labels = None
    summary, metrics = job.evaluate()
    assert metrics.labels == summary["labels"] == "none"
    assert metrics.finetuned is metrics.significance is metrics.by_distance is None
    assert metrics.self_consistency["finetuned"].pairs > 0


def test_labels_of_another_part_of_the_recording_count_as_none(job: Job, tmp_path: Path) -> None:
    job.labels = tmp_path / "early.json"
    write_labels(job.labels, [LabelledInstant(Vehicles3D.of(0, truth(0)), {"cam1": np.ones(2)})])
    summary, metrics = job.evaluate()
    assert summary["labels"] == "none"
    assert (metrics.labelled_instants.given, metrics.labelled_instants.in_test_part) == (1, 0)
    assert metrics.labelled_instants.test_from_s == pytest.approx(TEST[0] * 1e-9)


def test_labels_between_the_instants_of_the_split_are_used(job: Job, tmp_path: Path) -> None:
    """Somebody labelled once in 0.64 s, always two frames after the split's instants, which are 0.4 s apart."""
    split = INSTANTS[10::5]
    job.split([], split)
    times = INSTANTS[12::8]
    job.labels = tmp_path / "sparse.json"
    sparse = [LabelledInstant(Vehicles3D.of(t, truth(t)), {id_: np.ones(2) for id_ in RIG}) for t in times]
    write_labels(job.labels, sparse)
    summary, metrics = job.evaluate()
    assert summary["labels"] == "hand"
    assert (metrics.labelled_instants.given, metrics.labelled_instants.in_test_part) == (2, 2)
    assert metrics.finetuned is not None and metrics.finetuned.matched == 2 * 2 * len(RIG)
    assert {v.time_ns for v in job.read(catalogue.PREDICTIONS_FINETUNED)} == {*split, *times}


def test_a_network_that_was_trained_on_a_gpu_is_used_without_one(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    job.finetuned(device="cuda")
    assert job.evaluate()[0]["labels"] == "hand"
    assert job.track()[0]["tracks"] == 2


def test_an_empty_test_part_is_too_few_instants(job: Job) -> None:
    job.split(INSTANTS, [])
    with pytest.raises(TooFewInstants):
        job.evaluate()


def test_tracks_are_at_the_instants_although_frames_are_not(job: Job) -> None:
    summary, tracks = job.track(rate_hz=6.25)
    assert summary == {"tracks": 2, "instants": 13, "by_class": {"car": 2}}
    (driving,) = (t for t in tracks if np.hypot(*t.velocities_mps[-1]) > 5)
    assert driving.times_ns.tolist() == INSTANTS[::2]
    want = np.array([truth(t)[0, 0] for t in INSTANTS[::2]])
    np.testing.assert_allclose(driving.boxes[3:, 0], want[3:], atol=0.15)
    assert driving.velocities_mps[-1] == pytest.approx([12, 0], abs=0.3)


def test_the_tracker_is_told_when_each_frame_was_exposed(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    """With one camera that is late by 35 ms, a vehicle at 12 m/s is 0.42 m farther than where it is tracked."""

    def of_the_late_camera(network: Any, frames: Iterable[Frame], **options: Any) -> Iterator[Vehicles3D]:
        for found in oracle(network, frames, **options):
            yield found if found.camera_id == "cam1" else found.where(np.zeros(2, bool))

    monkeypatch.setattr(OnnxNetwork, "predict_each", each(of_the_late_camera))
    _, tracks = job.track(rate_hz=6.25)
    (driving,) = (t for t in tracks if np.hypot(*t.velocities_mps[-1]) > 5)
    want = np.array([truth(time_ns)[0, 0] for time_ns in driving.times_ns.tolist()])
    errors_m = driving.boxes[5:, 0] - want[5:]
    assert abs(errors_m.mean()) < 0.05  # an exposure time left out moves all of them alike
    assert np.abs(errors_m).max() < 0.15


def test_the_fine_tuned_network_sees_each_image_once_for_evaluation_and_tracking(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[int, str]] = []

    def watched(network: Any, frames: Iterable[Frame], **options: Any) -> Iterator[tuple[Vehicles3D, ...]]:
        read = list(frames)
        if network.card.method is not None:
            seen.extend((frame.time_ns, frame.camera_id) for frame in read)
        return each(oracle)(network, read, **options)

    monkeypatch.setattr(OnnxNetwork, "predict_each", watched)
    job.finetuned(method="lifted")
    _, metrics = job.evaluate()
    track.run(job.context("track", site_of(RIG)), TrackConfig())
    wanted = {*TEST, *INSTANTS[::2]}
    assert metrics.finetuned is not None and metrics.finetuned.matched > 0
    assert sorted(seen) == sorted((time_ns, camera_id) for time_ns in wanted for camera_id in RIG)


def test_new_labels_search_the_instants_that_they_add_and_no_others(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job.split([], INSTANTS[10::5])
    job.finetuned(method="lifted")
    job.predict()
    seen: set[int] = set()

    def watched(network: Any, frames: Iterable[Frame], **options: Any) -> Iterator[tuple[Vehicles3D, ...]]:
        read = list(frames)
        if network.card.method is not None:
            seen.update(frame.time_ns for frame in read)
        return each(oracle)(network, read, **options)

    monkeypatch.setattr(OnnxNetwork, "predict_each", watched)
    labelled = LabelledInstant(Vehicles3D.of(INSTANTS[17], truth(INSTANTS[17])), {id_: np.ones(2) for id_ in RIG})
    write_labels(tmp_path / "one", [labelled])
    assets = {"labels": tmp_path / "one"}
    evaluate.run(job.context("evaluate", site_of(RIG), assets=assets), EvaluateConfig())
    assert seen == {INSTANTS[17]}
    figures = job.read(catalogue.METRICS).finetuned
    assert figures is not None and figures.matched == 2 * len(RIG)


def test_what_is_too_weak_to_be_tracked_is_kept_for_the_evaluation(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def one_weak(network: Any, frames: Iterable[Frame], *, min_score: float, **options: Any) -> Iterator[Vehicles3D]:
        asked.append(min_score)
        for found in oracle(network, frames, min_score=min_score, **options):
            yield replace(found, scores=np.array([0.9, 0.2]))

    monkeypatch.setattr(OnnxNetwork, "predict_each", each(one_weak))
    job.evaluate()
    assert asked.count(0.3) == 1 and asked.count(0.1) == len(asked) - 1  # weak ones are found in the test part alone
    assert all(len(found) == 2 for found in job.read(catalogue.PREDICTIONS_FINETUNED))
    assert track.run(job.context("track", site_of(RIG)), TrackConfig())["tracks"] == 1
    job.predict(min_score=0.05)
    assert asked[-2:] == [0.05, 0.05]
