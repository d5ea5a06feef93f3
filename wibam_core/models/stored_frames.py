"""Frames of a frame store as input of a network."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.camera import Camera
from wibam_core.models.frames import Frame
from wibam_core.scene import FrameSet


def stored_frames(store: FrameStore, instants: Iterable[FrameSet], rig: Mapping[str, Camera]) -> Iterator[Frame]:
    """Every calibrated camera's frame of the instants, in order of time, then of the rig; read as they are asked for.

    Args:
        store: holds the images.
        instants: of the store.
        rig: camera id -> camera, of the recording's pixels.
    """
    for instant in instants:
        for camera_id, camera in rig.items():
            if camera_id in instant.frame_times_ns:
                yield Frame(store.image(camera_id, instant.time_ns), camera, camera_id, instant.time_ns)
