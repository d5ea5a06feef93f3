"""Options of the rounds of finding, fitting and teaching."""

from __future__ import annotations

from pydantic import Field

from wibam_core.config.base import StageConfig


class RoundsConfig(StageConfig):
    most: int = Field(
        2,
        ge=0,
        le=6,
        description="so many times at most, what several cameras see teaches the site's own network, which then looks"
        " for what is still overlooked; only where that is much (enough). Such a round takes about as long as"
        " fine-tuning for 200 steps",
    )
    enough: float = Field(
        0.8,
        ge=0,
        le=1,
        description="no round begins once each camera has boxes of this share of the vehicles that the others place"
        " and it should show; 1: until nothing is gained any more",
    )
    motion: bool = Field(
        True,
        description="before a network is taught, look for what moves beside the still background of each camera and is"
        " as large as a vehicle; only where the detector overlooks much (enough)",
    )
    steps: int = Field(150, ge=1, le=20_000, description="gradient steps of teaching in a round")
    least_gain: float = Field(
        0.02,
        ge=0,
        le=1,
        description="no round follows one that raised the agreement between views by a smaller share: the overlap of"
        " each camera's boxes with vehicles that the others place, summed, at instants that neither teach nor test",
    )
    seed: int = Field(0, ge=0, le=2**63 - 1, description="of the order of images in teaching")

    @property
    def asked_for(self) -> bool:
        """Whether there may be any round: else nothing is judged."""
        return self.motion or self.most > 0
