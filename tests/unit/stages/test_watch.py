"""The stages of a run: footage in files and with gaps, minute by minute. The network is replaced by an oracle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.builders import corner_rig, site_of
from tests.recordings import write_recording
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.clocks import ClockMap
from wibam_core.config import PipelineConfig
from wibam_core.documents.watching import Watched
from wibam_core.errors import InputError
from wibam_core.formats.usual import Found, Usual, write_usual
from wibam_core.job_kind import JobKind
from wibam_core.models.frames import Frame
from wibam_core.models.weights import bundled
from wibam_core.networks.small.onnx_network import OnnxNetwork
from wibam_core.scene import Track, Vehicles3D
from wibam_core.stages import watch
from wibam_core.stages.footage import CameraFootage, Footage
from wibam_core.stages.runner import SiteFolder, StageUpdate, run_pipeline
from wibam_core.stages.store import StageStore
from wibam_core.video.probe import probe
from wibam_core.video.recording import Recording, RecordingFile

RIG = corner_rig(2)
SITE = site_of(RIG)
BEGIN_NS = 1_782_885_600_000_000_000
S = 1_000_000_000
OPTIONS = {"sync": {"method": "none"}, "track": {"rate_hz": 2.5}, "preflight": {"min_overlap_s": 1.0}}


def truth(time_ns: int) -> np.ndarray:
    """One vehicle that goes round and round, and one that stands."""
    angle = 0.4 * time_ns * 1e-9
    driving = [12 * np.cos(angle), 12 * np.sin(angle), 0.75, 4.5, 1.8, 1.5, angle + np.pi / 2]
    return np.array([driving, [3.0, 5.0, 0.75, 4.2, 1.8, 1.5, 1.2]])


def oracle(
    network: Any, frames: Iterable[Frame], *, decodes: Sequence[str], min_score: float
) -> Iterator[tuple[Vehicles3D, ...]]:
    for frame in frames:
        assert frame.image.shape == (360, 640, 3)
        boxes = truth(frame.time_ns - BEGIN_NS)
        yield (Vehicles3D.of(frame.time_ns, boxes, scores=np.full(2, 0.9), camera_id=frame.camera_id),)


@pytest.fixture(autouse=True)
def _oracle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(OnnxNetwork, "predict_each", oracle)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty seconds of noise, 2.5 frames a second."""
    folder = tmp_path_factory.mktemp("video")
    return write_recording(folder / "noise.mp4", width_px=640, height_px=360, seconds=20.0, fps=2.5)


class Runs:
    """Runs of the same site in one store."""

    def __init__(self, root: Path, video: Path) -> None:
        self.root, self.video = root, video
        self.warnings: list[str] = []

    def files(self, *starts_s: float) -> Recording:
        return Recording(
            tuple(
                RecordingFile(self.video, f"{n}.mp4", BEGIN_NS + round(start * S)) for n, start in enumerate(starts_s)
            )
        )

    def run(self, recordings: dict[str, Recording], **assets: Path) -> ArtifactReader:
        cameras = tuple(camera for camera in SITE.cameras if camera.id in recordings)
        folder = SiteFolder(
            SITE.model_copy(update={"cameras": cameras}),
            recordings,
            {"model": bundled("mono_small.safetensors"), **assets},
        )

        def listen(update: StageUpdate) -> None:
            if update.state == "succeeded":
                self.warnings += [warning.code for warning in update.warnings]

        store = StageStore(self.root / "stages")
        return run_pipeline(folder, store, PipelineConfig.parse(OPTIONS), listen, kind=JobKind.RUN).outputs


@pytest.fixture
def runs(tmp_path: Path, video: Path) -> Runs:
    return Runs(tmp_path, video)


def read(outputs: ArtifactReader) -> tuple[list[Track], Watched]:
    return outputs.read(catalogue.TRACKS), outputs.read(catalogue.WATCHED)


def test_files_of_a_camera_are_one_piece_of_footage_on_unix_time(runs: Runs) -> None:
    tracks, watched = read(runs.run({"cam1": runs.files(20.0, 0.0, 90.0)}))
    assert watched.dated
    assert (watched.start_ns, watched.end_ns) == (BEGIN_NS, BEGIN_NS + 109_600_000_000)
    camera = watched.cameras["cam1"]
    assert [(stretch.from_ns - BEGIN_NS, stretch.to_ns - BEGIN_NS) for stretch in camera.gaps] == [
        (39_600_000_000, 90 * S)
    ]
    assert camera.images == watched.instants == 150
    assert (camera.boxes, camera.score) == (300, pytest.approx(0.9))
    before = [track for track in tracks if track.times_ns[0] < BEGIN_NS + 60 * S]
    assert len(tracks) == 4
    assert len(before) == 2, "each is one track over the joint of the files; none bridges the gap"
    for track in before:
        assert len(track) == 100
        true = np.array([truth(int(time_ns) - BEGIN_NS)[:, :2] for time_ns in track.times_ns])
        off = np.abs(track.boxes[:, None, :2] - true).max(axis=(0, 2))
        assert off.min() < 0.5, "it is one of the two all along"
    assert runs.warnings == ["recording_gap", "few_pictures"]


def test_a_camera_that_was_off_does_not_blind_the_other(runs: Runs) -> None:
    errors = runs.root / "conflicts.json"
    errors.write_text('{"thresholds": {}, "conflicts": [], "track_errors": {"along": 1.7, "along_s": 0.6}}')
    outputs = runs.run({"cam1": runs.files(0.0, 20.0), "cam2": runs.files(0.0)}, track_errors=errors)
    tracks, watched = read(outputs)
    assert watched.instants == 100
    assert {name: camera.images for name, camera in watched.cameras.items()} == {"cam1": 100, "cam2": 50}
    assert [len(track) for track in tracks] == [100, 100]
    conflicts = outputs.read(catalogue.CONFLICTS)
    assert conflicts.track_errors is not None
    assert conflicts.track_errors["along"] == 1.7
    assert conflicts.exposure is not None
    assert conflicts.exposure.hours == pytest.approx(40 / 3600, rel=0.02)


def test_the_next_run_goes_on_with_the_same_ids(runs: Runs) -> None:
    first = runs.run({"cam1": runs.files(0.0)})
    second = runs.run({"cam1": runs.files(20.0)}, open_tracks=first.local(catalogue.OPEN_TRACKS))
    (before, _), (after, watched) = read(first), read(second)
    assert watched.continued
    assert watched.missed_before is None
    assert [track.track_id for track in before] == [track.track_id for track in after] == [0, 1]
    whole, _ = read(runs.run({"cam1": runs.files(0.0, 20.0)}))
    for track in whole:
        parts = [next(t for t in of_run if t.track_id == track.track_id) for of_run in (before, after)]
        np.testing.assert_array_equal(np.concatenate([part.times_ns for part in parts]), track.times_ns)
    _, later = read(runs.run({"cam1": runs.files(90.0)}, open_tracks=first.local(catalogue.OPEN_TRACKS)))
    assert later.missed_before is not None
    missed = [(ns - BEGIN_NS) / S for ns in (later.missed_before.from_ns, later.missed_before.to_ns)]
    assert missed == [19.6, 90.0]
    with pytest.raises(InputError, match="does not hold tracks to go on with"):
        runs.run({"cam1": runs.files(20.0)}, open_tracks=runs.video)


def test_a_run_that_was_killed_goes_on_after_the_last_minute_and_ends_the_same(
    runs: Runs, monkeypatch: pytest.MonkeyPatch
) -> None:
    footage = {"cam1": runs.files(0.0, 20.0, 40.0, 60.0)}
    expected = runs.run(footage)
    other = Runs(runs.root / "other", runs.video)
    searched: list[int] = []
    keep = watch._Watch._keep

    def killed(self: Any, tracks: Sequence[Track]) -> None:
        keep(self, tracks)
        raise KeyboardInterrupt

    def counting(*args: Any, **options: Any) -> Iterator[tuple[Vehicles3D, ...]]:
        for found in oracle(*args, **options):
            searched.append(found[0].time_ns)
            yield found

    monkeypatch.setattr(OnnxNetwork, "predict_each", counting)
    monkeypatch.setattr(watch._Watch, "_keep", killed)
    with pytest.raises(KeyboardInterrupt):
        other.run(footage)
    monkeypatch.setattr(watch._Watch, "_keep", keep)
    outputs = other.run(footage)
    assert len(searched) == len(set(searched)) == 200, "no frame is searched twice"
    for artifact in (catalogue.TRACKS, catalogue.WATCHED, catalogue.CONFLICTS):
        assert outputs.local(artifact).read_bytes() == expected.local(artifact).read_bytes()


def test_what_is_unusual_is_said(runs: Runs) -> None:
    usual = runs.root / "usual.npz"
    write_usual(usual, Usual({"cam1": np.full((360, 640), 90, np.uint8)}, {"cam1": Found(100, 1000, 1.0)}))
    _, watched = read(runs.run({"cam1": runs.files(0.0)}, usual=usual))
    assert runs.warnings == ["few_pictures", "background_unlike", "scores_fell"]
    assert watched.turns == []
    assert watched.cameras["cam1"].usual_score == pytest.approx(1.0)


def test_a_run_without_its_network_does_not_begin(runs: Runs, tmp_path: Path) -> None:
    nothing = tmp_path / "model"
    nothing.write_bytes(b"")
    with pytest.raises(InputError):
        runs.run({"cam1": runs.files(0.0)}, model=nothing)


@pytest.mark.parametrize("after_ns", [400_000_000, 900_000_000, 1_700_000_000])
def test_a_slow_camera_shows_each_frame_once_wherever_a_run_goes_on(video: Path, after_ns: int) -> None:
    # 2.5 frames a second at 10 instants a second: the frame that one instant showed is the nearest to the next as well
    camera = CameraFootage("cam1", Recording.at(video), probe(video), ClockMap())

    def shown(after: int | None) -> list[tuple[int, int]]:
        frames = Footage({"cam1": camera}, 10.0, RIG, after).frames()
        some = [(f.instant_ns, f.exposed_ns) for f in islice(frames, 12)]
        frames.close()  # type: ignore[attr-defined]
        return some

    whole = shown(None)
    rest = [row for row in whole if row[0] > after_ns]
    assert shown(after_ns)[: len(rest)] == rest
