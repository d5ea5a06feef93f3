"""The second half of detection, on rendered frames of one fixed camera."""

import numpy as np
import pytest

from wibam_core.config import DetectConfig
from wibam_core.detection.background import StillBackground, still_background
from wibam_core.detection.boxes import Found
from wibam_core.detection.refine import EdgeRefiner
from wibam_core.formats.framestore import FrameStore, FrameStoreWriter
from wibam_core.progress import silent
from wibam_core.scene import AnnotatedInstant, Detections2D
from wibam_core.stages import edges
from wibam_core.stages.edges import refine_all
from wibam_core.synthetic.cameras import site_cameras
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.lighting import develop, sample_lighting, sample_photometry
from wibam_core.synthetic.render import Renderer
from wibam_core.synthetic.routes import make_routes
from wibam_core.synthetic.sampling import sample_moment

S = 10**9
SIZE, NATIVE = (640, 360), (1280, 720)

Recorded = tuple[FrameStore, list[AnnotatedInstant], list[np.ndarray]]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Frames at half the recording's size, wrong boxes in the recording's pixels, and the right ones."""
    folder = tmp_path_factory.mktemp("frames")
    rng = np.random.default_rng(3)
    layout = make_layout(43)
    camera = site_cameras(layout, rng, 4, SIZE)[0]
    renderer = Renderer(layout, sample_lighting(rng), camera)
    photometry, routes = sample_photometry(rng), make_routes(layout)
    instants, truth = [], []
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
            count = len(wrong)
            seen = Detections2D("a", number * S + 5, wrong, np.full(count, 0.9), np.zeros(count, np.int64))
            instants.append(AnnotatedInstant(number * S, {"a": seen}))
            truth.append(native)
        writer.close({"a": NATIVE})
    return FrameStore(folder), instants, truth


def test_convention_edges_are_in_pixels_of_the_recording(
    recorded: Recorded,
) -> None:
    store, instants, truth = recorded
    refined = list(refine_all(store, instants, DetectConfig(), silent))
    assert [instant.time_ns for instant in refined] == [instant.time_ns for instant in instants]

    def error(given: list[AnnotatedInstant]) -> float:
        parts = [
            np.abs(instant.detections["a"].boxes - boxes) / np.tile(boxes[:, 2:] - boxes[:, :2], 2)
            for instant, boxes in zip(given, truth, strict=True)
        ]
        return float(np.concatenate(parts).mean())

    assert sum(map(len, truth)) > 20
    assert error(refined) < 0.5 * error(instants)
    assert refined[3].detections["a"].frame_time_ns == instants[3].detections["a"].frame_time_ns


def test_convention_amodal_edges_and_their_deviations_are_in_pixels_of_the_recording(recorded: Recorded) -> None:
    store, instants, _ = recorded
    refined = list(refine_all(store, instants, DetectConfig(), silent))
    background = edges._background(store, instants, "a")
    for instant, after in zip(instants, refined, strict=True):
        seen, native = instant.detections["a"], after.detections["a"]
        given = Found(store.to_stored_px("a", seen.boxes), seen.scores, seen.classes)
        image = store.image("a", instant.time_ns)
        stored = EdgeRefiner().refine(image, background, given, nms_iou=DetectConfig().nms_iou, classify=True)
        np.testing.assert_allclose(native.amodal_boxes, (stored.amodal_boxes + 0.5) * 2 - 0.5)
        np.testing.assert_allclose(native.amodal_sd, stored.amodal_sd * 2)


def test_progress_rises_to_one_and_frames_without_boxes_are_kept(
    recorded: Recorded,
) -> None:
    store, instants, _ = recorded
    empty = Detections2D("a", S + 5, np.empty((0, 4)), np.empty(0), np.empty(0, np.int64))
    given = [instants[0], AnnotatedInstant(S, {"a": empty}), *instants[2:]]
    seen: list[float] = []
    refined = list(
        refine_all(store, given, DetectConfig(), lambda fraction, message="", **figures: seen.append(fraction))
    )
    assert len(refined) == len(given) and len(refined[1].detections["a"]) == 0
    assert seen == sorted(seen) and seen[-1] == 1.0


def test_other_detectors_keep_their_classes(
    recorded: Recorded,
) -> None:
    store, instants, _ = recorded
    trucks = []
    for instant in instants:
        seen = instant.detections["a"]
        classes = np.full(len(seen), 2)
        trucks.append(
            AnnotatedInstant(
                instant.time_ns, {"a": Detections2D("a", seen.frame_time_ns, seen.boxes, seen.scores, classes)}
            )
        )
    own, theirs = (
        np.concatenate([i.detections["a"].classes for i in refine_all(store, trucks, DetectConfig(detector=d), silent)])
        for d in ("bundled", "custom")
    )
    assert (theirs == 2).all()
    assert (own == 0).mean() > 0.5  # most of them are cars


def test_a_block_of_minutes_has_its_own_background(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    store, instants, _ = recorded
    made: list[int] = []

    def background(images: list[np.ndarray], boxes: list[np.ndarray]) -> StillBackground:
        made.append(len(images))
        return still_background(images, boxes)

    monkeypatch.setattr(edges, "still_background", background)
    assert len(list(refine_all(store, instants, DetectConfig(background_s=4.0), silent))) == len(instants)
    assert len(made) == 3 and sum(made) == len(instants)
