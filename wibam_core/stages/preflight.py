"""Check the recordings, and the hand labels, detector and network if there are any, before anything long begins."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wibam_core.artifacts.catalogue import LIMITS, PROBE, TIMESTAMPS
from wibam_core.config import FinetuneConfig, PreflightConfig
from wibam_core.detection.detector import check_detector
from wibam_core.documents.recordings import Limits, Probe, VideoInfo
from wibam_core.documents.warnings import Caution
from wibam_core.errors import InputError, InvalidWeights, MissingCamera, NoOverlap, UnreadableVideo
from wibam_core.formats.labels import read_labels
from wibam_core.site import HomographyCalibration, PointsCalibration, SiteCamera
from wibam_core.stages.base import StageContext, Summary
from wibam_core.stages.store import sha256_of
from wibam_core.video.cautions import cautions_of
from wibam_core.video.probe import measure
from wibam_core.video.recording import Recording, RecordingFile

#: Aspects of pixels that differ by this share are one and the same.
_ASPECT_TOLERANCE = 0.01
#: Sizes of pictures of analogue cameras, DVDs and HDV, which players show wider or narrower than they are stored.
_SQUEEZED_PX = {
    *((720, 576), (704, 576), (720, 480), (704, 480), (352, 288), (352, 240), (352, 576), (352, 480), (480, 576)),
    *((960, 576), (960, 480), (928, 576), (928, 480), (944, 576), (1440, 1080)),
}


def run(context: StageContext, config: PreflightConfig) -> Summary:
    """Write `PROBE`, `TIMESTAMPS` and `LIMITS`.

    Labels, and the site's own detector and network where the options ask for them, are read and checked, no more.

    Raises:
        MissingCamera: cameras of the site without a recording.
        UnreadableVideo: a recording that cannot be read.
        InputError: a recording of another size than its calibration.
        NoOverlap: a recording shorter than the time that it must share with another.
        InvalidLabels: hand labels that cannot be used.
        InvalidWeights: a network that fine-tuning cannot start from, or a detector that cannot look at an image.
        InvalidOption: options of fine-tuning that the network has no use for.
    """
    missing = [camera_id for camera_id in context.site.camera_ids if camera_id not in context.recordings]
    if missing:
        raise MissingCamera(f"there is no recording of camera {', '.join(missing)}", cameras=missing)
    labelled = {"labelled_instants": len(read_labels(context.assets["labels"]))} if "labels" in context.assets else {}
    if "detector" in context.assets:
        _check_detector(context.assets["detector"])
    if context.checked_options is not None:
        _check_network(context.assets["network"], context.checked_options)
    infos: dict[str, VideoInfo] = {}
    times: dict[str, NDArray[np.int64]] = {}
    for number, camera in enumerate(context.site.cameras):
        context.progress(number / len(context.site.cameras), f"camera {camera.id}")
        info, times[camera.id] = _measure(camera, context.recordings[camera.id])
        _check_size(camera, info)
        _check_pixels(camera, info)
        if info.duration_s < config.min_overlap_s:
            raise NoOverlap(
                f"the recording of camera {camera.id} lasts {info.duration_s:.1f} s; it must share at least "
                f"{config.min_overlap_s:g} s with another camera's",
                hint="Record for longer, or lower preflight.min_overlap_s.",
                camera=camera.id,
            )
        infos[camera.id] = info
    context.write(PROBE, Probe(cameras=infos))
    context.write(TIMESTAMPS, times)
    context.write(LIMITS, Limits(min_overlap_s=config.min_overlap_s))
    context.warn(*_same_files(context.recordings))
    for camera in context.site.cameras:
        info = infos[camera.id]
        context.warn(*(each.of_camera(camera.id) for each in (*cautions_of(info), *_pixel_cautions(camera, info))))
    context.progress(1.0)
    return {
        "cameras": {
            camera_id: f"{info.codec} {info.width_px}x{info.height_px} {info.fps:.2f} fps {info.duration_s:.1f} s"
            for camera_id, info in infos.items()
        },
        **labelled,
        "shortest_s": min(info.duration_s for info in infos.values()),
        "frames": sum(info.frames for info in infos.values()),
    }


def _same_files(recordings: Mapping[str, Recording]) -> list[Caution]:
    """What was uploaded for two cameras: then one of them is not seen at all."""
    by_size: dict[int, list[tuple[str, RecordingFile]]] = {}
    for camera_id, recording in recordings.items():
        for file in recording.files:
            by_size.setdefault(file.path.stat().st_size, []).append((camera_id, file))
    first: dict[str, str] = {}
    cautions = []
    for camera_id, file in (entry for alike in by_size.values() if len(alike) > 1 for entry in alike):
        other = first.setdefault(sha256_of(file.path), camera_id)
        if other != camera_id:
            caution = Caution(
                code="same_recording",
                message=f"its recording {file.name} is, byte by byte, the one of camera {other}",
                hint="Give each camera its own recording: two cameras never see the same.",
                details={"file": file.name, "other": other},
            )
            cautions.append(caution.of_camera(camera_id))
    return cautions


def _measure(camera: SiteCamera, recording: Recording) -> tuple[VideoInfo, NDArray[np.int64]]:
    try:
        return measure(recording, (camera.width_px, camera.height_px))
    except UnreadableVideo as error:
        raise UnreadableVideo(f"camera {camera.id}: {error.message}", hint=error.hint, camera=camera.id) from error


def _check_detector(path: Path) -> None:
    try:
        check_detector(path)
    except InvalidWeights as error:
        raise InvalidWeights(f"the site's detector: {error.message}", hint=error.hint, **error.details) from error


def _check_network(path: Path, options: FinetuneConfig) -> None:
    from wibam_core.networks.registry import load_to_train  # torch takes seconds to import

    try:
        load_to_train(path, options)
    except InvalidWeights as error:
        raise InvalidWeights(f"the site's network: {error.message}", hint=error.hint, **error.details) from error


def _check_size(camera: SiteCamera, info: VideoInfo) -> None:
    if (info.width_px, info.height_px) == (camera.width_px, camera.height_px):
        return
    turned = f" once turned by {info.rotation_deg}°, as it is shown" if info.rotation_deg else ""
    if abs(info.pixel_aspect - 1) > 0.01:
        wide, high = (
            (info.width_px * info.pixel_aspect, info.height_px)
            if info.rotation_deg % 180 == 0
            else (info.width_px, info.height_px * info.pixel_aspect)
        )
        turned += (
            f" (its pixels are {info.pixel_aspect:.3f} times as wide as high: players show {wide:.0f}x{high:.0f} px)"
        )
    raise InputError(
        f"the recording of camera {camera.id} is {info.width_px}x{info.height_px} px{turned}, but the site says "
        f"{camera.width_px}x{camera.height_px} px",
        hint="Calibration and signal regions hold for one image size: correct the site, or upload the original file.",
        camera=camera.id,
        recording_px=[info.width_px, info.height_px],
        site_px=[camera.width_px, camera.height_px],
    )


def _aspect_used(info: VideoInfo) -> float:
    """Width of a pixel over its height, in the pictures as they are used."""
    if info.stored_px is not None:
        return 1.0
    return info.pixel_aspect if info.rotation_deg % 180 == 0 else 1 / info.pixel_aspect


def _check_pixels(camera: SiteCamera, info: VideoInfo) -> None:
    """Raises:
    InputError: the focal length is solved for pixels of another shape than the recording's.
    """
    given, found = camera.calibration, _aspect_used(info)
    if not isinstance(given, HomographyCalibration | PointsCalibration) or not info.aspect_stated:
        return
    if abs(given.pixel_aspect / found - 1) <= _ASPECT_TOLERANCE:
        return
    if info.stored_px is not None:
        raise InputError(
            f"camera {camera.id}: pixel_aspect is {given.pixel_aspect:.4g}, but its recording is stretched to the size "
            f"that players show, {info.width_px}x{info.height_px} px, where pixels are square",
            hint="Leave pixel_aspect out, or give the size as stored and pixels in it.",
            camera=camera.id,
        )
    if given.pixel_aspect == 1:
        width, height = info.width_px, info.height_px
        shown = (round(width * found), height) if found > 1 else (width, round(height / found))
        raise InputError(
            f"the calibration of camera {camera.id} takes pixels to be square, and those of its recording are "
            f"{found:.4g} times as wide as high",
            hint=f'Say "pixel_aspect": {found:.4g} in its calibration, or give the size that players show, '
            f"{shown[0]}x{shown[1]} px, and pixels as clicked there.",
            camera=camera.id,
            pixel_aspect=found,
        )


def _pixel_cautions(camera: SiteCamera, info: VideoInfo) -> list[Caution]:
    """That a focal length is solved for pixels of a shape that the file contradicts, or that pictures of such a size
    hardly have."""
    given, size_px = camera.calibration, (info.width_px, info.height_px)
    if not isinstance(given, HomographyCalibration | PointsCalibration):
        return []
    if info.aspect_stated and abs(given.pixel_aspect / _aspect_used(info) - 1) > _ASPECT_TOLERANCE:
        return [
            Caution(
                code="pixel_aspect",
                message=f"its pixels are {given.pixel_aspect:.4g} times as wide as high by its calibration, and "
                f"{_aspect_used(info):.4g} times by its file; the calibration is believed",
                hint="Look at a wheel from the side in the picture as it is stored: by how much is it wider than high?",
            )
        ]
    if given.pixel_aspect != 1 or info.aspect_stated or size_px not in _SQUEEZED_PX:
        return []
    return [
        Caution(
            code="pixels_perhaps_not_square",
            message=f"its file does not say how wide its pixels are, and pictures of {size_px[0]}x{size_px[1]} px are "
            "mostly shown wider or narrower; square pixels were assumed",
            hint='If wheels look squeezed from the side, say "pixel_aspect" in its calibration: the width of a pixel '
            "over its height, such as 1.333.",
        )
    ]
