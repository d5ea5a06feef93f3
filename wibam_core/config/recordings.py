"""Options of the stages that read recordings: checks, clocks, calibration, frames."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from wibam_core.config.base import StageConfig


class PreflightConfig(StageConfig):
    min_overlap_s: float = Field(
        5.0, ge=0, le=3600, description="shortest time that each recording must share with another, once synchronised"
    )


class SyncConfig(StageConfig):
    method: Literal["auto", "signals", "traffic", "both", "none"] = Field(
        "auto",
        description="'signals': from traffic lights in view; 'traffic': from road users that two cameras see; 'both';"
        " 'auto': from the lights, and from the traffic where a camera shares none or where lights repeat themselves;"
        " 'none': the recordings share a clock",
    )
    traffic_rate_hz: float = Field(
        5.0, gt=0, le=60, description="frames a second in which road users are looked for to synchronise"
    )
    sound: bool = Field(
        True,
        description="listen to recordings that have sound: it chooses between offsets that lights or traffic leave"
        " open, and confirms or contradicts them; it is never believed alone",
    )
    min_confidence: float = Field(0.3, ge=0, le=1, description="signal changes below this are not used")
    min_lit_share: float = Field(
        0.4,
        ge=0,
        le=1,
        description="a region that clearly shows a state in a smaller share of its frames holds no signal head; lamps"
        " of LEDs that flicker against the shutter may need less",
    )
    max_offset_s: float | None = Field(
        None,
        gt=0,
        le=86400,
        description="largest clock offset that is expected; of offsets that explain the recordings equally well, those"
        " within it are preferred. Every offset is searched under which recordings overlap, whatever this says",
    )


class CalibrateConfig(StageConfig):
    max_error_px: float = Field(10.0, gt=0, le=1000, description="fail above this median reprojection error")


class FramesConfig(StageConfig):
    rate_hz: float = Field(12.5, gt=0, le=120, description="common sampling rate")
    width_px: int = Field(960, ge=64, le=8192, description="images wider than this are shrunk once, here")
    jpeg_quality: int = Field(92, ge=30, le=100, description="of the stored images, as OpenCV counts it")
