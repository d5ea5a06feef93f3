"""A site of what somebody else has recorded, detected and labelled.

Frames, 2D boxes, which of them show one vehicle, and the split come as given stages (`wibam_core.stages.given`);
calibration and hand labels lie where a site has them. The rest of the pipeline runs as ever.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.artifacts import catalogue
from wibam_core.association.associate import association_statistics
from wibam_core.association.linking import linked_over_time
from wibam_core.clocks import ClockMap
from wibam_core.config import AssociateConfig
from wibam_core.dataset.statistics import dataset_statistics
from wibam_core.detection.instants import by_frame
from wibam_core.detection.statistics import detection_statistics
from wibam_core.documents.recordings import Limits, Probe, VideoInfo
from wibam_core.documents.refinement import Refinement
from wibam_core.documents.rounds import Rounds
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.documents.synchronisation import Synchronisation
from wibam_core.errors import InputError
from wibam_core.exchange.base import Content, Part
from wibam_core.formats.clocks import Clocks
from wibam_core.formats.framestore import FrameStoreWriter
from wibam_core.formats.labels import write_labels
from wibam_core.progress import Progress, part, silent
from wibam_core.scene import AnnotatedInstant
from wibam_core.site import Site
from wibam_core.stages.given import giving

#: What content must have to make a site of it.
NEEDED = frozenset({Part.CALIBRATION, Part.BOXES_2D, Part.FRAMES})
#: JPEG quality of frames that do not come as JPEG; those are stored as they are.
_QUALITY = 95
_FRAMES_PER_REPORT = 20


def import_site(content: Content, site_dir: Path, progress: Progress = silent) -> list[str]:
    """Write a site folder.

    Vehicles keep the boxes that the content gives them; our own association says which of them are one over time. The
    split stays as it is, also where it has a vehicle in two parts.

    Args:
        content: what a format has read.
        site_dir: absent or empty.
        progress: told now and then.

    Returns:
        Sentences for a person on what was found.

    Raises:
        InputError: a part is missing, the folder is not empty, or a frame is damaged or of another size than its
            calibration.
        NoVehicles: no 2D box lies on the ground within range.
        NoMultiViewVehicles: no two cameras' boxes meet on the ground.
    """
    _check(content, site_dir)
    site_dir.mkdir(parents=True, exist_ok=True)
    try:
        return _write(content, site_dir, progress)
    except BaseException:
        shutil.rmtree(site_dir)  # it was empty before
        raise


def _write(content: Content, site_dir: Path, progress: Progress) -> list[str]:
    assert content.site is not None and content.rig is not None
    instants = sorted(content.instants or (), key=lambda instant: instant.time_ns)
    linked = linked_over_time(instants, content.rig, AssociateConfig(), part(progress, 0.0, 0.2))
    split = Split(
        times_ns={name: tuple(sorted(content.splits[name])) for name in SUBSETS},
        left_out_tracks=dict.fromkeys(SUBSETS, frozenset()),
    )
    _give_recordings(content.site, instants, site_dir)
    _give_frames(content, instants, site_dir, part(progress, 0.2, 1.0))
    found = detection_statistics(instants, content.site.camera_ids)
    with giving(site_dir, "detect", found.model_dump()) as given:
        searched, detected = by_frame(instants)
        given.write(catalogue.DETECTIONS, detected)
        given.write(catalogue.SEARCHED_INSTANTS, searched)
        given.write(catalogue.DETECTION_STATISTICS, found)
    with giving(site_dir, "rounds", {"rounds": 0, "kept": 0}) as given:
        given.write(catalogue.ROUND_DETECTIONS, detected)
        given.write(catalogue.ROUNDS, Rounds(rounds=[], kept=0, reason="the boxes and their vehicles were imported"))
    with giving(site_dir, "refine", {"taken": False}) as given:  # it is the data set's calibration that is wanted
        given.write(catalogue.RIG, content.rig)
        given.write(catalogue.REFINEMENT, Refinement(method="none", taken=False, reason="the cameras were imported"))
    associated = association_statistics(linked)
    with giving(site_dir, "associate", associated.model_dump()) as given:
        given.write(catalogue.ANNOTATIONS, linked)
        given.write(catalogue.ASSOCIATION_STATISTICS, associated)
    statistics = dataset_statistics(linked, content.rig, split)
    with giving(site_dir, "dataset", statistics.model_dump(include={"subsets", "by_views"})) as given:
        given.write(catalogue.SPLIT, split)
        given.write(catalogue.DATASET_STATISTICS, statistics)
    if content.labels is not None:
        write_labels(site_dir / "labels.parquet", content.labels)
    # last: a folder without it is no site
    (site_dir / "site.json").write_text(content.site.model_dump_json(indent=1) + "\n", encoding="utf-8")
    progress(1.0, "imported")
    return _overlap_of(split, linked)


def _overlap_of(split: Split, linked: Sequence[AnnotatedInstant]) -> list[str]:
    """What a person should know of a split that others have made."""
    subset_of = split.subset_of()
    tracks: dict[str, set[int]] = {name: set() for name in SUBSETS}
    for instant in linked:
        if instant.time_ns in subset_of:
            tracks[subset_of[instant.time_ns]] |= {v.track_id for v in instant.vehicles if v.track_id >= 0}
    shared = tracks["test"] & (tracks["train"] | tracks["val"])
    if not shared:
        return []
    return [
        f"{len(shared)} of {len(tracks['test'])} vehicles of the test part are in an earlier part of the split, too; "
        "it is kept as it is"
    ]


def _check(content: Content, site_dir: Path) -> None:
    missing = sorted(part.value for part in NEEDED - content.parts)
    missing += [] if content.site is not None else ["site"]
    missing += [f"the {name} part of the split" for name in SUBSETS if not content.splits.get(name)]
    if missing:
        raise InputError(
            f"a site cannot be made without {', '.join(missing).replace('_', ' ')}",
            hint="Get the whole data set; its frames may be a download of their own.",
            missing=missing,
        )
    if site_dir.exists() and (not site_dir.is_dir() or any(site_dir.iterdir())):
        raise InputError(f"{site_dir} is not empty", hint="Name a folder that is not there yet.")


def _give_recordings(site: Site, instants: Sequence[AnnotatedInstant], site_dir: Path) -> None:
    """What is known of the recordings that the frames come from, all on one clock."""
    times_ns = {camera_id: _times_ns(camera_id, instants) for camera_id in site.camera_ids}
    infos = {camera.id: _video_info(camera.width_px, camera.height_px, times_ns[camera.id]) for camera in site.cameras}
    shown = {
        camera_id: f"{info.codec} {info.width_px}x{info.height_px} {info.fps:.2f} fps {info.duration_s:.1f} s"
        for camera_id, info in infos.items()
    }
    with giving(site_dir, "preflight", {"cameras": shown}) as given:
        given.write(catalogue.PROBE, Probe(cameras=infos))
        given.write(catalogue.TIMESTAMPS, times_ns)
        given.write(catalogue.LIMITS, Limits(min_overlap_s=0.0))
    with giving(site_dir, "sync", {"method": "none"}) as given:
        given.write(catalogue.CLOCKS, Clocks({camera_id: ClockMap() for camera_id in site.camera_ids}))
        given.write(
            catalogue.CHANGES,
            Synchronisation(method="none", reference=site.camera_ids[0], changes={}, groups=[], cameras={}),
        )


def _times_ns(camera_id: str, instants: Sequence[AnnotatedInstant]) -> NDArray[np.int64]:
    times = [i.detections[camera_id].frame_time_ns for i in instants if camera_id in i.detections]
    return np.unique(np.array(times, dtype=np.int64))


def _video_info(width_px: int, height_px: int, times: NDArray[np.int64]) -> VideoInfo:
    intervals = np.diff(times) if len(times) > 1 else np.array([1_000_000_000])
    usual_ns = float(np.median(intervals))
    return VideoInfo(
        codec="jpeg",
        container="files",
        width_px=width_px,
        height_px=height_px,
        rotation_deg=0,
        fps=1e9 / usual_ns,
        frames=len(times),
        missing_frames=0,
        first_ns=int(times[0]) if len(times) else 0,
        last_ns=int(times[-1]) if len(times) else 0,
        duration_s=float(times[-1] - times[0] + usual_ns) * 1e-9 if len(times) else 0.0,
        largest_gap_s=float(intervals.max()) * 1e-9,
        variable_rate=bool((np.abs(intervals - usual_ns) > 0.1 * usual_ns).any()),
    )


def _give_frames(content: Content, instants: Sequence[AnnotatedInstant], site_dir: Path, progress: Progress) -> None:
    frames = sum(len(instant.detections) for instant in instants)
    with (
        giving(site_dir, "frames", {"instants": len(instants), "frames": frames}) as given,
        FrameStoreWriter(given.new_file(catalogue.FRAMES), _QUALITY) as writer,
    ):
        done = 0
        for instant in instants:
            for camera_id, seen in instant.detections.items():
                if done % _FRAMES_PER_REPORT == 0:
                    progress(done / frames, f"{done} of {frames} frames")
                jpeg, image = _frame(content, camera_id, seen.frame_time_ns)
                writer.add(camera_id, instant.time_ns, seen.frame_time_ns, image, jpeg)
                done += 1
        writer.close()


def _frame(content: Content, camera_id: str, frame_time_ns: int) -> tuple[bytes, np.ndarray]:
    assert content.jpeg is not None
    jpeg = content.jpeg(camera_id, frame_time_ns)
    try:
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR_BGR)
    except cv2.error:  # no byte at all, or more pixels than OpenCV takes
        image = None
    name = content.image_name(camera_id, frame_time_ns)
    if image is None:
        raise InputError(f"the frame {name} is damaged", hint="Get it again.", file=name)
    height, width = image.shape[:2]
    expected = content.size_px(camera_id)
    if (width, height) != expected:
        raise InputError(
            f"the frame {name} is {width}x{height} px, but its camera is calibrated for {expected[0]}x{expected[1]} px",
            hint="Boxes and calibration hold for one image size: get the frames in that size.",
            file=name,
        )
    return jpeg, np.asarray(image, dtype=np.uint8)
