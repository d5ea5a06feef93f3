"""Options of the stages that teach the network and judge it."""

from __future__ import annotations

from typing import Any, Literal

import pydantic
import pydantic_core
from pydantic import Field

from wibam_core.config.base import StageConfig
from wibam_core.placing import NEEDS, Decode

#: Where networks run, see `FinetuneConfig.device`.
DeviceOption = Literal["auto", "cpu", "cuda"]


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
    max_residual: float = Field(
        0.2, gt=0, le=2, description="fits with a larger mean 1 - GIoU are not trained on, but see max_usual_residuals"
    )
    max_usual_residuals: float = Field(
        3.0,
        ge=0,
        le=100,
        description="fits are trained on, too, whose residual is at most so many times the median of the recording's"
        " fits to several views: where cameras disagree by their calibration, all residuals are larger; 0: never",
    )
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
    learn_edge_offsets: bool = Field(
        True, description="take off what all edges of the detector's boxes lie too far out or in, by all tracks"
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


class PredictConfig(StageConfig):
    """What the stages that read the fine-tuned network's boxes ask of it; there are no options of its own."""

    rate_hz: float = Field(gt=0, description="instants per second that are searched beside those of the test part")
    min_score: float = Field(ge=0, lt=1, description="weaker boxes are left out")
    test_min_score: float = Field(ge=0, lt=1, description="the same at the instants of the test part")


class EvaluateConfig(StageConfig):
    max_range_m: float = Field(50.0, gt=0, le=1000, description="labels farther from the camera are not counted")
    min_visibility: float = Field(0.3, ge=0, le=1, description="labels less visible are not counted")
    match_distance_m: float = Field(
        4.0, gt=0, le=50, description="a detection farther than this from a label is no match"
    )
    min_score: float = Field(0.25, ge=0, lt=1, description="weaker detections are not counted")
    kept_score: float = Field(
        0.1, ge=0, lt=1, description="detections down to this score, or to a lower min_score, are kept in the files"
    )
