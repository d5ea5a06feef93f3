"""Options of the stages that find vehicles in several views: detection, refinement, association."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from wibam_core.config.base import StageConfig


class DetectConfig(StageConfig):
    detector: Literal["bundled", "custom"] = Field(
        "bundled", description="'custom': the site's own detector.onnx, e.g. of the YOLOX family"
    )
    rate_hz: float = Field(6.25, gt=0, le=120, description="instants per second that are searched for vehicles")
    min_score: float = Field(0.3, gt=0, lt=1, description="weaker boxes are left out")
    nms_iou: float = Field(0.6, gt=0, lt=1, description="of two boxes that overlap more (IoU), the weaker is left out")
    tiles: int = Field(
        1,
        ge=1,
        le=4,
        description="beside the whole image, look at so many times so many overlapping parts of it, for detectors that"
        " overlook what is small; with 3, detection takes ten times as long",
    )
    refine: Literal["auto", "on", "off"] = Field(
        "auto",
        description="look at every box again beside the still background of its camera, which must not move, for"
        " sharper edges; 'auto': with the bundled detector, whose classes it corrects as well",
    )
    background_s: float = Field(
        120.0,
        gt=0,
        le=86400,
        description="a camera's background is made anew about this often: less where the light changes quickly, more"
        " where vehicles stand for longer, since what they always hide stays unknown",
    )


class RefineConfig(StageConfig):
    method: Literal["traffic", "none"] = Field(
        "traffic",
        description="'none': cameras stay as calibrated; 'traffic': how they are held, and where, is refined by the"
        " road users that several of them see, and taken where it fits others better that it was not found by",
    )
    intrinsics: Literal["none", "focal", "focal_k1"] = Field(
        "none", description="refine each camera's focal length as well, or that and its first distortion coefficient"
    )
    rotation_sd_deg: float = Field(
        0.5,
        gt=0,
        le=10,
        description="standard deviation about each axis of how a camera is held that was given by ready matrices; of"
        " one that was solved from points, these say how well it is known",
    )
    position_sd_m: float = Field(0.05, gt=0, le=10, description="the same of where it is, along each axis")
    ground_sd_m: float = Field(
        0.3,
        gt=0,
        le=10,
        description="standard deviation of where the road lies against the world's Z = 0: how far all cameras together"
        " may be found higher or lower above it than they were calibrated, or, 40 m from their middle, by its tilt",
    )
    clock_sd_s: float = Field(
        0.015, gt=0, le=1, description="how far synchronised clocks may still be off; such an error turns no camera"
    )
    min_vehicles: int = Field(
        16, ge=4, le=100_000, description="moving vehicles that several cameras must see, a quarter of them to judge by"
    )
    least_gain: float = Field(
        0.1,
        ge=0,
        lt=1,
        description="a refined calibration is taken if it lowers the reprojection error of vehicles that it was not"
        " found by, by at least this share; less may be what is wrong with the bodies that vehicles are taken to have",
    )


class AssociateConfig(StageConfig):
    method: Literal["tracked", "paper"] = Field(
        "tracked",
        description="which boxes show one vehicle; 'tracked': those whose rays mostly meet while they are followed, by"
        " how certain each ray is; 'paper': those whose ground points DP-means clusters at an instant, as published;"
        " statistics count both",
    )
    cluster_radius_m: float = Field(3.0, gt=0, le=50, description="DP-means penalty: farther rays open a new vehicle")
    range_m: float = Field(
        60.0, gt=0, le=1000, description="ground points farther than this from the cameras' centre are left out"
    )
    max_speed_mps: float = Field(
        30.0, gt=0, le=150, description="what is seen again farther away than this speed allows is another vehicle"
    )
    max_gap_s: float = Field(
        0.5,
        gt=0,
        le=60,
        description="a box that its camera does not find again for longer begins anew; three instants at the usual"
        " detect.rate_hz: allow more where fewer are searched or a detector misses many",
    )
    max_hidden_moving_s: float = Field(
        3.0,
        ge=0,
        le=600,
        description="a moving vehicle that all cameras lose for longer is another one when it is seen again: nobody"
        " knows where it went meanwhile",
    )
    max_hidden_standing_s: float = Field(
        45.0,
        ge=0,
        le=3600,
        description="a standing vehicle that all cameras lose for longer is another one when it is seen again; a queue"
        " may hide it for as long as a red light lasts",
    )
