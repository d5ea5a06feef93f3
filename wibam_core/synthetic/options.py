"""What a simulated site is like."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from wibam_core.site import Lens


class SimulationOptions(BaseModel):
    """Options of a simulated recording. The same options give the same files, whatever ``workers`` is.

    Attributes:
        seed: layout, traffic, cameras, clocks and light all follow from it.
        cameras: number of cameras.
        seconds: length of every camera's recording.
        fps: frames per second.
        width_px, height_px: image size.
        regime: "site": poles of 6–10 m at the corners; "ego": street level, 1.5–2.8 m, at the same places.
        traffic: "own": our own car-following; "sumo": SUMO's, which needs the extra ``wibam[sumo]``.
        traffic_density: 1 is about 6 vehicles a minute and incoming lane.
        parked: vehicles that stand beside the road all the time.
        distortion: give every lens a mild barrel distortion.
        lens: of every camera. Wide ones see about 160 degrees across.
        cycle_s: length of the signal cycle.
        max_offset_s: recordings start at most so far apart.
        max_drift_ppm: every clock is at most so many millionths too fast or slow.
        drop_rate: share of frames that are lost.
        label_rate_hz: true boxes are written at the multiples of this rate's period on the first camera's clock.
        workers: processes that render, one camera each at a time.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    seed: int = Field(0, ge=0)
    cameras: int = Field(4, ge=2, le=8)
    seconds: float = Field(60.0, ge=1.0, le=3600.0)
    fps: float = Field(12.5, gt=0, le=120)
    width_px: int = Field(640, ge=64, le=3840, multiple_of=2)
    height_px: int = Field(360, ge=64, le=2160, multiple_of=2)
    regime: Literal["site", "ego"] = "site"
    traffic: Literal["own", "sumo"] = "own"
    traffic_density: float = Field(1.0, ge=0, le=4)
    parked: int = Field(2, ge=0, le=20)
    distortion: bool = False
    lens: Lens = "pinhole"
    cycle_s: float = Field(22.0, ge=14.0, le=300.0)
    max_offset_s: float = Field(2.0, ge=0, le=60)
    max_drift_ppm: float = Field(50.0, ge=0, le=1000)
    drop_rate: float = Field(0.01, ge=0, le=0.5)
    label_rate_hz: float = Field(12.5, gt=0, le=120)
    workers: int = Field(1, ge=1, le=64)
