"""All options of a job."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pydantic

from wibam_core.config import learning, recordings, traffic, vehicles
from wibam_core.config.base import StageConfig
from wibam_core.config.rounds import RoundsConfig
from wibam_core.errors import InvalidOption, UnknownOption


class PipelineConfig(StageConfig):
    """All options of a job. Each stage sees its own part alone, so that a change re-runs only what depends on it."""

    preflight: recordings.PreflightConfig = recordings.PreflightConfig()
    sync: recordings.SyncConfig = recordings.SyncConfig()
    calibrate: recordings.CalibrateConfig = recordings.CalibrateConfig()
    frames: recordings.FramesConfig = recordings.FramesConfig()
    detect: vehicles.DetectConfig = vehicles.DetectConfig()
    refine: vehicles.RefineConfig = vehicles.RefineConfig()
    rounds: RoundsConfig = RoundsConfig()
    associate: vehicles.AssociateConfig = vehicles.AssociateConfig()
    dataset: learning.DatasetConfig = learning.DatasetConfig()
    lift: learning.LiftConfig = learning.LiftConfig()
    finetune: learning.FinetuneConfig = learning.FinetuneConfig()
    evaluate: learning.EvaluateConfig = learning.EvaluateConfig()
    track: traffic.TrackConfig = traffic.TrackConfig()
    safety: traffic.SafetyConfig = traffic.SafetyConfig()
    report: traffic.ReportConfig = traffic.ReportConfig()

    @property
    def predict(self) -> learning.PredictConfig:
        """What evaluation and tracking need."""
        evaluated = min(self.evaluate.kept_score, self.evaluate.min_score)
        return learning.PredictConfig(
            rate_hz=self.track.rate_hz,
            min_score=self.track.min_score,
            test_min_score=min(evaluated, self.track.min_score),
        )

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
