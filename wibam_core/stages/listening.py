"""What recordings sound like, two by two, where they have sound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from wibam_core.artifacts.catalogue import CALIBRATED_RIG
from wibam_core.stages.base import StageContext
from wibam_core.sync.hearing import SoundAlignment, align_by_sound
from wibam_core.sync.segments import Span
from wibam_core.video.sound import Sound, has_sound, hear


def listen(context: StageContext, segments_s: Mapping[str, Sequence[Span]]) -> list[SoundAlignment]:
    """What the sound says of each two cameras.

    Recordings that were interrupted for an unknown time are not listened to.

    Args:
        context: whose recordings are opened, and whose calibration says how far cameras hang from each other.
        segments_s: camera id -> segments of its recording between which the time that passed is unknown.
    """
    camera_ids = [c for c, spans in segments_s.items() if len(spans) == 1 and has_sound(context.recordings[c])]
    if len(camera_ids) < 2:
        return []
    sounds: dict[str, Sound] = {}
    for camera_id in camera_ids:
        context.progress(0.0, f"listening to {camera_id}")
        sound = hear(context.recordings[camera_id])
        if sound is not None:
            sounds[camera_id] = sound.within(*segments_s[camera_id][0])
    places_m = {c: camera.centre_m for c, camera in context.read(CALIBRATED_RIG).mounted.items()}
    found = [
        align_by_sound(
            first, sounds[first], second, sounds[second], float(np.linalg.norm(places_m[first] - places_m[second]))
        )
        for first, second in combinations(sounds, 2)
    ]
    return [one for one in found if one is not None]
