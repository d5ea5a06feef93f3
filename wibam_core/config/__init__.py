"""Frozen configurations, one per stage. Unknown keys are refused; nothing here reads the environment."""

from wibam_core.config.base import StageConfig
from wibam_core.config.learning import (
    DatasetConfig,
    DeviceOption,
    EvaluateConfig,
    FinetuneConfig,
    LiftConfig,
    PredictConfig,
)
from wibam_core.config.pipeline import PipelineConfig
from wibam_core.config.recordings import CalibrateConfig, FramesConfig, PreflightConfig, SyncConfig
from wibam_core.config.rounds import RoundsConfig
from wibam_core.config.traffic import ReportConfig, SafetyConfig, TrackConfig
from wibam_core.config.vehicles import AssociateConfig, DetectConfig, RefineConfig

__all__ = [
    "AssociateConfig",
    "CalibrateConfig",
    "DatasetConfig",
    "DetectConfig",
    "DeviceOption",
    "EvaluateConfig",
    "FinetuneConfig",
    "FramesConfig",
    "LiftConfig",
    "PipelineConfig",
    "PredictConfig",
    "PreflightConfig",
    "RefineConfig",
    "ReportConfig",
    "RoundsConfig",
    "SafetyConfig",
    "StageConfig",
    "SyncConfig",
    "TrackConfig",
]
