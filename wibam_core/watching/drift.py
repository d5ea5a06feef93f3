"""Whether what new footage shows is still what the network was made for: where cameras point, and how well it sees."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from wibam_core.documents.warnings import Caution
from wibam_core.documents.watching import CameraTurned, Watched
from wibam_core.formats.usual import Gray
from wibam_core.scene import CameraRig
from wibam_core.watching.turn import Turn, turn_between

#: Smaller turns are not told from none; half a pixel of a still picture.
LEAST_TURN_DEG = 0.05
#: Larger ones are more than wind and heat do to a pole: somebody was there, and the calibration is to be made anew.
MOST_CORRECTED_DEG = 3.0
#: So much of the picture must have moved as the turn says, or something else has changed.
_LEAST_AGREE = 0.5
#: Scores this much below the usual, or this share of the usual number of road users, are worth a word.
_SCORE_FELL, _FEWER = 0.1, 0.25
#: Fewer pictures do not tell how many road users there are.
_FEWEST_IMAGES = 300


def looked_at(
    before: Mapping[str, Gray],
    now: Mapping[str, Gray],
    rig: CameraRig,
    time_ns: int,
    noted: Sequence[CameraTurned],
) -> Iterator[tuple[Turn, CameraTurned]]:
    """Cameras that point elsewhere than was noted last, or that are looked at for the first time.

    Args:
        before: still pictures from when the network was made, by camera or view.
        now: those of new footage, which ends at ``time_ns``.
        rig: the cameras; of their lenses the K counts.
        time_ns: reference clock.
        noted: what was found before, in order of time.
    """
    for camera_id, still in now.items():
        if camera_id not in before or camera_id not in rig:
            continue
        turn = turn_between(before[camera_id], still, rig[camera_id])
        last = next((look for look in reversed(noted) if look.camera == camera_id), None)
        if turn is None or (last is not None and _apart_deg(turn, last) < LEAST_TURN_DEG):
            continue
        sure = turn.agree >= _LEAST_AGREE
        small = turn.angle_deg <= MOST_CORRECTED_DEG
        was_turned = last is not None and last.corrected
        is_turned = turn.angle_deg >= LEAST_TURN_DEG or was_turned
        yield (
            turn,
            CameraTurned(
                camera=camera_id,
                time_ns=time_ns,
                angle_deg=turn.angle_deg,
                rotation_rad=turn.rotation_rad,
                patches=turn.patches,
                agree=turn.agree,
                corrected=sure and small and is_turned and camera_id in rig.mounted,
            ),
        )


def _apart_deg(turn: Turn, noted: CameraTurned) -> float:
    return float(np.rad2deg(np.linalg.norm(np.subtract(turn.rotation_rad, noted.rotation_rad))))


def doubts(watched: Watched, compared: Sequence[str]) -> list[Caution]:
    """What is to be said of a run.

    Args:
        watched: what it noticed.
        compared: the cameras and views that there was a still picture of to compare with.
    """
    return [*_of_turns(watched.turns), *_unlike(watched, compared), *_of_scores(watched)]


def _of_turns(turns: Sequence[CameraTurned]) -> Iterator[Caution]:
    for camera_id in dict.fromkeys(turn.camera for turn in turns):
        of_camera = [turn for turn in turns if turn.camera == camera_id]
        largest = max(of_camera, key=lambda turn: turn.angle_deg)
        details = {"angle_deg": largest.angle_deg, "time_ns": largest.time_ns, "agree": largest.agree}
        corrected = [turn for turn in of_camera if turn.corrected]
        away = [turn for turn in of_camera if not turn.corrected and turn.angle_deg >= LEAST_TURN_DEG]
        if corrected:
            yield Caution(
                code="camera_turned",
                message=f"it points {largest.angle_deg:.2f}° elsewhere than when the network was made; the calibration "
                "was turned along",
                hint="Fasten the camera, and calibrate it anew if it goes on turning.",
                details=details,
            ).of_camera(camera_id)
        if away:
            worst = max(away, key=lambda turn: turn.angle_deg)
            yield Caution(
                code="camera_moved",
                message=f"its picture has changed as if it had been turned by {worst.angle_deg:.2f}°, which only "
                f"{worst.agree:.0%} of the picture agree with or is too much to be corrected: places may be wrong",
                hint="Look at the camera. If it was moved, describe the site anew with a new calibration, and run the "
                "footage again.",
                details={"angle_deg": worst.angle_deg, "time_ns": worst.time_ns, "agree": worst.agree},
            ).of_camera(camera_id)


def _unlike(watched: Watched, compared: Sequence[str]) -> Iterator[Caution]:
    looked = {turn.camera for turn in watched.turns}
    for camera_id in compared:
        if camera_id not in looked:
            yield Caution(
                code="background_unlike",
                message="its still background has too little in common with the one from when the network was made to "
                "tell whether it was turned",
                hint="At night and in fog that is to be expected; by day, look at the camera's picture.",
            ).of_camera(camera_id)


def _of_scores(watched: Watched) -> Iterator[Caution]:
    for camera_id, camera in watched.cameras.items():
        if camera.score is not None and camera.usual_score is not None:
            fell = camera.usual_score - camera.score
            if fell >= _SCORE_FELL:
                yield Caution(
                    code="scores_fell",
                    message=f"the network is less sure than where it was made: scores of {camera.score:.2f} on average "
                    f"instead of {camera.usual_score:.2f}",
                    hint="Clean the lens; light or weather may be such as the network never saw: train it on footage "
                    "like this, too.",
                    details={"score": camera.score, "usual_score": camera.usual_score},
                ).of_camera(camera_id)
        usual = camera.usual_boxes_an_image
        if usual and camera.images >= _FEWEST_IMAGES and camera.boxes / camera.images < _FEWER * usual:
            yield Caution(
                code="fewer_road_users",
                message=f"the network finds {camera.boxes / camera.images:.2f} road users an image instead of "
                f"{usual:.2f} where it was made",
                hint="At quiet hours that is to be expected; else look at the camera's picture.",
                details={"boxes_an_image": camera.boxes / camera.images, "usual_boxes_an_image": usual},
            ).of_camera(camera_id)
