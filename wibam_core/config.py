"""Frozen configurations, one per stage. Unknown keys are refused; nothing here reads the environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import pydantic
import pydantic_core
from pydantic import BaseModel, ConfigDict, Field

from wibam_core.errors import InvalidOption, UnknownOption
from wibam_core.placing import NEEDS, Decode

#: Where networks run, see `FinetuneConfig.device`.
DeviceOption = Literal["auto", "cpu", "cuda"]


class StageConfig(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


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


class DetectConfig(StageConfig):
    detector: Literal["bundled", "custom"] = Field(
        "bundled", description="'custom': the site's own detector.onnx, e.g. of the YOLOX family"
    )
    rate_hz: float = Field(6.25, gt=0, le=120, description="instants per second that are searched for vehicles")
    min_score: float = Field(0.3, gt=0, lt=1, description="weaker boxes are left out")
    nms_iou: float = Field(0.6, gt=0, lt=1, description="of two boxes that overlap more (IoU), the weaker is left out")
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
        "none",
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


class DatasetConfig(StageConfig):
    rate_hz: float = Field(2.5, gt=0, le=120, description="instants per second that are trained and evaluated on")
    train_share: float = Field(0.75, gt=0, lt=1, description="share of the footage, from its start, to train on")
    val_share: float = Field(
        0.15, ge=0, lt=1, description="share after that by which the best state is chosen; the rest tests it"
    )
    gap_s: float = Field(2.0, ge=0, le=600, description="left out between subsets, so that no vehicle is in two")


class LiftConfig(StageConfig):
    rate_hz: float = Field(
        5.0, gt=0, le=120, description="instants per second that are fitted, beside those of the split"
    )
    min_views: int = Field(
        2, ge=2, le=32, description="cameras that must see a vehicle at an instant for it to be fitted"
    )
    iterations: int = Field(50, ge=5, le=1000, description="most Gauss-Newton steps of a fit")
    max_residual: float = Field(0.2, gt=0, le=2, description="fits with a larger mean 1 - GIoU are not trained on")
    few_views_sightings: int = Field(
        5,
        ge=2,
        le=1000,
        description="where fewer than min_views cameras see a vehicle, it is fitted if its track has so many sightings:"
        " they and its class tell its size",
    )
    few_views_sd_m: float = Field(
        0.5,
        gt=0,
        le=50,
        description="fits of vehicles that fewer than min_views cameras see are kept if the standard deviation of their"
        " place is at most this",
    )
    learn_templates: bool = Field(True, description="correct each class's body by what all its tracks show")
    min_template_tracks: int = Field(
        5, ge=2, le=1000, description="classes with fewer tracks keep their body: one odd vehicle is not the class"
    )


#: Options of fine-tuning that only some methods have a use for.
_METHODS_WITH = {"own_view": ("paper", "combined"), "box_heads": ("paper",), "multiview_weight": ("combined",)}


def _refusal(message: str) -> pydantic_core.PydanticCustomError:
    """Of an option beside others, said as it stands; braces in the sentence mean nothing."""
    return pydantic_core.PydanticCustomError("refused", "{message}", {"message": message})


def _usual_decode(others: dict[str, Any]) -> Literal["plane", "refined"]:
    """How boxes are placed unless options say, by the options before."""
    return "plane" if others.get("method") == "paper" or others.get("network") == "custom" else "refined"


class FinetuneConfig(StageConfig):
    method: Literal["lifted", "paper", "combined"] = Field(
        "lifted",
        description="'lifted': boxes fitted to all views; 'paper': eq. 1 of the published method; 'combined': both",
    )
    network: Literal["small", "custom"] = Field(
        "small",
        description="'custom': the site's own network.safetensors: a fine-tuned network of another job, or a converted"
        " CenterTrack DLA-34",
    )
    decode: Decode = Field(
        default_factory=_usual_decode,
        description="how boxes are placed: 'plane': where the ray to the 3D centre is half the vehicle's height above"
        " ground; 'depth': at the regressed depth; 'fused': by both by their regressed uncertainties; 'ground': where"
        " the ray to the footprint meets the ground; 'fitted': from there, where they agree best with all that the"
        " network says about them, the edges of their 2D boxes included; 'refined': as 'fitted', with edges of a"
        " second look at each vehicle; unless given, 'refined', or 'plane' where footprints are not learned or the"
        " network is 'custom'",
    )
    device: DeviceOption = Field(
        "auto", description="where to train; 'auto': on all CUDA devices that are visible, or else on the CPU"
    )
    input_width_px: int | None = Field(
        None,
        ge=320,
        le=1920,
        multiple_of=32,
        description="how wide the network sees the images; unless given, as its file says, 640 for 'small'; a step"
        " takes as much longer as an image has more pixels",
    )
    steps: int = Field(1200, ge=1, le=200_000, description="gradient steps in all")
    batch_size: int = Field(8, ge=1, le=512, description="images per step")
    crop_share: float = Field(
        1.0,
        ge=0.1,
        le=1,
        description="of each image, a step sees a window that is so wide and high as this share of it, around a road"
        " user, or as one that is larger; 1: the whole image. With 0.4, training takes a quarter of the time,"
        " and ends a little less exact",
    )
    learning_rate: float | None = Field(
        None,
        gt=0,
        le=10,
        description="peak rate; unless given, 1e-4 for 'paper' and 2.5e-3 for the others, or the published ones for"
        " 'custom' networks",
    )
    own_view: bool = Field(
        False,
        description="'paper', 'combined': boxes must also fit the view they are predicted in, as in the published code",
    )
    box_heads: bool = Field(
        False, description="'paper': also learn 2D centre offsets and box sizes by L1, as in the published code"
    )
    multiview_weight: float | None = Field(
        None, gt=0, le=1000, description="'combined': weight of the multi-view loss; unless given, 0.1"
    )
    steps_per_epoch: int = Field(50, ge=1, le=200_000, description="a checkpoint and a validation after each")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="of the order of images and of their augmentation")

    @pydantic.field_validator("decode")
    @classmethod
    def _can_be_decoded(cls, value: str, info: pydantic.ValidationInfo) -> str:
        if value in NEEDS and info.data.get("method") == "paper":
            raise _refusal(f"method 'paper' teaches no {NEEDS[value]}, only 'plane' and 'depth' are possible")
        return value

    @pydantic.field_validator(*_METHODS_WITH)
    @classmethod
    def _does_something(cls, value: bool | float | None, info: pydantic.ValidationInfo) -> bool | float | None:
        """Refuse an option that the chosen method has no use for."""
        methods = _METHODS_WITH[str(info.field_name)]
        if value and info.data.get("method", methods[0]) not in methods:
            useful = " and ".join(map(repr, methods))
            raise _refusal(f"it does nothing with method '{info.data['method']}', only with {useful}")
        return value


class EvaluateConfig(StageConfig):
    max_range_m: float = Field(50.0, gt=0, le=1000, description="labels farther from the camera are not counted")
    min_visibility: float = Field(0.3, ge=0, le=1, description="labels less visible are not counted")
    match_distance_m: float = Field(
        4.0, gt=0, le=50, description="a detection farther than this from a label is no match"
    )
    min_score: float = Field(0.25, ge=0, lt=1, description="weaker detections are not counted")


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
        description="a track seen at a smaller share of the instants that it lasted is dropped: a chain of false boxes",
    )
    max_coast_s: float = Field(1.0, gt=0, le=60, description="a track unseen for longer ends")


class SafetyConfig(StageConfig):
    ttc_s: float = Field(3.0, gt=0, le=30, description="a smaller time to collision is a conflict")
    pet_s: float = Field(2.0, gt=0, le=30, description="a smaller post-encroachment time is a conflict")
    min_speed_mps: float = Field(1.0, ge=0, le=100, description="at least one of the two must move this fast")
    min_deceleration_mps2: float = Field(
        3.0, ge=0, le=50, description="a collision that softer braking would avoid is no conflict"
    )
    min_instants: int = Field(
        3,
        ge=1,
        le=1000,
        description="fewest instants in a row with a time to collision below ttc_s that are a conflict: one may err",
    )
    min_duration_s: float = Field(
        0.2, ge=0, le=60, description="shortest time for which the time to collision stays below ttc_s in a conflict"
    )
    min_probability: float = Field(
        0.8,
        ge=0,
        le=1,
        description="least probability, by the states' standard deviations, that the time to collision in a conflict is"
        " below ttc_s: a pass close by is not taken for a crash course",
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
    same_direction_deg: float = Field(
        30.0,
        gt=0,
        le=90,
        description="headings that differ by less are one direction (rear end, merging), by more than 180 less this"
        " opposite ones (head on); all others cross",
    )


class ReportConfig(StageConfig):
    examples: int = Field(4, ge=1, le=50, description="before/after reprojections shown")


class PipelineConfig(StageConfig):
    """All options of a job. Each stage sees its own part alone, so that a change re-runs only what depends on it."""

    preflight: PreflightConfig = PreflightConfig()
    sync: SyncConfig = SyncConfig()
    calibrate: CalibrateConfig = CalibrateConfig()
    frames: FramesConfig = FramesConfig()
    detect: DetectConfig = DetectConfig()
    refine: RefineConfig = RefineConfig()
    associate: AssociateConfig = AssociateConfig()
    dataset: DatasetConfig = DatasetConfig()
    lift: LiftConfig = LiftConfig()
    finetune: FinetuneConfig = FinetuneConfig()
    evaluate: EvaluateConfig = EvaluateConfig()
    track: TrackConfig = TrackConfig()
    safety: SafetyConfig = SafetyConfig()
    report: ReportConfig = ReportConfig()

    @classmethod
    def parse(cls, options: Mapping[str, Any]) -> PipelineConfig:
        """From nested options, e.g. ``{"finetune": {"steps": 200}}``.

        Raises:
            UnknownOption: naming the first option that does not exist.
            InvalidOption: naming the first option that has a wrong value.
        """
        try:
            return cls.model_validate(options)
        except pydantic.ValidationError as error:
            first = error.errors()[0]
            name = ".".join(str(part) for part in first["loc"])
            if first["type"] == "extra_forbidden":
                raise UnknownOption(f"option {name}: there is no such option", option=name) from error
            raise InvalidOption(f"option {name}: {first['msg']}", option=name) from error
