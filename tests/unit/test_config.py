from __future__ import annotations

import pytest

from wibam_core.config import PipelineConfig, StageConfig
from wibam_core.errors import InvalidOption


def test_every_option_says_what_it_does() -> None:
    """In the words that the interface and its documentation show."""
    for stage, part in PipelineConfig.model_fields.items():
        for name, field in part.annotation.model_fields.items():
            assert field.description, f"{stage}.{name}"


@pytest.mark.parametrize(
    "options",
    [
        {"associate": {"max_gap_s": 0}},
        {"associate": {"max_hidden_standing_s": -1}},
        {"lift": {"few_views_sd_m": 0}},
        {"lift": {"min_template_tracks": 1}},
        {"track": {"fusion_radius_m": 0}},
        {"track": {"min_seen_share": 1.1}},
        {"safety": {"min_instants": 0}},
        {"safety": {"min_probability": 1.1}},
        {"safety": {"same_direction_deg": 91}},
    ],
)
def test_options_out_of_bounds_are_refused_by_name(options: dict[str, dict[str, float]]) -> None:
    ((stage, part),) = options.items()
    with pytest.raises(InvalidOption, match=f"option {stage}.{next(iter(part))}: "):
        PipelineConfig.parse(options)


def test_every_number_has_a_largest_and_a_smallest_value() -> None:
    """A step count of 1e12 would hold a worker for years."""
    for stage, field in PipelineConfig.model_fields.items():
        assert field.annotation is not None and issubclass(field.annotation, StageConfig)
        for name, schema in field.annotation.model_json_schema()["properties"].items():
            numbers = [of for of in schema.get("anyOf", [schema]) if of.get("type") in ("number", "integer")]
            for of in numbers:
                assert {"maximum", "exclusiveMaximum"} & of.keys(), f"{stage}.{name}"
                assert {"minimum", "exclusiveMinimum"} & of.keys(), f"{stage}.{name}"
