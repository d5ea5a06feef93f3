"""Options of the stages that follow the traffic and report: tracks, conflicts, the report."""

from __future__ import annotations

from pydantic import Field

from wibam_core.config.base import StageConfig


class TrackConfig(StageConfig):
    rate_hz: float = Field(6.25, gt=0, le=120, description="instants per second that are tracked on")
    min_score: float = Field(0.3, ge=0, lt=1, description="weaker detections are not used")
    max_place_sd_m: float = Field(
        3.0,
        gt=0,
        le=100,
        description="detections whose place is less certain than this (standard deviation) are not used: far away, near"
        " the horizon",
    )
    fusion_radius_m: float = Field(
        2.5,
        gt=0,
        le=50,
        description="two cameras' detections that lie nearer are one vehicle, farther ones two; about a lane less a"
        " car's width, and as much larger along a vehicle as that is longer than a car",
    )
    gate_m: float = Field(
        4.0,
        gt=0,
        le=50,
        description="a detection farther than this from where a track is expected does not go on with it",
    )
    min_hits: int = Field(4, ge=1, le=1000, description="tracks seen fewer times are dropped")
    min_seen_share: float = Field(
        0.3,
        ge=0,
        le=1,
        description="a track seen at a smaller share of the instants that it lasted, and never for long at this one,"
        " is dropped: a chain of false boxes",
    )
    max_coast_s: float = Field(1.0, gt=0, le=60, description="a track unseen for longer ends")
    max_coast_standing_s: float = Field(
        8.0,
        gt=0,
        le=600,
        description="one of somebody who stands goes on for so long unseen: others hide those who wait at a light",
    )


class SafetyConfig(StageConfig):
    ttc_s: float = Field(3.0, gt=0, le=30, description="a smaller time to collision is a conflict")
    pet_s: float = Field(
        1.5,
        gt=0,
        le=30,
        description="a smaller post-encroachment time is a conflict; at roundabouts 2 s are nothing unusual",
    )
    min_speed_mps: float = Field(1.0, ge=0, le=100, description="at least one of the two must move this fast")
    min_deceleration_mps2: float = Field(
        3.0, ge=0, le=50, description="a collision that softer braking would avoid is no conflict"
    )
    min_instants: int = Field(
        2,
        ge=1,
        le=1000,
        description="fewest instants in a row with a time to collision below ttc_s that are a conflict",
    )
    min_duration_s: float = Field(
        0.2, ge=0, le=60, description="shortest time for which the time to collision stays below ttc_s in a conflict"
    )
    min_probability: float = Field(
        0.5,
        ge=0,
        le=1,
        description="conflicts that are less probable, by how much tracks err, are not told",
    )
    min_track_s: float = Field(
        1.0,
        ge=0,
        le=600,
        description="road users that were tracked for a shorter time have no sure speed and are left out",
    )
    max_overlap_iou: float = Field(
        0.1,
        ge=0,
        le=1,
        description="road users whose footprints ever overlap by more (IoU) are an error of tracking: nobody stands in"
        " another",
    )
    max_overlap_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="the same of a vehicle and somebody on foot or on two wheels, by the share of the smaller footprint"
        " that the other covers",
    )
    max_place_sd_m: float = Field(
        0.3,
        gt=0,
        le=10,
        description="of road users whose places are less certain (standard deviation), and where most are, nothing is"
        " said about conflicts",
    )
    same_direction_deg: float = Field(
        30.0,
        gt=0,
        le=90,
        description="headings that differ by less are one direction (rear end, merging), by more than 180 less this"
        " opposite ones (head on); all others cross",
    )


class ReportConfig(StageConfig):
    examples: int = Field(4, ge=1, le=50, description="before/after reprojections shown")
