"""What is there is not made again: stages that work frame by frame copy from earlier outputs, and nobody sees it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from av.video.frame import VideoFrame
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.builders import look_at
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import MANIFEST, ArtifactReader
from wibam_core.clocks import ClockMap
from wibam_core.config import FramesConfig, PipelineConfig
from wibam_core.detection.boxes import Found
from wibam_core.documents.recordings import Limits, Probe, VideoInfo
from wibam_core.documents.synchronisation import Synchronisation
from wibam_core.errors import NoOverlap
from wibam_core.formats.clocks import Clocks
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import site_camera
from wibam_core.site import Site
from wibam_core.stages import detect, frames
from wibam_core.stages.given import giving
from wibam_core.stages.runner import SiteFolder, run_pipeline
from wibam_core.stages.store import StageStore
from wibam_core.video import decode
from wibam_core.video.encode import VideoWriter
from wibam_core.video.picture import Orientation
from wibam_core.video.recording import Recording

S = 10**9
STEP_NS = S // 25
WIDTH, HEIGHT = 128, 72
FIRST = {"preflight": {"min_overlap_s": 1.0}, "sync": {"method": "none"}}

Files = dict[str, bytes]


def site_of(camera_ids: str) -> Site:
    camera = look_at((20.0, 0.0, 6.0), focal_px=100.0, width_px=WIDTH, height_px=HEIGHT)
    return Site(name="test", cameras=tuple(site_camera(camera_id, camera) for camera_id in camera_ids))


def record(path: Path, first_ns: int) -> Path:
    """4 s of a bright spot that crosses a grey ground."""
    with VideoWriter(path, WIDTH, HEIGHT, 25.0, 10) as writer:
        for number in range(100):
            image = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
            image[30:46, number : number + 20] = 255
            writer.write(image, first_ns + number * STEP_NS)
    return path


@dataclass
class Counted:
    """What was opened for decoding, and how many images were searched."""

    opened: list[str] = field(default_factory=list)
    searched: int = 0
    classes: tuple[RoadUserClass, ...] = (RoadUserClass.CAR,)

    def detect(self, image_bgr: np.ndarray) -> Found:
        self.searched += 1
        rows, columns = np.nonzero(image_bgr[..., 0] > 200)
        box = np.array([[columns.min() - 0.5, rows.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5]])
        return Found(box, np.array([0.75]), np.array([0]))


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    counted = Counted()
    sound = decode._frames

    def opened(recording: Recording, threads: int) -> Iterator[tuple[int, VideoFrame, Orientation]]:
        counted.opened.append(recording.files[0].path.stem)
        yield from sound(recording, threads)

    monkeypatch.setattr(decode, "_frames", opened)
    monkeypatch.setattr(detect, "load_detector", lambda path, **options: counted)
    return counted


@dataclass
class Place:
    """A site of two cameras, its outputs, and a store that has never seen it to compare with."""

    root: Path
    counted: Counted

    def __post_init__(self) -> None:
        self.store = StageStore(self.root / "outputs")
        recordings = {
            "a": Recording.at(record(self.root / "a.mp4", 0)),
            "b": Recording.at(record(self.root / "b.mp4", 3 * STEP_NS)),
        }
        self.folder = SiteFolder(site_of("ab"), recordings, {})

    def clock(self, offset_ns: int) -> None:
        """From now on another clock of camera b is given."""
        root = self.root / f"clock{offset_ns}"
        with giving(root, "sync", {}) as given_:
            given_.write(catalogue.CLOCKS, Clocks({"a": ClockMap(), "b": ClockMap(offset_ns)}))
            empty = Synchronisation(method="none", reference="a", changes={}, groups=[], cameras={})
            given_.write(catalogue.CHANGES, empty)
        self.folder = SiteFolder(self.folder.site, self.folder.recordings, {}, {"sync": root / "given" / "sync"})

    def run(self, store: StageStore | None = None, **options: Mapping[str, object]) -> tuple[Files, list[str], int]:
        """All files of frames and detect, and what was opened and searched for them."""
        self.counted.opened.clear()
        self.counted.searched = 0
        made = run_pipeline(self.folder, store or self.store, PipelineConfig.parse(FIRST | options), until="detect")
        return files_of(made.outputs), sorted(self.counted.opened), self.counted.searched

    def from_nothing(self, **options: Mapping[str, object]) -> Files:
        shutil.rmtree(self.root / "compared", ignore_errors=True)
        return self.run(StageStore(self.root / "compared"), **options)[0]


def files_of(outputs: ArtifactReader) -> Files:
    folders = {stage: outputs.local(artifact).parent for stage, artifact in
               (("frames", catalogue.FRAMES), ("detect", catalogue.DETECTIONS))}  # fmt: skip
    return {
        f"{stage}/{path.relative_to(folder).as_posix()}": path.read_bytes()
        for stage, folder in folders.items()
        for path in folder.rglob("*")
        if path.is_file() and path.name != MANIFEST
    }


@pytest.fixture
def place(tmp_path: Path, counted: Counted) -> Place:
    return Place(tmp_path, counted)


def test_a_lower_rate_reads_and_searches_nothing(place: Place) -> None:
    _, opened, searched = place.run(detect={"refine": "on"})
    assert (opened, searched > 50) == (["a", "b"], True)
    options = {"frames": {"rate_hz": 6.25}, "detect": {"refine": "on", "rate_hz": 3.125}}
    files, *work = place.run(**options)
    assert work == [[], 0]
    assert files == place.from_nothing(**options)


def test_a_higher_rate_searches_only_what_is_new(place: Place) -> None:
    _, _, before = place.run(detect={"refine": "on"})
    options = {"detect": {"refine": "on", "rate_hz": 12.5}}
    files, opened, searched = place.run(**options)
    assert not opened
    assert files == place.from_nothing(**options)
    assert before + searched == place.counted.searched


def test_another_clock_reads_and_searches_only_what_is_new(place: Place) -> None:
    place.run(detect={"refine": "on"})
    place.clock(-STEP_NS)
    files, opened, searched = place.run(detect={"refine": "on"})
    assert opened == ["b"]  # the other frames of a are there
    assert files == place.from_nothing(detect={"refine": "on"})
    assert 0 < searched < place.counted.searched / 2


def test_where_all_frames_are_there_no_clock_reads_or_searches_anything(place: Place) -> None:
    for offset_ns in (-5 * STEP_NS, 5 * STEP_NS):
        place.clock(offset_ns)
        place.run(frames={"rate_hz": 25.0}, detect={"refine": "on", "rate_hz": 25.0})
    for offset_ns in (-STEP_NS, 2 * STEP_NS, 11_000_000):
        place.clock(offset_ns)
        files, *work = place.run(detect={"refine": "on"})
        assert work == [[], 0]
        assert files == place.from_nothing(detect={"refine": "on"})


def test_what_changes_a_frame_makes_all_anew(place: Place) -> None:
    _, opened, searched = place.run(detect={"refine": "off"})
    assert place.run(detect={"refine": "off", "min_score": 0.5})[1:] == ([], searched)
    assert place.run(frames={"width_px": 96}, detect={"refine": "off"})[1:] == (opened, searched)


def remove_images(folder: Path) -> None:
    next(folder.rglob("b.jpegs")).unlink()


def damage_images(folder: Path) -> None:
    path = next(folder.rglob("b.jpegs"))
    content = bytearray(path.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 40] = bytes(40)
    path.write_bytes(content)


def empty_images(folder: Path) -> None:
    next(folder.rglob("b.jpegs")).write_bytes(b"")


def remove_index(folder: Path) -> None:
    next(folder.rglob("frames.parquet")).unlink()


@pytest.mark.parametrize("spoil", [remove_images, damage_images, empty_images, remove_index])
def test_frames_that_are_gone_or_damaged_are_read_again(place: Place, spoil: Callable[[Path], None]) -> None:
    """As they are where somebody removes the outputs at that time."""
    place.run(detect={"refine": "off"})
    (folder,) = place.store.root.glob("frames-*")
    spoil(folder)
    options = {"frames": {"rate_hz": 6.25}, "detect": {"refine": "off"}}
    files, opened, _ = place.run(**options)
    assert "b" in opened
    assert files == place.from_nothing(**options)


@pytest.mark.parametrize("content", [b"", b"PAR1", None])
def test_detections_that_are_gone_or_damaged_are_made_again(place: Place, content: bytes | None) -> None:
    place.run(detect={"refine": "on"})
    (folder,) = place.store.root.glob("detect-*")
    for artifact in (catalogue.DETECTIONS, catalogue.BACKGROUND_DETECTIONS):
        path = folder / artifact.file
        path.unlink()
        if content is not None:
            path.write_bytes(content)
    options = {"detect": {"refine": "on", "rate_hz": 3.125}}
    files, _, searched = place.run(**options)
    assert searched > 0
    assert files == place.from_nothing(**options)


TIMES_NS = tuple(100 + number * 1000 for number in range(60))
CLOCK = st.builds(ClockMap, st.integers(-20_000, 20_000), st.floats(-0.01, 0.01))
RATE = st.sampled_from([1e5, 2.5e5, 5e5, 1e6])  # the recordings have a frame each microsecond


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    damaged=st.sets(st.sampled_from(TIMES_NS), max_size=30),
    runs=st.lists(st.tuples(CLOCK, RATE), min_size=2, max_size=4),
)
def test_law_frames_are_what_they_are_whatever_was_there(
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    damaged: set[int],
    runs: list[tuple[ClockMap, float]],
) -> None:
    """Also where frames are damaged, which only decoding tells."""
    image = VideoFrame.from_ndarray(np.full((16, 16, 3), 90, np.uint8), format="bgr24")
    sound = [(time_ns, image, Orientation()) for time_ns in TIMES_NS if time_ns not in damaged]
    monkeypatch.setattr(decode, "_frames", lambda path, threads: iter(sound))
    root = tmp_path_factory.mktemp("runs")
    earlier: list[ArtifactReader] = []
    for number, (clock, rate_hz) in enumerate(runs):
        made = [
            frames_of(root / f"{number}{kind}", clock, rate_hz, there) for kind, there in (("", earlier), ("n", []))
        ]
        if None in made:
            assert made == [None, None]
        else:
            with_earlier, alone = (files for files, _ in filter(None, made))
            assert with_earlier == alone
            earlier = [reader for _, reader in filter(None, made[:1])] + earlier


def frames_of(
    root: Path, clock: ClockMap, rate_hz: float, earlier: list[ArtifactReader]
) -> tuple[Files, ArtifactReader] | None:
    """The stage's files, and its outputs; None where it finds no frames in common."""
    folders = StageFolders(root)
    info = VideoInfo(codec="h264", container="mov", width_px=16, height_px=16, rotation_deg=0, fps=1e6,
                     frames=60, missing_frames=0, first_ns=TIMES_NS[0], last_ns=TIMES_NS[-1], duration_s=6e-5,
                     largest_gap_s=1e-6, variable_rate=False)  # fmt: skip
    folders.give(catalogue.PROBE, Probe(cameras={"a": info, "b": info}))
    folders.give(catalogue.TIMESTAMPS, dict.fromkeys("ab", np.array(TIMES_NS)))
    folders.give(catalogue.LIMITS, Limits(min_overlap_s=0.0))
    folders.give(catalogue.CLOCKS, Clocks({"a": ClockMap(), "b": clock}))
    context = folders.context("frames", site_of("ab"), dict.fromkeys("ab", root), earlier=earlier)
    try:
        frames.run(context, FramesConfig.model_construct(rate_hz=rate_hz, width_px=960, jpeg_quality=92))
    except NoOverlap:
        return None
    place = folders.place(catalogue.FRAMES)
    return {path.name: path.read_bytes() for path in place.iterdir()}, folders.reader
