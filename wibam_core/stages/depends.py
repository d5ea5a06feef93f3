"""On what of a site, and of other stages' options, the outputs of a stage depend."""

from __future__ import annotations

from typing import Any

from wibam_core.config import FinetuneConfig, PipelineConfig, StageConfig
from wibam_core.site import Site
from wibam_core.stages.assets import ASSETS


def nothing(site: Site) -> Any:
    return None


def sizes(site: Site) -> Any:
    return [(c.id, c.width_px, c.height_px) for c in site.cameras]


def signals(site: Site) -> Any:
    return [(c.id, c.width_px, c.height_px, [s.model_dump() for s in c.signals]) for c in site.cameras]


def calibration(site: Site) -> Any:
    views = [[view.model_dump() for view in c.views] for c in site.cameras]
    return [(c.id, c.width_px, c.height_px, c.calibration.model_dump()) for c in site.cameras], views


def everything(site: Site) -> Any:
    return site.model_dump()


def no_options(config: PipelineConfig) -> FinetuneConfig | None:
    return None


def of_network(config: PipelineConfig) -> FinetuneConfig | None:
    """What the site's own network must be able to do, where it is used."""
    if not ASSETS["network"].is_used(config):
        return None
    options = config.finetune
    return FinetuneConfig(
        network=options.network,
        method=options.method,
        decode=options.decode,
        input_width_px=options.input_width_px,
    )


def of_rounds(config: PipelineConfig) -> tuple[StageConfig, ...]:
    """What a round goes through, where there is one."""
    options = (config.detect, config.refine, config.associate, config.dataset, config.lift)
    return options if config.rounds.asked_for else ()


def no_others(config: PipelineConfig) -> tuple[StageConfig, ...]:
    return ()
