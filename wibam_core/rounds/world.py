"""What rounds work on: a recording with its cameras and frames, and the options of the stages that they go through."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from wibam_core.config import AssociateConfig, DatasetConfig, DetectConfig, LiftConfig, RoundsConfig
from wibam_core.detection.background import BackgroundFrames
from wibam_core.formats.framestore import FrameStore
from wibam_core.scene import Boxes2D, CameraRig, FloatArray, FrameKey, FrameSet

#: What is seen in each frame, px of the recording.
Detected = Mapping[FrameKey, Boxes2D]


@dataclass(frozen=True)
class Options:
    """Those of rounds, and of the stages that a round goes through."""

    rounds: RoundsConfig
    detect: DetectConfig
    associate: AssociateConfig
    dataset: DatasetConfig
    lift: LiftConfig


@dataclass(frozen=True, eq=False)
class World:
    """A recording.

    Attributes:
        rig: its cameras. poses: camera id -> covariance of its pose, where that is known.
        store: its frames. instants: those that are searched.
        shown: camera id -> which frames show its still background.
        start: the weights that teaching starts from.
        options: of all stages that a round goes through.
        scratch: for checkpoints.
    """

    rig: CameraRig
    poses: Mapping[str, FloatArray]
    store: FrameStore
    instants: Sequence[FrameSet]
    shown: Mapping[str, BackgroundFrames]
    start: Path
    options: Options
    scratch: Path
