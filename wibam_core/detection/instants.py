"""From what was detected in single frames to instants, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from wibam_core.scene import AnnotatedInstant, Boxes2D, Detections2D, FrameKey, FrameSet

Detected = Mapping[FrameKey, Boxes2D]


def annotated(instants: Iterable[FrameSet], detected: Detected) -> list[AnnotatedInstant]:
    """The instants with what was detected in their frames, no vehicles yet."""
    return [
        AnnotatedInstant(
            instant.time_ns,
            {
                camera_id: Detections2D(camera_id, frame_time_ns, *detected[frame_of(instant, camera_id)])
                for camera_id, frame_time_ns in sorted(instant.frame_times_ns.items())
            },
        )
        for instant in instants
    ]


def frames_of(instants: Iterable[FrameSet]) -> list[FrameKey]:
    """All frames of the instants, each once, by camera, in order of time."""
    return sorted({frame_of(instant, camera_id) for instant in instants for camera_id in instant.local_times_ns})


def frame_of(instant: FrameSet, camera_id: str) -> FrameKey:
    """The frame of a camera."""
    return FrameKey(camera_id, instant.local_times_ns[camera_id])


def by_frame(instants: Iterable[AnnotatedInstant]) -> tuple[list[FrameSet], dict[FrameKey, Boxes2D]]:
    """What `annotated` made, of cameras that keep the reference clock, taken apart again."""
    sets, detected = [], {}
    for instant in instants:
        times_ns = {camera_id: seen.frame_time_ns for camera_id, seen in instant.detections.items()}
        sets.append(FrameSet(instant.time_ns, times_ns, times_ns))
        for camera_id, seen in instant.detections.items():
            detected[FrameKey(camera_id, seen.frame_time_ns)] = Boxes2D(
                seen.boxes, seen.scores, seen.classes, seen.amodal_boxes, seen.amodal_sd
            )
    return sets, detected
