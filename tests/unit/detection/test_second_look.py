"""The second half of detection, on rendered frames of one fixed camera."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from wibam_core.config import DetectConfig
from wibam_core.detection import second_look
from wibam_core.detection.background import BackgroundFrames, StillBackground, still_background
from wibam_core.detection.boxes import Found
from wibam_core.detection.edge_refiner import EdgeRefiner
from wibam_core.detection.second_look import background_frames, look_again
from wibam_core.formats.framestore import FrameStore, FrameStoreWriter
from wibam_core.progress import Progress, silent
from wibam_core.scene import Boxes2D, FrameKey
from wibam_core.synthetic.cameras import site_cameras
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.lighting import develop, sample_lighting, sample_photometry
from wibam_core.synthetic.render import Renderer
from wibam_core.synthetic.routes import make_routes
from wibam_core.synthetic.sampling import sample_moment

S = 10**9
SIZE, NATIVE = (640, 360), (1280, 720)


@dataclass
class Recorded:
    """Frames at half the recording's size, wrong boxes in the recording's pixels, and the right ones."""

    store: FrameStore
    seen: dict[FrameKey, Boxes2D]
    truth: dict[FrameKey, np.ndarray]

    @property
    def frames(self) -> list[FrameKey]:
        return sorted(self.seen)

    def shown(self, block_s: float = 120.0) -> dict[str, BackgroundFrames]:
        times_ns = self.store.stored_ns("a")
        return {"a": BackgroundFrames(times_ns, times_ns, block_s)}

    def refined(self, progress: Progress = silent, block_s: float = 120.0, **options: str) -> dict[FrameKey, Boxes2D]:
        config = DetectConfig(**options)
        return dict(look_again(self.store, self.frames, self.seen, not_asked, self.shown(block_s), config, progress))

    def background(self) -> StillBackground:
        there = background_frames(self.frames, self.shown())
        boxes = [self.store.to_stored_px("a", self.seen[frame].boxes) for frame in there]
        return still_background([self.store.image_at(*frame) for frame in there], boxes)


def not_asked(frame: FrameKey, image: np.ndarray) -> Boxes2D:
    raise AssertionError(f"{frame} was looked at before")


def some(boxes: np.ndarray, kind: int = 0) -> Boxes2D:
    count = len(boxes)
    unknown = np.full((count, 4), np.nan)
    return Boxes2D(boxes.reshape(-1, 4), np.full(count, 0.9), np.full(count, kind), unknown, unknown)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("frames")
    rng = np.random.default_rng(3)
    layout = make_layout(43)
    camera = site_cameras(layout, rng, 4, SIZE)[0]
    renderer = Renderer(layout, sample_lighting(rng), camera)
    photometry, routes = sample_photometry(rng), make_routes(layout)
    seen, truth = {}, {}
    with FrameStoreWriter(folder, 92) as writer:
        for number in range(14):
            models, boxes = sample_moment(layout, routes, rng)
            drawing = renderer.draw(models, boxes, {})
            writer.add("a", number * S, number * S + 5, develop(drawing.image, photometry, rng))
            side = (drawing.visible_boxes[:, 2:] - drawing.visible_boxes[:, :2]).min(axis=1)
            plain = drawing.visible_boxes[(drawing.visibility > 0.7) & (side >= 12)]
            native = (plain + 0.5) * 2 - 0.5
            wrong = native + rng.normal(0, 0.08, native.shape) * np.tile(native[:, 2:] - native[:, :2], 2)
            wrong = np.clip(wrong, -0.5, np.array(NATIVE * 2) - 0.5)
            frame = FrameKey("a", number * S + 5)
            seen[frame], truth[frame] = some(wrong), native
        writer.close({"a": NATIVE})
    return Recorded(FrameStore(folder), seen, truth)


def test_convention_edges_are_in_pixels_of_the_recording(recorded: Recorded) -> None:
    refined = recorded.refined()
    assert sorted(refined) == recorded.frames

    def error(given: dict[FrameKey, Boxes2D]) -> float:
        parts = [
            np.abs(given[frame].boxes - boxes) / np.tile(boxes[:, 2:] - boxes[:, :2], 2)
            for frame, boxes in recorded.truth.items()
        ]
        return float(np.concatenate(parts).mean())

    assert sum(map(len, recorded.truth.values())) > 20
    assert error(refined) < 0.5 * error(recorded.seen)


def test_convention_amodal_edges_and_their_deviations_are_in_pixels_of_the_recording(recorded: Recorded) -> None:
    background = recorded.background()
    for frame, native in recorded.refined().items():
        seen = recorded.seen[frame]
        given = Found(recorded.store.to_stored_px("a", seen.boxes), seen.scores, seen.classes)
        image = recorded.store.image_at(*frame)
        stored = EdgeRefiner().refine(image, background, given, nms_iou=DetectConfig().nms_iou, classify=True)
        np.testing.assert_allclose(native.amodal_boxes, (stored.amodal_boxes + 0.5) * 2 - 0.5)
        np.testing.assert_allclose(native.amodal_sd, stored.amodal_sd * 2)


def test_progress_rises_to_one_and_frames_without_boxes_are_kept(recorded: Recorded) -> None:
    empty = recorded.frames[1]
    given = replace(recorded, seen=recorded.seen | {empty: some(np.empty((0, 4)))})
    told: list[float] = []
    refined = given.refined(lambda fraction, message="", **figures: told.append(fraction))
    assert len(refined) == len(given.frames) and len(refined[empty].boxes) == 0
    assert told == sorted(told) and told[-1] == 1.0


def test_other_detectors_keep_their_classes(recorded: Recorded) -> None:
    trucks = replace(recorded, seen={frame: some(seen.boxes, 2) for frame, seen in recorded.seen.items()})
    own, theirs = (
        np.concatenate([seen.classes for seen in trucks.refined(detector=detector).values()])
        for detector in ("bundled", "custom")
    )
    assert (theirs == 2).all()
    assert (own == 0).mean() > 0.5  # most of them are cars


def test_a_block_of_minutes_has_its_own_background(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []

    def background(images: list[np.ndarray], boxes: list[np.ndarray]) -> StillBackground:
        made.append(len(images))
        return still_background(images, boxes)

    monkeypatch.setattr(second_look, "still_background", background)
    assert len(recorded.refined(block_s=4.0)) == len(recorded.frames)
    assert len(made) == 3 and sum(made) == len(recorded.frames)


def test_what_a_frame_shows_does_not_depend_on_the_other_frames(recorded: Recorded) -> None:
    """Those of its background aside, which are always the same."""
    together = recorded.refined()
    for frame in recorded.frames[::4]:
        alone = dict(
            look_again(recorded.store, [frame], recorded.seen, not_asked, recorded.shown(), DetectConfig(), silent)
        )
        for one, other in zip(alone[frame], together[frame], strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_frame_is_decoded_once_for_both_looks(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    new = recorded.frames[3]
    decoded: list[FrameKey] = []
    of_stores = FrameStore.image_at

    def image_at(store: FrameStore, camera_id: str, local_ns: int) -> np.ndarray:
        decoded.append(FrameKey(camera_id, local_ns))
        return of_stores(store, camera_id, local_ns)

    def first_look(frame: FrameKey, image: np.ndarray) -> Boxes2D:
        np.testing.assert_array_equal(image, of_stores(recorded.store, *frame))
        return recorded.seen[frame]

    looks = {frame: seen for frame, seen in recorded.seen.items() if frame != new}
    shown = BackgroundFrames(recorded.store.stored_ns("a"), np.delete(recorded.store.stored_ns("a"), 3), 120.0)
    monkeypatch.setattr(FrameStore, "image_at", image_at)
    found = dict(look_again(recorded.store, [new], looks, first_look, {"a": shown}, DetectConfig(), silent))
    assert len(found[new].boxes) > 0
    assert decoded.count(new) == 1
